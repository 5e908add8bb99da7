"""The two collision engines, distances, and the bound on motion."""

import numpy as np
import pytest

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.edges import EdgeChecker, bisection_order
from minidual.planning.motion_bound import MotionBound
from minidual.planning.mujoco_engine import MujocoEngine
from minidual.planning.scene import Attached, PlanningScene
from minidual.planning.shapes import Box, Capsule, Cylinder, Sphere
from minidual.robot.constants import HOME, Q_LOWER, Q_UPPER
from minidual.robot.kinematics import Kinematics

HALF = np.sqrt(0.5)


@pytest.fixture(scope="module")
def scene():
    fingers = ("left_panda_leftfinger", "left_panda_rightfinger")
    return (
        PlanningScene()
        .with_obstacles(
            Box("box", (0.5, 0.2, 0.15), (np.cos(0.3), 0.0, 0.0, np.sin(0.3)), (0.1, 0.12, 0.3)),
            Cylinder("cylinder", (0.5, -0.2, 0.15), radius_m=0.04, length_m=0.3),
            Capsule("capsule", (0.6, 0.0, 0.2), (HALF, HALF, 0.0, 0.0), radius_m=0.04, length_m=0.3),
            Sphere("sphere", (0.4, 0.0, 0.45), radius_m=0.06),
        )
        .with_attached(
            Attached(Cylinder("stick", (0, 0, 0.11), radius_m=0.01, length_m=0.3), "left_panda_hand", fingers)
        )
    )


@pytest.fixture(scope="module")
def engines(scene):
    return MujocoEngine(scene), CoalEngine(scene)


