"""Objects and motions: consistent with mechanics, carried, and judged both ways."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config, preset
from minidual.config.scene import OBSTACLE, ObstacleConfig, TaskConfig
from minidual.control.gripper import pinch_force
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.carry_motions import grasp_posture, posture_over
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.stages.config_checks import check_carry
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.judge import Judge, Outcome
from minidual.tasks.objects import MOTIONS, OBJECTS
from minidual.tasks.rod_carry import carry_config
from minidual.tasks.task import Trial, placement, pose_of
from tests.support.carries import impedance_carry
from tests.support.panda import FINGER_TRAVEL_M


def configured(**carry: Any) -> Config:
    return carry_config(Config.model_validate({"carry": carry}))


def trial_of(config: Config, index: int = 0) -> Trial:
    return make_task(config).trial(7, "objects", index)


def carried(
    config: Config,
    *,
    until: str | None = None,
    index: int = 0,
) -> tuple[Outcome, ImpedanceCarry]:
    """Carry to the end, or until the judge has noted a fault of that name."""
    world = World(config.scene)
    task = make_task(config)
    trial = trial_of(config, index)
    world.reset(poses=trial.start)
    carry = impedance_carry(world, Kinematics(), config.carry, trial, seed=7)
    judge = Judge(task, trial, {"squeezed"})
    while not carry.done and not judge.finished:
        carry.step()
        judge.observe(world)
        if until in judge.failures:
            break
    return judge.outcome(world), carry


def test_the_rod_on_its_straight_way_is_the_configuration_itself() -> None:
    assert carry_config(Config()) == Config()
    assert carry_config(Config()).model_dump_json() == Config().model_dump_json()


RECOMMENDED = {
    "rod": (25.0, 40.0, 300.0, 500.0),
    "board": (20.0, 30.0, 400.0, 600.0),
    "box": (40.0, 60.0, 300.0, 500.0),
    "glass": (10.0, 15.0, 100.0, 200.0),
}
"""Squeeze [N] and stiffness [N/m], as in docs/carry.md."""


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_is_carried_as_it_is_recommended_and_the_pads_can_hold_it(name: str) -> None:
    config = configured(object=name)
    rod = config.scene.object
    impedance = config.carry.impedance
    least, most, soft, stiff = RECOMMENDED[name]
    assert least <= impedance.internal_force_n <= most
    assert soft <= impedance.stiffness_n_per_m <= stiff
    # Two pads a hand carry the squeeze and half the weight by friction.
    carried_n = math.hypot(impedance.internal_force_n, 0.5 * 9.81 * rod.mass_kg)
    assert 2.0 * rod.friction * impedance.pinch_n > 1.25 * carried_n
    assert impedance.pinch_n <= config.scene.physics.finger_force_max_n <= 140.0
    assert impedance.pinch_n > config.scene.task.pinch_min_n
    assert 2.0 * rod.half_width_m < 2.0 * FINGER_TRAVEL_M - 0.01
    assert config.scene.task.internal_force_min_n == min(20.0, least)
    if rod.break_pinch_n is not None and rod.break_force_n is not None:
        assert 1.3 * impedance.pinch_n < rod.break_pinch_n, (
            "a firmer pinch does not break it either"
        )
        assert impedance.internal_force_n + impedance.force_correction_max_n < rod.break_force_n


@pytest.mark.parametrize("name", OBJECTS)
def test_what_the_law_is_told_of_mass_and_inertia_is_what_the_simulator_has(name: str) -> None:
    world = World(configured(object=name).scene)
    body = world.model.body(name)
    rod = world.scene.object
    assert body.mass[0] == pytest.approx(rod.mass_kg, rel=1e-12)
    # MuJoCo keeps principal axes of its own; the sets of moments must agree.
    assert np.allclose(sorted(body.inertia), sorted(rod.inertia_kg_m2), rtol=1e-9)
    assert world.object_pose()[2, 3] == rod.rest_height_m
    while world.time < 0.2:
        world.step()
    assert world.on_table()
    assert (
        abs(world.object_pose()[2, 3] - rod.rest_height_m) < 2e-4
    )  # it stands on the table, not in it or above it


def test_what_somebody_has_set_stays_and_a_second_call_changes_nothing() -> None:
    once = carry_config(
        Config.model_validate(
            {
                "carry": {"object": "board", "impedance": {"internal_force_n": 21.0}},
                "scene": {"object": {"mass_kg": 1.4}},
            },
        ),
    )
    assert once.carry.impedance.internal_force_n == 21.0
    assert once.scene.object.mass_kg == 1.4
    assert once.scene.object.length_m == 0.40
    assert carry_config(once) == once


def test_an_object_of_ones_own_gets_the_pinch_that_its_squeeze_needs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rows from outside get it as those of the package do."""
    row = {
        "carry.impedance.internal_force_n": 40.0,
        "scene.object.friction": 0.3,
        "scene.object.mass_kg": 0.2,
    }
    monkeypatch.setitem(OBJECTS._rows, "bottle", row)
    monkeypatch.setitem(OBJECTS._rows, "safer", {**row, "safety": 1.8})
    monkeypatch.setitem(OBJECTS._rows, "told", {**row, "carry.impedance.pinch_n": 90.0})
    pinch_n = {
        name: configured(object=name).carry.impedance.pinch_n
        for name in ("bottle", "safer", "told")
    }
    assert pinch_n["bottle"] == pytest.approx(pinch_force(40.0, 0.3, 0.2), abs=0.05)
    assert pinch_n["safer"] == pytest.approx(pinch_force(40.0, 0.3, 0.2, safety=1.8), abs=0.05)
    assert pinch_n["told"] == 90.0


