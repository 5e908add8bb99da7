"""The two collision engines, the reach of every part, and the questions of the search."""

import dataclasses

import numpy as np
import pytest

from minidual.collision.engines import CoalEngine, MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Attached, Box, Capsule, Cylinder, Sphere
from minidual.motion.search import EdgeChecker, bisection_order
from minidual.proof import planes
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from tests.support.planning_oracles import CoalDistances, states

HALF = np.sqrt(0.5)
HOME = DUAL_PANDA.home


@pytest.fixture(scope="module")
def scene():
    fingers = ("left_panda_leftfinger", "left_panda_rightfinger")
    return (
        PlanningScene()
        .with_obstacles(
            Box("box", (0.5, 0.2, 0.15), (np.cos(0.3), 0.0, 0.0, np.sin(0.3)), (0.1, 0.12, 0.3)),
            Cylinder("cylinder", (0.5, -0.2, 0.15), radius_m=0.04, length_m=0.3),
            Capsule(
                "capsule",
                (0.6, 0.0, 0.2),
                (HALF, HALF, 0.0, 0.0),
                radius_m=0.04,
                length_m=0.3,
            ),
            Sphere("sphere", (0.4, 0.0, 0.45), radius_m=0.06),
        )
        .with_attached(
            Attached(
                Cylinder("stick", (0, 0, 0.11), radius_m=0.01, length_m=0.3),
                "left_panda_hand",
                fingers,
            ),
        )
    )


@pytest.fixture(scope="module")
def engines(scene):
    return MujocoEngine(scene), CoalEngine(scene)


def test_engines_agree_on_random_states(engines):
    Q = states(4000)
    mine, second = (engine.collisions(Q) for engine in engines)
    assert 0.1 < mine.mean() < 0.9  # the comparison sees both answers
    assert np.sum(mine != second) <= 2  # grazing contacts may fall either way


def test_engines_disagree_when_their_scenes_differ(scene, engines):
    """Negative control: a missing obstacle is seen by the comparison."""
    Q = states(2000)
    assert (
        np.sum(
            engines[0].collisions(Q)
            != CoalEngine(dataclasses.replace(scene, obstacles=scene.obstacles[:1])).collisions(Q),
        )
        > 20
    )


def test_both_engines_check_the_same_pairs(scene, engines):
    assert len(engines[1].geometry.collisionPairs) >= len(scene.checked_pairs)
    excluded = engines[0].model.nexclude
    names = len(scene.names)
    assert names * (names - 1) // 2 - excluded == len(scene.checked_pairs)


def test_kinematics_of_the_engine_is_that_of_pinocchio():
    engine = MujocoEngine(PlanningScene())
    kinematics = Kinematics()
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


def test_what_is_close_is_no_collision(engines):
    engine = engines[0]
    assert engine.closest(HOME, 1.0)
    assert not engine.contact_count(HOME)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 30, 100])
def test_bisection_order_holds_every_fraction_once(count):
    order = bisection_order(count)
    assert sorted(np.round(order * count).astype(int)) == list(range(1, count + 1))
    assert order[0] == 1.0


def test_padding_is_kept_and_relaxes_at_a_tight_start():
    """A start 2 mm from a box: with full padding it could never be left."""
    plain = MujocoEngine(PlanningScene())
    finger_z = min(
        p.distance_m
        for p in plain.closest(HOME, 1.0)
        if "finger" in p.first and p.second == "table"
    )
    x, y, _ = Kinematics().tcp_poses(HOME)[0][:3, 3]
    top = finger_z - 0.002
    scene = PlanningScene().with_obstacles(Box("block", (x, y, 0.5 * top), size_m=(0.2, 0.2, top)))
    engines = SceneEngines(scene)
    assert engines.closest(HOME, 0.01)[0].distance_m == pytest.approx(0.002, abs=1e-4)
    away = HOME.copy()
    away[3] += 0.3  # stretch the elbow: the hand rises
    assert not EdgeChecker(engines, 0.005, (), 0.03).free(HOME)
    relaxed = EdgeChecker(engines, 0.005, (HOME, away), 0.03)
    assert relaxed.free(HOME)
    assert relaxed.edge_free(HOME, away)
    nearer = SceneEngines(
        PlanningScene().with_obstacles(
            Box("block", (x, y, 0.5 * top + 4e-4), size_m=(0.2, 0.2, top)),
        ),
    )
    relaxed._geometry = nearer.solids.geometry
    assert not relaxed.free(HOME)  # 0.9 of its clearance is asked for at the tight end
    pressed = HOME.copy()
    pressed[3] -= 0.02
    assert not relaxed.free(pressed)


