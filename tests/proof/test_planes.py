"""Separating planes: their geometry is that of both engines, and what they prove is true between the samples too."""

import dataclasses

import numpy as np
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Attached, Box, Capsule, Cylinder, Mesh, Sphere
from minidual.proof import planes
from minidual.proof.certificate import first_stretches
from minidual.proof.layout import Geometry, Motion, Padding
from minidual.proof.scene_engines import SceneEngines
from minidual.proof.solids import _clusters
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.robot.trajectory import Trajectory
from tests.support.planning_oracles import CoalDistances, farthest_in_mujoco, states

HALF = np.sqrt(0.5)
DOF = DUAL_PANDA.dof
HOME = DUAL_PANDA.home
WEDGE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.12, 0.0], [0.02, 0.03, 0.15]])


@pytest.fixture(scope="module")
def scene():
    """Every kind of shape, one of them a mesh of two pieces, one held."""
    fingers = ("left_panda_leftfinger", "left_panda_rightfinger")
    return (
        PlanningScene()
        .with_obstacles(
            Box("box", (0.5, 0.2, 0.15), (np.cos(0.3), 0.0, 0.0, np.sin(0.3)), (0.1, 0.12, 0.3)),
            Cylinder(
                "cylinder",
                (0.5, -0.2, 0.15),
                (HALF, HALF, 0.0, 0.0),
                radius_m=0.04,
                length_m=0.3,
            ),
            Capsule(
                "capsule",
                (0.6, 0.0, 0.2),
                (HALF, HALF, 0.0, 0.0),
                radius_m=0.04,
                length_m=0.3,
            ),
            Sphere("sphere", (0.4, 0.0, 0.45), radius_m=0.06),
            Mesh(
                "wedge",
                (0.45, 0.35, 0.1),
                (HALF, 0.0, HALF, 0.0),
                pieces=(WEDGE.tobytes(), (WEDGE + 0.05).tobytes()),
            ),
        )
        .with_attached(
            Attached(
                Cylinder(
                    "stick",
                    (0, 0.02, 0.11),
                    (HALF, 0.0, HALF, 0.0),
                    radius_m=0.01,
                    length_m=0.3,
                ),
                "left_panda_hand",
                fingers,
            ),
        )
    )


@pytest.fixture(scope="module")
def engines(scene):
    return SceneEngines(scene)


@pytest.fixture(scope="module")
def distances(scene, engines):
    return CoalDistances(scene, engines.engine("coal"))


def placed(solids, q):
    """Return the poses (15, 3, 3), (15, 3) of all frames."""
    work = solids.workspace()
    planes._place(solids.geometry, np.asarray(q, dtype=float), 0, work)
    return work.R[0], work.p[0]


NOWHERE = np.zeros((0, DOF))


def survey(solids, Q, padding_m, tight=NOWHERE, clearances=NOWHERE[:, 0], relax=0.1):
    padding = Padding(padding_m, tight, clearances, relax)
    pairs = np.arange(len(solids.pairs))
    return planes.survey(solids.geometry, Q, pairs, padding, solids.workspace())


def free(solids, q, *args):
    return survey(solids, q[None], *args) == 1


def prove(solids, trajectory, reach=None, length=0.5, chosen=None):
    chosen = np.arange(len(solids.pairs)) if chosen is None else chosen
    geometry = solids.geometry if reach is None else solids.geometry._replace(reach=reach)
    stretches = first_stretches(trajectory.q, length)
    work = solids.workspace(len(trajectory.q))
    return planes.prove(
        geometry,
        Motion(trajectory.q, trajectory.v, trajectory.dt_s),
        stretches,
        chosen,
        2e-5,
        work,
    )