@pytest.mark.parametrize("task", TASKS)
def test_the_stage_carries_nothing_that_both_hands_do_not_hold(task: str) -> None:
    if task in ("rod_carry", "pot_lift"):
        check_carry(Config(task=task))
        return
    with pytest.raises(UsageError, match=f"in the task '{task}' they do not") as caught:
        check_carry(Config(task=task))
    assert f"teleop-record --task {task}" in str(caught.value)


def test_an_obstacle_that_somebody_has_set_stays_where_it_was_set() -> None:
    scene = {"task": {"obstacle": {"xy_m": [0.5, 0.08]}}}
    once = carry_config(Config.model_validate({"carry": {"motion": "over"}, "scene": scene}))
    default = configured(motion="over").scene.task.obstacle
    assert default is not None
    assert once.scene.task.obstacle is not None
    assert once.scene.task.obstacle.xy_m == (0.5, 0.08) != default.xy_m
    assert once.scene.task.obstacle.size_m == default.size_m
    assert once.scene.task.lift_height_m == 0.17
    assert carry_config(once) == once


def test_a_part_that_is_set_is_filled_where_it_is_open() -> None:
    section = TaskConfig.model_validate({"obstacle": {"xy_m": [0.5, 0.08]}})
    table = ObstacleConfig.model_validate({"xy_m": [0.4, 0.0], "size_m": [0.1, 0.1, 0.1]})
    obstacle = preset(section, {"obstacle": table}).obstacle
    assert obstacle is not None
    assert (obstacle.xy_m, obstacle.size_m) == ((0.5, 0.08), (0.1, 0.1, 0.1))
    assert preset(TaskConfig(), {"obstacle": table}).obstacle == table


@pytest.mark.parametrize(
    ("carry", "message"),
    [({"object": "glas"}, "'glass'"), ({"motion": "rotat"}, "'rotate'")],
)
def test_an_unknown_name_is_refused_with_the_nearest_one(
    carry: dict[str, str],
    message: str,
) -> None:
    with pytest.raises(UsageError) as caught:
        configured(**carry)
    assert message in str(caught.value)