def test_distances_of_both_engines_are_the_same(scene, engines):
    """What MuJoCo measures within its margin is what coal does, up to the few percent by which its contacts are off."""
    engine, coal = engines
    exact = CoalDistances(scene, coal)
    seen = 0
    for q in states(60, seed=7):
        truth = dict(zip(map(frozenset, scene.checked_pairs), exact(q[None])[0], strict=True))
        for pair in engine.closest(q, 0.05):
            other = truth[frozenset((pair.first, pair.second))]
            if min(pair.distance_m, other) > 0.0:
                assert other == pytest.approx(pair.distance_m, rel=0.1, abs=1e-5)
                seen += 1
    assert seen > 200


def test_no_part_reaches_farther_than_its_reach(scene, engines):
    """Turning one joint moves no vertex by more than the reach times the angle; the bound is not absurdly wide."""
    solids = SceneEngines(scene).solids
    _, clusters, shapes, parts, _, reach = solids.geometry

    def points(q, k):
        work = solids.workspace()
        planes._place(solids.geometry, q, 0, work)
        R = work.R
        p = work.p
        own = clusters[shapes[parts[k]["first"]]["first"] : shapes[parts[k]["end"] - 1]["end"]]
        return own["vertices"].reshape(-1, 3) @ R[0, parts[k]["frame"]].T + p[0, parts[k]["frame"]]

    tightest = 0.0
    turn = 1e-3
    for q in states(10, seed=4):
        for k, name in enumerate(scene.names):
            side, joints_n = scene._moved_by[name]
            assert (reach[k] > 0.0).sum() == joints_n
            for j in range(7):
                other = q.copy()
                other[(7 if side == "right" else 0) + j] += turn
                moved = np.linalg.norm(points(other, k) - points(q, k), axis=1).max()
                assert moved <= reach[k, j] * turn + 1e-12
                if reach[k, j]:
                    tightest = max(tightest, moved / (reach[k, j] * turn))
    assert tightest > 0.8


def test_only_joints_between_two_links_move_them_against_each_other(scene, engines):
    pairs = SceneEngines(scene).solids.geometry.pairs
    where = {
        frozenset(names): {int(p["moves_a"]), int(p["moves_b"])}
        for names, p in zip(scene.checked_pairs, pairs, strict=True)
    }
    still = 8 * len(scene.names)

    def row(name):
        return 8 * scene.names.index(name)

    assert where[frozenset(("left_panda_hand", "table"))] == {row("left_panda_hand"), still}
    assert where[frozenset(("left_panda_link1", "left_panda_link5"))] == {
        row("left_panda_link5") + 1,
        still,
    }
    assert where[frozenset(("right_panda_link5", "right_panda_hand"))] == {
        row("right_panda_hand") + 5,
        still,
    }
    assert where[frozenset(("left_panda_hand", "right_panda_hand"))] == {
        row("left_panda_hand"),
        row("right_panda_hand"),
    }


def test_planes_answer_the_search_as_exact_distances_do(scene):
    engines = SceneEngines(scene)
    checker = EdgeChecker(engines, 0.008, (), 0.05)
    Q = states(200, seed=12)
    said = np.array([checker.free(q) for q in Q])
    assert checker.checks_n == len(Q)
    nearest = CoalDistances(scene, engines.engine("coal"))(Q).min(axis=1)
    clear = np.abs(nearest - 0.008) > 0.0008
    assert np.array_equal(said[clear], (nearest > 0.008)[clear])
    assert 0.2 < said.mean() < 0.8