def states(count, seed=0, spread=0.8):
    rng = np.random.default_rng(seed)
    near = np.clip(HOME + rng.uniform(-spread, spread, (count, 14)), Q_LOWER, Q_UPPER)
    return np.vstack([near, rng.uniform(Q_LOWER, Q_UPPER, (count // 2, 14))])


def test_engines_agree_on_random_states(engines):
    Q = states(4000)
    mine, second = (engine.collisions(Q) for engine in engines)
    assert 0.1 < mine.mean() < 0.9  # the comparison sees both answers
    assert np.sum(mine != second) <= 2  # grazing contacts may fall either way


def test_engines_disagree_when_their_scenes_differ(scene, engines):
    """Negative control: a missing obstacle is seen by the comparison."""
    Q = states(2000)
    assert np.sum(engines[0].collisions(Q) != CoalEngine(scene.without_obstacle("box")).collisions(Q)) > 20


def test_both_engines_check_the_same_pairs(scene, engines):
    assert len(engines[1].geometry.collisionPairs) >= len(scene.checked_pairs)
    excluded = engines[0].model.nexclude
    names = len(scene.names)
    assert names * (names - 1) // 2 - excluded == len(scene.checked_pairs)


def test_kinematics_of_the_engine_is_that_of_pinocchio():
    engine, kinematics = MujocoEngine(PlanningScene()), Kinematics()
    for q in states(20)[:20]:
        engine.contact_count(q)
        for name, T in zip(("left", "right"), kinematics.tcp_poses(q), strict=True):
            body = engine.data.body(f"{name}_panda_hand_tcp")
            assert np.abs(body.xpos - T[:3, 3]).max() < 1e-12


def test_distance_is_that_of_the_geometry():
    """A ball hung over the table, where the distance is known."""
    ball = Attached(Sphere("ball", (0, 0, 0.25), radius_m=0.05), "left_panda_hand_tcp")
    engine = MujocoEngine(PlanningScene().with_attached(ball))
    T_world_tcp = Kinematics().tcp_poses(HOME)[0]
    centre = T_world_tcp[:3, :3] @ [0, 0, 0.25] + T_world_tcp[:3, 3]
    found = {(p.first, p.second): p.distance_m for p in engine.closest(HOME, 1.0)}
    assert found["ball", "table"] == pytest.approx(centre[2] - 0.05, abs=1e-6)


def test_closest_leaves_the_margin_as_it_was(engines):
    engine = engines[0]
    engine.set_margin(0.003)
    engine.closest(HOME, 0.1)
    assert engine.margin_m == 0.003


def test_motion_bound_holds(scene, engines):
    """No pair comes nearer than the bound says; and the bound is not absurdly wide."""
    engine, coal = engines
    bound = MotionBound(scene, coal)
    rng = np.random.default_rng(3)
    tightest = 0.0
    for q in states(150, seed=4)[:150]:
        step = rng.uniform(-0.1, 0.1, 14)
        before = {(p.first, p.second): p.distance_m for p in engine.closest(q, 0.1)}
        after = {(p.first, p.second): p.distance_m for p in engine.closest(q + step, 0.1)}
        for pair in before.keys() & after.keys():
            if min(before[pair], after[pair]) <= 0.0:
                continue  # depth of penetration is no distance
            limit = bound.of_pair(pair, step)
            assert abs(before[pair] - after[pair]) <= limit + 1e-6, pair
            tightest = max(tightest, abs(before[pair] - after[pair]) / limit)
    assert tightest > 0.3


def test_levers_are_never_too_short_and_tighter_than_the_reach(scene, engines):
    """The bound with measured levers holds for what the distances really do, for steps of any size."""
    engine, coal = engines
    bound = MotionBound(scene, coal)
    rng = np.random.default_rng(5)
    Q = states(120, seed=6)[:120]
    gain = []
    for q, size in zip(Q, rng.choice([0.005, 0.05, 0.3], len(Q)), strict=True):
        both = np.clip(np.array([q, q + rng.uniform(-size, size, 14)]), Q_LOWER, Q_UPPER)
        measured = engine.measure(both, 0.3)
        step = np.abs(np.diff(both, axis=0))
        tight = bound.approach(step, measured.levers[:1], measured.levers[1:])[0]
        loose = bound.approach(step)[0]
        assert (tight <= loose + 1e-12).all()
        d = coal.distances(both)
        free = (d > 0.0).all(axis=0)
        assert (np.abs(d[1] - d[0])[free] <= tight[free] + 1e-6).all()
        gain.append(np.median(tight[loose > 0.0] / loose[loose > 0.0]))
    assert np.median(gain) < 0.75


def test_distances_of_both_engines_are_the_same(scene, engines):
    """Exact geometry up to a millionth of a metre; what MuJoCo does not name is farther than it says."""
    engine, coal = engines
    Q = states(60, seed=7)
    mine, second = engine.measure(Q, 0.1).distances, coal.distances(Q)
    named = (mine < 0.0799) & (mine > 0.0) & (second > 0.0)
    assert named.sum() > 200
    assert np.abs(mine - second)[named].max() < 1e-6
    assert (second[mine >= 0.0799] > 0.0799).all()
    assert ((mine <= 0.0) == (second <= 0.0)).mean() > 0.9999


def test_margins_of_coal_are_its_distances(scene, engines):
    """With a margin just below each pair's distance nothing is near; with one of them just above, something is."""
    _, coal = engines
    Q = states(2000, seed=8)
    Q = Q[~coal.collisions(Q)][:40]
    rng = np.random.default_rng(9)
    for q, d in zip(Q, coal.distances(Q), strict=True):
        below = np.minimum(0.98 * d - 1e-5, 0.3)
        assert not coal.nearer_than(q[None], below)[0]
        pair = rng.integers(len(d))
        above = below.copy()
        above[pair] = 1.02 * d[pair] + 1e-5
        assert coal.nearer_than(q[None], above)[0]
    assert not coal.collisions(Q).any()  # the margins are gone again


def test_motion_bound_counts_only_joints_that_matter(scene, engines):
    bound = MotionBound(scene, engines[1])
    step = np.zeros(14)
    step[0] = 1.0
    assert bound.of_pair(("left_panda_link1", "left_panda_link5"), step) == 0.0  # they turn together
    assert bound.of_pair(("left_panda_hand", "table"), step) > 0.5
    assert bound.of_pair(("right_panda_hand", "table"), step) == 0.0
    assert bound.of_pair(("stick", "table"), step) > bound.of_pair(("left_panda_link3", "table"), step)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 30, 100])
def test_bisection_order_holds_every_fraction_once(count):
    order = bisection_order(count)
    assert sorted(np.round(order * count).astype(int)) == list(range(1, count + 1))
    assert order[0] == 1.0


def test_padding_is_kept_and_relaxes_at_a_tight_start():
    """A start 2 mm from a box: with full padding it could never be left."""
    plain = MujocoEngine(PlanningScene())
    finger_z = min(
        p.distance_m for p in plain.closest(HOME, 1.0) if "finger" in p.first and p.second == "table"
    )
    x, y, _ = Kinematics().tcp_poses(HOME)[0][:3, 3]
    top = finger_z - 0.002
    scene = PlanningScene().with_obstacles(Box("block", (x, y, 0.5 * top), size_m=(0.2, 0.2, top)))
    engine = MujocoEngine(scene)
    assert engine.closest(HOME, 0.01)[0].distance_m == pytest.approx(0.002, abs=1e-4)
    away = HOME.copy()
    away[3] += 0.3  # stretch the elbow: the hand rises
    assert not EdgeChecker(engine, 0.005, (), 0.03).free(HOME)
    relaxed = EdgeChecker(engine, 0.005, (HOME, away), 0.03)
    assert relaxed.free(HOME)
    assert relaxed.edge_free(HOME, away)
    assert relaxed.required_m(HOME) == pytest.approx(0.0018, abs=1e-4)
    assert relaxed.required_m(away) == 0.005
    pressed = HOME.copy()
    pressed[3] -= 0.02
    assert not relaxed.free(pressed)


def test_restricting_to_one_arm_drops_only_what_stands_still(scene, engines):
    """With the right arm held, distances of pairs that the left one moves are the same; others are not measured."""
    engine = engines[0]
    Q = states(60, seed=10)
    full = engine.measure(Q, 0.1).distances
    with engine.moving(["left"]):
        part = engine.measure(Q, 0.1).distances
    mine = np.array(
        [any(n.startswith("left_") or n == "stick" for n in pair) for pair in scene.checked_pairs]
    )
    assert np.array_equal(full[:, mine], part[:, mine])
    assert (full[:, ~mine] < 0.0799).any()
    assert (part[:, ~mine] > 0.0799).all()
    assert np.array_equal(engine.measure(Q, 0.1).distances, full)  # and everything is back


def test_lower_bounds_are_given_where_exact_distances_are_not_asked_for(scene, engines):
    engine = engines[0]
    Q = states(60, seed=11)
    exact = engine.measure(Q, 0.1).distances
    rough = engine.measure(Q, 0.1, np.full_like(exact, 0.02)).distances
    free = exact > 0.0
    assert (rough <= exact + 1e-9)[free].all()
    assert np.array_equal(rough[free & (rough < 0.02)], exact[free & (rough < 0.02)])
    assert (rough < exact - 1e-4).any()
