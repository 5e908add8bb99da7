"""A pot with two handles: an object of several parts, in reach of both hands, lifted by both."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from pydantic import ValidationError

from minidual.collision.shapes import Mesh
from minidual.config.root import Config, changed
from minidual.config.scene import ObjectConfig, PartConfig
from minidual.control.impedance_controllers import SLOW_AT
from minidual.motion.api import Planner
from minidual.motion.ik import PoseUnreachableError
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, pose, rot_x, rot_z
from minidual.skills.carry_motions import grasp_posture, posture_over
from minidual.skills.cycle import solve
from minidual.skills.states import State
from minidual.skills.things import thing_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import begin
from minidual.tasks.task import level_pose, placement, pose_of, tilt_rad
from minidual.tasks.truth import Truth
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench
from tests.support.placing import put_at

TASK = make_task(Config(task="pot_lift"))
POT = TASK.scene.object
LIMITS = TASK.scene.task
DRAWS = [TASK.trial(seed, "reach", 0) for seed in range(256)]


def surface(part: PartConfig) -> Array:
    """Return points (n, 3) on the edges of a part, in the object's frame."""
    turn = np.linspace(0.0, math.tau, 721)[:, None]
    ring = np.hstack([np.cos(turn), np.sin(turn)])
    if part.shape == "box":
        ring = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
    ends = [np.insert(ring, "xyz".index(part.axis), end, axis=1) for end in (-1.0, 1.0)]
    return np.vstack(ends) * part.half_m + part.position_m


@pytest.fixture(scope="module")
def world() -> World:
    return World(TASK.scene)


def test_starts_span_20_by_20_cm_and_60_degrees_and_goals_vary() -> None:
    starts = np.array([placement(draw.start["pot"]) for draw in DRAWS])
    goals = np.array([placement(draw.goal["pot"]) for draw in DRAWS])
    assert np.ptp(starts, axis=0) == pytest.approx([0.2, 0.2, math.radians(60.0)], rel=0.03)
    assert np.ptp(goals[:, :2], axis=0) == pytest.approx([0.06, 0.06], rel=0.05)
    assert LIMITS.goal_tolerance_m == 0.03
    assert LIMITS.clear_height_m == 0.10


def test_both_hands_reach_the_handles_of_every_draw_and_corner() -> None:
    """Over the handles, at them, and lifted; one search each, from the last posture."""
    x_middle, y_middle = LIMITS.start_xy_m
    range_m = LIMITS.start_range_m
    corners = [
        (x_middle + x_side * range_m, y_middle + y_side * range_m, turn * LIMITS.start_range_rad)
        for x_side, y_side, turn in itertools.product((-1, 1), repeat=3)
    ]
    drawn = [placement(poses["pot"]) for draw in DRAWS for poses in (draw.start, draw.goal)]
    for x, y, yaw in corners + drawn:
        q = DUAL_PANDA.home
        for height_m in (0.08, 0.0, LIMITS.lift_height_m):  # raises where a hand does not reach
            level = level_pose(x, y, POT.rest_height_m + height_m, yaw)
            q = grasp_posture(TASK.scene, DUAL_PANDA, level, q)
        left, right = Kinematics(DUAL_PANDA).tcp_poses(q)
        apart_m = np.linalg.norm(left[:3, 3] - right[:3, 3])
        assert apart_m == pytest.approx(2.0 * POT.grasp_offset_m, abs=1e-3)


def test_force_control_begins_far_from_singular_postures() -> None:
    """From home, descent may bend an arm until a carry slows down.

    Such a start gets the posture nearest to home.
    """
    kinematics = Kinematics(DUAL_PANDA)

    def condition(q: Array) -> float:
        jacobians = kinematics.tcp_jacobians(q)
        return max(
            np.linalg.cond(J[:, DUAL_PANDA.joints_of(arm)]) for arm, J in enumerate(jacobians)
        )

    for x, y, yaw, bent in ((0.441, 0.112, 0.505, True), (0.48, 0.12, 0.0, False)):
        level = level_pose(x, y, POT.rest_height_m, yaw)
        plain = grasp_posture(TASK.scene, DUAL_PANDA, level, DUAL_PANDA.home, above_m=0.08)
        over = posture_over(TASK.scene, DUAL_PANDA, level, 0.08)
        at_plain = grasp_posture(TASK.scene, DUAL_PANDA, level, plain)
        at_over = grasp_posture(TASK.scene, DUAL_PANDA, level, over)
        assert np.array_equal(plain, over) != bent
        assert (condition(at_plain) > SLOW_AT[0]) == bent
        assert condition(at_over) < 25.0
    with pytest.raises(PoseUnreachableError, match="cannot reach"):
        posture_over(TASK.scene, DUAL_PANDA, level_pose(1.2, 0.0, POT.rest_height_m, 0.0), 0.08)


def test_an_arm_frozen_at_home_is_far_above_every_draw() -> None:
    """`held` wants both hands' pinch from the first rise on: one arm alone fails all 256 draws.

    tests/tasks/test_adversaries.py lifts with one arm frozen, and is refused.
    """
    assert "held" in {condition.name for condition in TASK.success(TASK, DRAWS[0])}
    top_m = max(surface(part)[:, 2].max() for part in POT.solids)
    for tip in Kinematics(DUAL_PANDA).tcp_poses(DUAL_PANDA.home):
        for draw in DRAWS:
            assert isinstance(draw.start["pot"], tuple)  # on the table
            assert tip[2, 3] - POT.rest_height_m - top_m > 0.3