def wave(q, amplitude, seed, samples_n=201):
    """A motion through q: every joint swings by its own amplitude, frequency and phase."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(-amplitude, amplitude, DOF)
    rate = rng.uniform(1.0, 6.0, DOF)
    phase = rng.uniform(0, 6, DOF)
    t = np.arange(samples_n)[:, None] * 0.001
    turn = rate * t * 5.0 + phase
    return Trajectory(
        t[:, 0],
        q + size * np.sin(turn),
        size * 5.0 * rate * np.cos(turn),
        -size * (5.0 * rate) ** 2 * np.sin(turn),
        "both_arms",
    )


def test_kinematics_are_those_of_pinocchio(engines):
    kinematics = Kinematics()
    hand = engines.engine("coal").model.getFrameId("left_panda_hand_tcp")
    flange = np.array(engines.engine("coal").model.frames[hand].placement.homogeneous)
    for q in states(20)[:20]:
        R, p = placed(engines.solids, q)
        for frame, T in zip((7, 14), kinematics.tcp_poses(q), strict=True):
            mine = np.eye(4)
            mine[:3, :3], mine[:3, 3] = R[frame], p[frame]
            assert np.abs(mine @ flange - T).max() < 1e-12


@pytest.mark.parametrize("arm", list(ARM_MODELS))
def test_the_solids_are_what_mujoco_compiled(scene, arm):
    """Along random directions every part goes as far in the one as in the other: the hulls are the same."""
    robot = Robot(ARM_MODELS[arm])
    held = scene.attached[0]._replace(link="left_panda_hand")
    scene = PlanningScene(scene.obstacles, (held,), robot=robot)
    engines = SceneEngines(scene)
    rng = np.random.default_rng(1)
    _, clusters, solids, parts, *_ = engines.solids.geometry
    seen = 0
    for q in robot.home + rng.uniform(-0.8, 0.8, (6, robot.dof)):
        engines.engine("mujoco").contact_count(q)
        R, p = placed(engines.solids, q)
        for name, part in zip(scene.names, parts, strict=True):
            for _ in range(6):
                n = rng.normal(size=3)
                n /= np.linalg.norm(n)
                own = R[part["frame"]].T @ n
                far = (
                    max(
                        (clusters["vertices"][s["first"] : s["end"]] @ own).max()
                        + s["ball"]
                        + s["disc"] * np.linalg.norm(np.cross(own, s["axis"]))
                        for s in solids[part["first"] : part["end"]]
                    )
                    + n @ p[part["frame"]]
                )
                assert far == pytest.approx(
                    farthest_in_mujoco(engines.engine("mujoco"), name, n),
                    abs=2e-6,
                ), name
                seen += 1
    assert seen == 36 * len(scene.names)


def test_another_geometry_would_be_noticed(scene, engines):
    """Negative control of the comparison above."""
    kept = tuple(shape for shape in scene.obstacles if shape.name != "sphere")
    larger = Sphere("sphere", (0.4, 0, 0.45), radius_m=0.0601)
    other = SceneEngines(dataclasses.replace(scene, obstacles=(*kept, larger)))
    engines.engine("mujoco").contact_count(HOME)
    other.engine("mujoco").contact_count(HOME)
    far = [
        farthest_in_mujoco(e.engine("mujoco"), "sphere", np.array([0.0, 0.0, 1.0]))
        for e in (engines, other)
    ]
    assert far[1] - far[0] == pytest.approx(1e-4, abs=1e-9)


@pytest.mark.parametrize("padding_m", [0.002, 0.008])
def test_verdicts_are_those_of_exact_distances(engines, distances, padding_m):
    Q = states(160, seed=2)
    nearest = distances(Q).min(axis=1)
    said = np.array([free(engines.solids, q, padding_m) for q in Q])
    assert (nearest[said] > padding_m - 1e-7).all()
    assert (
        nearest[~said] > padding_m + 1e-7
    ).mean() < 0.02  # what planes leave open counts as not free
    assert min(said.sum(), (~said).sum()) > 50


def test_a_survey_stops_at_the_first_state_that_is_not_free(engines):
    Q = states(40, seed=3)
    one_by_one = np.array([free(engines.solids, q, 0.0) for q in Q])
    assert survey(engines.solids, Q, 0.0) == int(np.argmin(one_by_one)) > 0
    open_ones = Q[one_by_one]
    assert survey(engines.solids, open_ones, 0.0) == len(open_ones)
    assert not free(engines.solids, open_ones[0] * np.nan, 0.0)


def test_padding_relaxes_near_a_tight_end(engines, distances):
    """Where the distance lies between clearance and padding, the joint step from the end decides."""
    Q = states(300, seed=4)[:300]
    nearest = distances(Q).min(axis=1)
    q = Q[np.flatnonzero((nearest > 0.004) & (nearest < 0.006))[0]]
    none = free(engines.solids, q, 0.008)
    at_the_end = free(engines.solids, q, 0.008, q[None] + 0.01, np.array([0.003]))
    beyond = free(engines.solids, q, 0.008, q[None] + 0.09, np.array([0.003]))
    assert (none, at_the_end, beyond) == (False, True, False)


def test_clearance_is_sure_and_nearly_exact(engines, distances):
    Q = states(60, seed=5)
    for q, truth in zip(Q, distances(Q).min(axis=1), strict=True):
        said = engines.solids.clearance(q[None], 0.04)
        if truth > 1e-3:
            assert min(truth, 0.04) - 6e-4 < said <= min(truth, 0.04) + 1e-7
        elif truth <= 0.0:
            assert said <= 1e-7


def test_no_vertex_leaves_its_chord_by_more_than_the_bound(scene, engines):
    """On straight lines in joint space, seen from the world and from every link that carries the part, on a fine grid."""
    solids = engines.solids
    _, clusters, shapes, parts, *_ = solids.geometry
    moving = [k for k in range(len(parts)) if parts[k]["frame"] > 0]
    rng = np.random.default_rng(6)
    table = np.empty((len(parts) + 1, 8))
    tightest = 0.0
    for size in (0.02, 0.1, 0.4):
        q = states(1, seed=int(1e3 * size))[0]
        step = rng.uniform(-size, size, DOF)
        planes._deviate(solids.geometry, step, np.zeros(DOF), table)
        poses = [placed(solids, q + x * step) for x in np.linspace(0.0, 1.0, 21)]
        poses = [(R.copy(), p.copy()) for R, p in poses]
        for row in moving:
            k = row
            frame = int(parts[k]["frame"])
            own = clusters[shapes[parts[k]["first"]]["first"] : shapes[parts[k]["end"] - 1]["end"]]
            points = own["vertices"].reshape(-1, 3)
            base = 0 if frame <= 7 else 7
            for inner in range(frame - base):
                seen_from = inner + base if inner else 0
                seen = np.array(
                    [
                        (points @ R[frame].T + p[frame] - p[seen_from]) @ R[seen_from]
                        for R, p in poses
                    ],
                )
                x = np.linspace(0.0, 1.0, 21)[:, None, None]
                off = np.linalg.norm(seen - ((1 - x) * seen[0] + x * seen[-1]), axis=2).max()
                assert off <= table[row, inner] + 1e-12
                tightest = max(tightest, off / table[row, inner])
    assert tightest > 0.3  # the bound is not absurdly wide
    assert (table[-1] == 0.0).all()


def test_the_motion_leaves_the_straight_line_by_no_more_than_is_said():
    trajectory = wave(HOME, 0.5, seed=7)
    n = len(trajectory.q)
    step = np.empty(DOF)
    off = np.empty(DOF)
    bend = planes.bends(trajectory.q, trajectory.v, trajectory.dt_s)
    for i, j in [(0, n - 1), (3, 60), (100, 101), (150, 152)]:
        planes._off_chord(trajectory.q, bend, planes._Stretch(i, j), step, off)
        assert np.array_equal(step, trajectory.q[j] - trajectory.q[i])
        times = np.linspace(trajectory.times[i], trajectory.times[j], 40 * (j - i) + 1)
        fine = trajectory.sample_many(times)[0] - trajectory.q[i]
        # One point of the line for all joints at once: between samples it runs evenly.
        at_samples = np.clip(fine[::40] @ step / (step @ step), 0.0, 1.0)
        x = np.interp(times, times[::40], at_samples)[:, None]
        away = np.abs(fine - x * step).max(axis=0)
        assert (away <= off + 1e-12).all()
        assert (off <= away + 0.1 * away.max() + 3e-5).all()


def test_a_number_that_is_none_makes_the_bound_infinite():
    trajectory = wave(HOME, 0.5, seed=7)
    n = len(trajectory.q)
    bend = np.zeros((n - 1, DOF))
    step = np.empty(DOF)
    off = np.empty(DOF)
    bend[5, 3] = np.nan
    planes._off_chord(trajectory.q, bend, planes._Stretch(0, n - 1), step, off)
    assert np.isinf(off).all()


def test_what_is_proven_is_free_at_a_thousand_states_in_between(engines, distances):
    """Wild motions of all joints: whatever is proven holds on a grid far finer than the proof's, by exact distances."""
    proven = refused = 0
    for seed in range(40):
        trajectory = wave(states(1, seed=seed)[0], 0.1 + 0.3 * (seed % 3), seed)
        asked, failed, pair = prove(engines.solids, trajectory)
        if failed >= 0:
            refused += 1
            near = distances(trajectory.q[[failed, failed + 1]])[:, pair]
            assert near.min() < 0.02  # what is refused is at least close
            continue
        proven += 1
        assert asked[0]
        assert asked[-1]
        Q = trajectory.sample_many(np.linspace(0.0, trajectory.duration_s, 1201))[0]
        assert not engines.engine("coal").collisions(Q).any()
        assert not engines.engine("mujoco").collisions(Q).any()
        few = Q[:: len(Q) // 12]
        assert distances(few).min() > 0.0
    assert min(proven, refused) >= 5


def test_with_a_reach_too_short_a_ball_beside_the_chord_would_be_missed():
    """Negative control of the bound: a tip turns about the base past a ball that its arc meets and its chord does not."""
    a = HOME.copy()
    b = HOME.copy()
    a[0] = HOME[0] - 0.4
    b[0] = HOME[0] + 0.4
    T_world_tcp = Kinematics().tcp_poses(HOME)[0]
    tip = Attached(Sphere("tip", (0.0, 0.0, 0.1), radius_m=0.01), "left_panda_hand_tcp")
    ball = Sphere("ball", tuple(T_world_tcp[:3, 3] + 0.1 * T_world_tcp[:3, 2]), radius_m=0.01)
    engines = SceneEngines(PlanningScene(obstacles=(ball,)).with_attached(tip))
    solids = engines.solids
    x = np.linspace(0.0, 1.0, 3001)[:, None]
    smooth = 10 * x**3 - 15 * x**4 + 6 * x**5
    speed = 30 * x**2 - 60 * x**3 + 30 * x**4
    trajectory = Trajectory(
        np.arange(3001) * 0.001,
        a + (b - a) * smooth,
        (b - a) * speed / 3.0,
        np.zeros((3001, DOF)),
        "left_arm",
    )
    assert engines.engine("mujoco").collisions(trajectory.q[::10]).any()
    only = np.array([solids.pairs.index(("ball", "tip"))])
    assert prove(solids, trajectory, length=100.0, chosen=only)[1] >= 0
    asked, failed, _ = prove(
        solids,
        trajectory,
        reach=0.01 * solids.geometry.reach,
        length=100.0,
        chosen=only,
    )
    assert failed < 0
    assert asked.sum() == 2


@pytest.mark.parametrize(
    "spoil",
    ["q", "v", "reach", "all clusters", "last cluster", "later clusters"],
)
def test_nothing_is_proven_from_numbers_that_are_none(engines, spoil):
    solids = engines.solids
    trajectory = wave(HOME, 0.02, seed=8)
    assert prove(solids, trajectory)[1] < 0
    joints, clusters, shapes, parts, pairs, reach = solids.geometry
    q = trajectory.q.copy()
    v = trajectory.v.copy()
    reach = reach.copy()
    balls = clusters.copy()
    if spoil == "q":
        q[50, 2] = np.nan
    elif spoil == "v":
        v[50, 2] = np.nan
    elif spoil == "reach":
        reach[4, 0] = np.nan
    else:
        # Balls round the parts that settle nothing, so that the clusters must.
        parts = parts.copy()
        parts["radius"] = np.nan
        if spoil == "all clusters":
            balls["radius"] = np.nan
        elif spoil == "last cluster":
            balls["centre"][shapes["end"] - 1, 1] = np.nan
        else:
            balls["radius"][np.setdiff1d(np.arange(len(balls)), shapes["first"])] = np.nan
    every = np.arange(len(pairs))
    spoiled = Geometry(joints, balls, shapes, parts, pairs, reach)
    stretches = first_stretches(trajectory.q, 0.5)
    work = solids.workspace(len(q))
    _, failed, _ = planes.prove(
        spoiled, Motion(q, v, trajectory.dt_s), stretches, every, 2e-5, work
    )
    assert failed >= 0
    if "cluster" in spoil:
        said = planes.clearance(spoiled, q[:1], every, 0.04, solids.workspace())
        assert said == -np.inf


@pytest.mark.parametrize("arm", list(ARM_MODELS))
def test_no_vertex_lies_outside_the_ball_of_its_cluster(scene, arm):
    """So a solid's extent, found by skipping clusters, is that of all its vertices."""
    robot = Robot(ARM_MODELS[arm])
    solids = SceneEngines(PlanningScene(scene.obstacles, robot=robot)).solids
    clusters = solids.geometry.clusters
    shapes = solids.geometry.solids
    away = np.linalg.norm(clusters["vertices"] - clusters["centre"][:, None], axis=2)
    assert (away <= clusters["radius"][:, None] + 1e-15).all()
    rng = np.random.default_rng(2)
    still = (np.eye(3), np.zeros(3))
    asked = 0
    for way in rng.normal(size=(50, 3)):
        way /= np.linalg.norm(way)
        for k in np.flatnonzero(shapes["disc"] == 0.0):
            own = clusters["vertices"][shapes["first"][k] : shapes["end"][k]].reshape(-1, 3)
            far, point = planes._farthest(solids.geometry, int(k), *still, tuple(way))
            assert far == pytest.approx((own @ way).max(), abs=1e-15)
            assert (own == point).all(axis=1).any()
            asked += shapes["end"][k] - shapes["first"][k] > 4
    assert asked > 200


def test_every_vertex_is_in_a_cluster_and_a_nan_one_spoils_its_ball():
    rng = np.random.default_rng(3)
    for n in (1, 2, 7, 8, 9, 15, 16, 17, 100, 152):
        points = rng.normal(size=(n, 3))
        rows = _clusters(points)
        assert len(rows) <= -(-n // 8) + 1
        assert {tuple(x) for _, _, own in rows for x in own} == {tuple(x) for x in points}
        points[n // 2] = np.nan
        assert sum(not np.isfinite(radius) for _, radius, _ in _clusters(points)) >= 1


def test_clearance_of_a_state_that_is_none_is_nothing_and_ends(engines):
    assert engines.solids.clearance(HOME[None] * np.nan, 0.04) == -np.inf


def test_a_huge_obstacle_is_answered_for_too():
    engines = SceneEngines(
        PlanningScene(obstacles=(Box("sky", (0.0, 0.0, 2e9), size_m=(1e9, 1e9, 1e9)),)),
    )
    assert engines.solids.clearance(HOME[None], 0.04) <= 0.04


def rest_to_rest(start, end, aside=None, samples_n=401):
    """A motion from start to end, and by (14,) `aside` away from the straight line half-way."""
    x = np.linspace(0.0, 1.0, samples_n)[:, None]
    seconds = (samples_n - 1) * 0.001
    there = 10 * x**3 - 15 * x**4 + 6 * x**5
    speed = 30 * x**2 - 60 * x**3 + 30 * x**4
    out = np.sin(np.pi * x) ** 2
    turn = np.pi * np.sin(2.0 * np.pi * x)
    aside = np.zeros(DOF) if aside is None else aside
    q = start + (end - start) * there + aside * out
    v = ((end - start) * speed + aside * turn) / seconds
    return Trajectory(np.arange(samples_n) * 0.001, q, v, np.zeros_like(q), "left_arm")


@pytest.mark.parametrize("balls_settle", [True, False])
def test_two_links_of_one_arm_are_looked_at_from_the_inner_one(balls_settle):
    """A ball in the hand passes through one on the forearm while the base turns by half a circle.

    In the world the one lies on the same side of the other before and after; from the forearm, which is what counts for a
    bound on the wrist alone, it changes sides.
    """
    start = HOME.copy()
    end = HOME.copy()
    start[[0, 5]] += [-0.5 * np.pi, -0.3]
    end[[0, 5]] += [0.5 * np.pi, 0.3]
    T_world_tcp = Kinematics().tcp_poses(HOME)[0]
    R, p = placed(SceneEngines(PlanningScene()).solids, HOME)
    forearm = R[5].T @ (T_world_tcp[:3, 3] - p[5])
    scene = PlanningScene(obstacles=()).with_attached(
        Attached(Sphere("hand_ball", (0.0, 0.0, 0.0), radius_m=0.01), "left_panda_hand_tcp"),
        Attached(Sphere("forearm_ball", tuple(forearm), radius_m=0.01), "left_panda_link5"),
    )
    engines = SceneEngines(scene)
    solids = engines.solids
    if not balls_settle:
        solids.geometry.parts["radius"] = 1.0  # then planes must
    only = np.array(
        [k for k, names in enumerate(solids.pairs) if set(names) == {"hand_ball", "forearm_ball"}],
    )
    assert len(only) == 1
    meets = rest_to_rest(start, end)
    assert CoalDistances(scene, engines.engine("coal"))(meets.q[200:201])[0, only[0]] < 0.0
    assert prove(solids, meets, length=100.0, chosen=only)[1] >= 0
    beside = start.copy()
    beside[0] = end[0]
    asked, failed, _ = prove(solids, rest_to_rest(start, beside), length=100.0, chosen=only)
    assert failed < 0
    assert asked.sum() == 2  # seen from the forearm nothing moves


def test_a_motion_that_returns_to_where_it_began_is_not_taken_for_rest():
    """Both ends of the stretch are the same posture: the straight line between them is a point, and the way is not."""
    away = np.zeros(DOF)
    away[0] = 0.4
    there = Kinematics().tcp_poses(HOME + away)[0][:3, 3]
    solids = SceneEngines(
        PlanningScene(obstacles=(Sphere("ball", tuple(there), radius_m=0.01),)),
    ).solids
    only = solids.of_arms(["left"])
    out_and_back = rest_to_rest(HOME, HOME, away)
    assert np.abs(out_and_back.q[0] - out_and_back.q[-1]).max() < 1e-30
    assert prove(solids, out_and_back, length=100.0, chosen=only)[1] >= 0
    assert prove(solids, rest_to_rest(HOME, HOME, -0.5 * away), length=100.0, chosen=only)[1] < 0


def test_an_obstacle_may_have_the_name_of_a_piece_of_a_link():
    """Pieces of links are called by the part they belong to, not by a name that an obstacle could take."""
    names = ("left_panda_link5_0", "left_panda_leftfinger_0")
    boxes = tuple(
        Box(name, (0.9 + 0.2 * k, 0.0, 0.5), size_m=(0.1, 0.1, 0.1)) for k, name in enumerate(names)
    )
    scene = PlanningScene(obstacles=boxes)
    engines = SceneEngines(scene)
    parts = engines.solids.geometry.parts
    for name in names:
        part = parts[scene.names.index(name)]
        assert part["frame"] == 0
        assert part["end"] - part["first"] == 1
    finger = parts[scene.names.index("left_panda_leftfinger")]
    assert finger["end"] - finger["first"] == 4
    assert engines.solids.clearance(HOME[None], 0.04) > 0.0


def test_the_same_motion_is_proven_from_the_same_samples(engines):
    """Memory of directions carries nothing from one proof to the next."""
    trajectory = wave(HOME, 0.3, seed=9)
    first = prove(engines.solids, trajectory)
    prove(engines.solids, wave(HOME, 0.4, seed=10))
    again = prove(engines.solids, trajectory)
    assert np.array_equal(first[0], again[0])
    assert first[1:] == again[1:]