@pytest.mark.parametrize("name", [name for name in OBJECTS if name != "rod"])
def test_every_object_is_carried(name: str) -> None:
    outcome, carry = carried(configured(object=name))
    assert outcome.success, outcome.reason
    assert carry.fault is None
    assert outcome.number("tilt_max_rad") < 0.0349
    assert outcome.duration_s < 8.0


def test_a_glass_squeezed_too_hard_breaks() -> None:
    hard = configured(object="glass", impedance={"internal_force_n": 24.0, "pinch_n": 38.0})
    outcome, _ = carried(hard, until="whole")
    assert not outcome.success
    assert outcome.failures[0].name == "whole"
    assert "limit 20" in outcome.reason


def test_a_glass_pinched_too_hard_breaks() -> None:
    outcome, _ = carried(configured(object="glass", impedance={"pinch_n": 48.0}), until="whole")
    assert outcome.failures[0].name == "whole"
    assert "pinched" in outcome.reason


def test_the_object_is_turned_by_ninety_degrees() -> None:
    config = configured(motion="rotate")
    outcome, carry = carried(config)
    assert outcome.success, outcome.reason
    axis = carry.plant.object_pose()[:3, 1]
    goal_yaw = placement(trial_of(config).goal["rod"])[2]
    assert goal_yaw == pytest.approx(-np.pi / 2)
    assert abs(axis[0]) > 0.999  # it lay along y, and lies along x
    assert outcome.number("yaw_error_rad") < 0.02
    assert outcome.duration_s < 8.0


def test_hands_open_only_when_the_elbows_swing_no_more() -> None:
    outcome, carry = carried(configured(object="board", motion="rotate"), index=7)
    assert outcome.success, (outcome.reason, carry.aborted)


def test_it_is_lifted_over_the_obstacle_and_lower_it_would_strike() -> None:
    outcome, _ = carried(configured(motion="over"))
    assert outcome.success, outcome.reason
    low = carry_config(
        Config.model_validate(
            {"carry": {"motion": "over"}, "scene": {"task": {"lift_height_m": 0.07}}},
        ),
    )
    outcome, _ = carried(low, until="clear")
    assert not outcome.success
    assert "clear" in {fault.name for fault in outcome.failures}


def test_only_the_way_over_has_an_obstacle() -> None:
    for name in MOTIONS:
        model = World(configured(motion=name).scene).model
        names = {model.geom(i).name for i in range(model.ngeom)}
        assert (OBSTACLE in names) == (name == "over")


def test_no_start_or_goal_touches_the_obstacle() -> None:
    config = configured(object="board", motion="over")
    world = World(config.scene)
    task = make_task(config)
    for index in range(40):
        trial = task.trial(7, "objects", index)
        for poses in (trial.start, trial.goal):
            world.reset(poses=poses)
            assert not world.touches(OBSTACLE), (index, poses)


def test_an_obstacle_that_leaves_no_room_is_refused() -> None:
    wide = ObstacleConfig(size_m=(0.6, 1.0, 0.1)).model_dump()
    config = Config.model_validate(
        {"carry": {"motion": "over"}, "scene": {"task": {"obstacle": wide}}},
    )
    with pytest.raises(UsageError, match="no room beside the obstacle"):
        make_task(config).trial(7, "objects", 0)


@pytest.mark.parametrize("name", ["rod", "glass"])
def test_arms_begin_on_the_branch_of_home(name: str) -> None:
    """At this start the descent from home turns the left shoulder over; the arms would meet."""
    scene = configured(object=name, motion="rotate").scene
    level = pose_of(scene.object, (0.471, 0.201, 0.25))
    plain = grasp_posture(scene, DUAL_PANDA, level, DUAL_PANDA.home, above_m=0.08)
    assert np.abs(plain - DUAL_PANDA.home)[[0, 2]].min() > 2.0
    over = posture_over(scene, DUAL_PANDA, level, 0.08)
    assert np.abs(over - DUAL_PANDA.home).max() < 1.6
    tips = [Kinematics(DUAL_PANDA).tcp_poses(q) for q in (plain, over)]
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-5)