def test_every_part_is_in_the_model_and_inside_the_planners_shape() -> None:
    model = build_spec(TASK.scene, visuals=False).compile()
    body = model.body("pot")
    assert body.mass[0] == pytest.approx(POT.mass_kg)
    assert np.allclose(body.ipos, 0.0)
    assert np.allclose(sorted(body.inertia), sorted(POT.inertia_kg_m2), rtol=1e-9)
    solid = [
        g for g in range(model.ngeom) if model.geom_bodyid[g] == body.id and model.geom_contype[g]
    ]
    assert len(solid) == len(POT.solids) == 5
    shape = thing_of(POT).shape
    assert isinstance(shape, Mesh)
    for geom, part, corners in zip(solid, POT.solids, shape.vertices(), strict=True):
        assert np.allclose(model.geom_pos[geom], part.position_m)
        points = surface(part)
        directions = np.random.default_rng(1).standard_normal((200, 3))
        grown = (corners @ directions.T).max(axis=0) - (points @ directions.T).max(axis=0)
        assert grown.min() > -1e-9
        assert (grown / np.linalg.norm(directions, axis=1)).max() < 0.02 * max(part.half_m)


def test_clearance_is_that_of_the_lowest_part(world: World) -> None:
    truth = Truth(TASK.scene.objects)
    points = np.vstack([surface(part) for part in POT.solids])
    for roll, pitch in ((0.0, 0.0), (0.1, -0.2), (1.2, 0.3), (-1.0, 1.0), (math.pi, 0.0)):
        T = pose(rot_z(pitch) @ rot_x(pitch) @ rot_z(0.4) @ rot_x(roll), (0.5, 0.0, 0.3))
        put_at(world, "pot", T)
        truth.refresh(world)
        assert truth["pot"].clearance_m == pytest.approx((points @ T[2, :3]).min() + 0.3, abs=1e-5)
        assert truth["pot"].tilt_rad == pytest.approx(tilt_rad(T, POT), abs=1e-7)


def test_the_plate_stands_at_the_goal_of_the_trial(world: World) -> None:
    for draw in DRAWS[:3]:
        begin(world, TASK, draw)
        assert tuple(world.model.geom("goal_mark").pos[:2]) == pytest.approx(
            placement(draw.goal["pot"])[:2],
        )


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"grasp_offset_m": 0.20}, "no part holds the grasp"),
        ({"parts": ()}, "lies beyond the end"),
        ({"parts": (), "grasp_offset_m": 0.04}, "0.17 m between the fingers; at most 0.07"),
        ({"parts": ({"size_m": (0.03, 0.0, 0.02)},)}, "greater than or equal to 0.001"),
    ],
)
def test_an_object_that_no_hand_can_hold_is_refused(values: dict[str, object], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        ObjectConfig.model_validate(POT.model_dump() | values)


def test_a_planned_lift_carries_all_parts_to_the_goal() -> None:
    draw = DRAWS[0]
    start = State(DUAL_PANDA.home, {"pot": pose_of(POT, draw.start["pot"])})
    solution = solve(TASK, draw, start, Planner())
    carry = next(segment for segment in solution.segments if segment.phase == "carry")
    (attached,) = carry.scene.attached
    assert attached.shape.pieces == thing_of(POT).shape.pieces
    assert carry.verification is not None
    goal = pose_of(POT, draw.goal["pot"])
    hands = zip(SIDES, Kinematics(DUAL_PANDA).tcp_poses(carry.trajectory.q[-1]), strict=True)
    assert all(
        np.allclose(T, goal @ TASK.objects["pot"].grasps[side], atol=1e-3) for side, T in hands
    )


def test_the_pot_is_lifted_under_object_impedance_and_put_on_the_plate() -> None:
    bench = Bench("impedance", MethodInputs(TASK.config, 1))
    result, log = bench.run(bench.task.trial(1, "test", 0))
    assert result.success, result.text
    assert result.measured["progress"] == 1.0
    assert result.measured["rise_m"] > 0.11
    assert result.measured["internal_force_min_n"] > LIMITS.internal_force_min_n
    assert result.measured["goal_error_m"] < 0.005
    assert set(SIDES) == set(TASK.objects["pot"].grasps)
    assert log.pinch[-1].max() == 0.0


def test_where_the_arms_reach_no_higher_the_pot_is_lifted_as_high_as_the_task_asks() -> None:
    far = {"start_xy_m": (0.68, 0.12), "goal_xy_m": (0.68, -0.1), "lift_height_m": 0.4}
    values = {f"scene.task.{name}": value for name, value in far.items()}
    task = make_task(changed(Config(task="pot_lift"), values))
    trial = task.trial(20260, "benchmark", 102)
    start = State(DUAL_PANDA.home, {"pot": pose_of(POT, trial.start["pot"])})
    segments = solve(task, trial, start, Planner()).segments
    carried = next(segment for segment in segments if segment.phase in ("lift", "carry"))
    kinematics = Kinematics(DUAL_PANDA)
    postures = carried.trajectory.q[::20]
    heights_m = np.array([[T[2, 3] for T in kinematics.tcp_poses(q)] for q in postures])
    risen_m = (heights_m.max(axis=0) - heights_m[0]).min()
    assert task.scene.task.clear_height_m < risen_m < 0.2
