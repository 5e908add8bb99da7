"""What sources may do: commands that are refused, silence, and where arms stop that nobody drives any more."""

from __future__ import annotations

import re
import types
from typing import Any

import numpy as np
import pytest

from minidual.config.control import ArbiterConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand, ObjectCommand
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.control_plant import HandsObject
from tests.support.panda import DOF, HOME, Q_UPPER
from tests.support.stacks import (
    OPEN,
    Arms,
    hand_over,
    move,
    off_by,
    run,
    supervised,
    trajectory,
)


@pytest.fixture
def plant(scene: SceneConfig) -> Arms:
    return Arms(scene)


# Commands that are refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [1, 50])
def test_velocities_that_do_not_belong_to_their_positions_are_refused(
    plant: Arms,
    every: int,
) -> None:
    """Waypoints with zero velocities."""
    stack = supervised(plant)
    hand_over(stack, "moveit")
    motion = move(HOME, HOME + 0.4, 0.8)
    q = motion.q[::every]
    times = np.arange(len(q)) * motion.dt_s * every
    still = Trajectory(times, q, 0.0 * q, 0.0 * q, "both_arms")
    refusal = stack.propose("moveit", trajectory(stack, still))
    assert refusal is not None
    assert refusal.name == "too_sharp"
    assert "velocities do not belong to its positions" in refusal.detail
    assert stack.propose("moveit", trajectory(stack, motion, 2)) is None


@pytest.mark.parametrize(
    ("name", "q", "v", "joint"),
    [
        ("too_fast", [0.0, 2.1], [0.0, 0.0], 0),
        ("out_of_limits", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 6),
    ],
)
def test_the_motion_between_coarse_samples_is_bounded_too(
    plant: Arms,
    name: str,
    q: list[float],
    v: list[float],
    joint: int,
) -> None:
    stack = supervised(plant)
    hand_over(stack, "moveit")
    row = np.eye(DOF)[joint]
    start = HOME.copy()
    if name == "out_of_limits":
        start[joint] = Q_UPPER[joint] - 1e-3
    positions = start + np.array(q)[:, None] * row
    speeds = np.array(v)[:, None] * row
    times = np.arange(len(q), dtype=float)
    motion = Trajectory(times, positions, speeds, np.zeros_like(speeds), "both_arms")
    refusal = stack.propose("moveit", trajectory(stack, motion))
    assert refusal is not None
    assert refusal.name == name


@pytest.mark.parametrize("step_rad", [0.02, 0.04])
def test_a_trajectory_does_not_begin_on_an_arm_that_moves(plant: Arms, step_rad: float) -> None:
    stack = supervised(plant)
    q = HOME.copy()
    hand_over(stack, "moveit")
    sequence = 0
    for _ in range(461):
        if stack.tick_next:
            sequence += 1
            q[[0, 1, 7, 8]] += step_rad
            stack.propose("moveit", JointCommand(q, OPEN, plant.time, sequence))
        run(stack, 1)
    assert np.abs(plant.v).max() > 0.7
    motion = move(plant.q, plant.q + 0.1 * np.eye(DOF)[6], 1.0)
    stack.propose("moveit", trajectory(stack, motion, sequence + 1))
    assert run(stack, 20) == []
    assert "not_still" in [refusal.name for refusal in stack.refusals]
    assert run(stack, 600) == []


def test_refusals_are_counted_and_the_last_are_kept(plant: Arms) -> None:
    stack = supervised(plant)
    began_n = stack.refused_n
    for k in range(1500):
        wrong = JointCommand(np.full(DOF, np.nan), OPEN, plant.time, k + 1)
        assert stack.propose("teleop", wrong) is not None
        stack.arbitrate()
    assert stack.refused_n - began_n == 1500
    assert len(stack.refusals) == 1000
    assert stack.refused_since(stack.refused_n) == []
    assert stack.refused_since(stack.refused_n - 3) == stack.refusals[-3:]
    assert stack.refused_since(began_n) == stack.refusals
    stack.reset()
    assert (stack.refusals, stack.refused_n) == ([], 0)


def test_a_long_trajectory_does_not_hold_up_the_tick_in_which_it_starts(plant: Arms) -> None:
    """It is sampled in parts, whose rows are those of the whole."""
    stack = supervised(plant)
    hand_over(stack, "moveit")
    sampled_n: list[int] = []
    command = trajectory(stack, move(HOME, HOME + 0.4, 60.0))
    sample_many = command.motion.sample_many

    def counting(times: np.ndarray) -> object:
        sampled_n.append(len(times))
        return sample_many(times)

    object.__setattr__(command.motion, "sample_many", counting)
    assert stack.propose("moveit", command) is None
    sampled_n.clear()
    references = []
    for _ in range(1500):
        run(stack, 1)
        references.append(stack.manager.reference.copy())
    assert max(sampled_n) <= 500
    first = next(k for k, q in enumerate(references) if not np.array_equal(q, HOME)) - 1
    times = np.arange(len(references) - first) * plant.dt
    np.testing.assert_allclose(references[first:], sample_many(times)[0], atol=1e-12)


# Trajectories and object paths ---------------------------------------------------------------------------------------------------


def _bad(motion: Trajectory, **changes: Any) -> Any:
    """A trajectory with values that Trajectory itself would not let through."""
    fields = {
        n: getattr(motion, n) for n in ("times", "q", "v", "a", "dt_s", "duration_s", "sample_many")
    }
    return types.SimpleNamespace(**{**fields, **changes})


def _edited(values: Array, row: int, column: int, value: float) -> Array:
    values = values.copy()
    values[row, column] = value
    return values


@pytest.mark.parametrize(
    ("name", "detail"),
    [
        ("not_finite", "left_panda_joint3 = nan in sample 5"),
        ("not_finite", "velocity"),
        ("all_zero", "every joint"),
        ("out_of_limits", "left_panda_joint4 = 0.5000000 rad in sample 9"),
        ("too_fast", "right_panda_joint7"),
        ("not_at_rest", "ends with left_panda_joint1"),
        ("too_sharp", "left_panda_joint2"),
        ("too_sharp", "left_panda_joint5"),
        ("wrong_shape", r"trajectory \(501, 13\)"),
        ("gripper_out_of_range", "1.2"),
        ("unknown_group", "no group 'arms'"),
    ],
)
def test_a_bad_trajectory_is_refused_when_it_is_proposed(
    plant: Arms,
    name: str,
    detail: str,
) -> None:
    good = move(HOME, HOME + 0.2, 0.5)
    bad: dict[str, Any] = {
        "left_panda_joint3 = nan in sample 5": {"q": _edited(good.q, 5, 2, np.nan)},
        "velocity": {"v": _edited(good.v, 5, 2, np.inf)},
        "every joint": {"q": 0.0 * good.q},
        "left_panda_joint4 = 0.5000000 rad in sample 9": {"q": _edited(good.q, 9, 3, 0.5)},
        "right_panda_joint7": {"q": _edited(good.q, 100, 13, good.q[100, 13] + 0.05)},
        "ends with left_panda_joint1": {"v": _edited(good.v, -1, 0, 0.4)},
        "left_panda_joint2": {"a": _edited(good.a, 7, 1, -9.0)},
        "left_panda_joint5": {"v": _edited(good.v, 100, 4, good.v[100, 4] + 0.1)},
        r"trajectory \(501, 13\)": {"q": good.q[:, :13]},
    }
    stack = supervised(plant)
    hand_over(stack, "moveit")
    fields: dict[str, Any] = {}
    if name == "gripper_out_of_range":
        fields["gripper"] = np.array([0.0, 1.2])
    if name == "unknown_group":
        fields["group"] = "arms"
    refusal = stack.propose(
        "moveit",
        trajectory(stack, _bad(good, **bad.get(detail, {})), **fields),
    )
    assert refusal is not None
    assert refusal.name == name
    assert re.search(detail, refusal.detail)
    stack.step()
    assert not stack.executing


def test_a_trajectory_is_refused_for_where_and_when_it_starts(plant: Arms) -> None:
    stack = supervised(plant)
    hand_over(stack, "moveit")
    far = HOME.copy()
    far[9] += 0.2
    stack.propose("moveit", trajectory(stack, move(far, HOME, 0.5), 1))
    stack.step()
    assert stack.refusals[-1].name == "far_start"
    assert "+0.200 rad away from the arms at right_panda_joint3" in stack.refusals[-1].detail

    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.2, 0.5), 2))
    stack.step()
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.2, 0.5), 3))
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.2, 0.5), 3))
    stack.step()
    assert stack.refusals[-1].name == "busy"
    stack.propose("moveit", JointCommand(HOME, OPEN, plant.time, 4))
    for _ in range(21):
        stack.step()
    assert stack.refusals[-1].name == "busy", "a streamed target does not disturb a trajectory"
    assert stack.executing

    stack.request("teleop")
    while stack.source != "teleop":
        stack.step()
    refusal = stack.propose("moveit", trajectory(stack, move(HOME, HOME, 0.5), 9, stamp_s=0.0))
    assert refusal is not None
    assert refusal.name == "before_switch"
    stack.request("moveit")
    stack.propose(
        "moveit",
        trajectory(stack, move(plant.q, HOME, 0.5), 10, stamp_s=plant.time + 5.0),
    )
    while stack.source != "moveit":
        stack.step()
    assert stack.refusals[-1].name in ("from_future", "before_switch")


def test_an_object_command_is_held_to_its_bounds(plant: Arms) -> None:
    here = HandsObject(plant)
    stack = supervised(plant, sensor=here)
    hand_over(stack, "moveit")
    x, y, z = here.pose()[:3, 3]

    def command(
        dz: float,
        seconds: float,
        squeeze: float,
        sequence: int,
        **lies: Array,
    ) -> ObjectCommand:
        path = ObjectPath(Waypoint((x, y, z), 0.0, 0.0), [Waypoint((x, y, z + dz), 0.0, seconds)])
        honest = path.at
        path.at = lambda t, *T: honest(t, *T)._replace(**lies)  # type: ignore[method-assign]
        return ObjectCommand(path, lambda t: squeeze, OPEN, plant.time, sequence)

    still = np.zeros(6)
    falls = np.array([0.0, 0.0, -9.8, 0.0, 0.0, 0.0])
    commands = {
        "squeeze": command(0.1, 1.0, 90.0, 1),
        "squeeze of NaN": command(0.1, 1.0, np.nan, 2),
        "fast": command(0.9, 1.5, 40.0, 3),
        "sharp": command(0.4, 0.3, 40.0, 4),
        "says that it falls": command(0.0, 1.0, 40.0, 5, acceleration=falls),
        "says that it stands": command(0.5, 0.6, 40.0, 6, twist=still, acceleration=still),
    }
    refusals = {what: stack.propose("moveit", one) for what, one in commands.items()}
    assert {what: refusal and refusal.name for what, refusal in refusals.items()} == {
        "squeeze": "squeeze_out_of_range",
        "squeeze of NaN": "not_finite",
        "fast": "too_fast",
        "sharp": "too_sharp",
        "says that it falls": "too_sharp",
        "says that it stands": "too_fast",
    }
    assert stack.propose("moveit", command(0.05, 1.0, 0.0, 4)) is None
    stack.step()
    assert stack.refusals[-1].name == "wrong_controller", "a joint controller takes no object path"


# Silence ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("then", ["silence", "one arm's silence", "hold"])
@pytest.mark.parametrize("away_rad", [0.5, 0.25])
def test_arms_that_brake_onto_a_target_stop_there(
    plant: Arms,
    away_rad: float,
    then: str,
) -> None:
    goal = HOME[1] + 0.8
    q = HOME.copy()
    speaks = True
    stack = supervised(plant)
    hand_over(stack, "teleop")
    farthest = 0.0
    for tick in range(2000):
        if stack.tick_next:
            if plant.v[1] > 0.5 and goal - plant.q[1] < away_rad:
                speaks = False
            if speaks:
                q[1] = min(goal, q[1] + 0.08)
                one_arm = then == "one arm's silence"
                target = q[:7] if one_arm else q
                group = "left_arm" if one_arm else "both_arms"
                command = JointCommand(target, OPEN, plant.time, 2 * tick + 1, group)
                stack.propose("teleop", command)
            elif then == "hold" and stack.source is not None:
                stack.request("hold")
            if then == "one arm's silence":
                still = JointCommand(HOME[7:], OPEN, plant.time, 2 * tick + 2, "right_arm")
                stack.propose("teleop", still)
        run(stack, 1)
        farthest = max(farthest, plant.q[1])
    assert not speaks
    assert farthest < goal + 0.003
    assert np.abs(plant.v).max() < 1e-3


@pytest.mark.parametrize("first_wrong_tick", [580, 600, 620])
def test_one_velocity_sample_moves_no_resting_arm_when_its_source_falls_silent(
    plant: Arms,
    first_wrong_tick: int,
) -> None:
    stack = supervised(plant)
    hand_over(stack, "teleop")
    for tick in range(1000):
        if stack.tick_next and tick < 500:
            stack.propose("teleop", JointCommand(HOME, OPEN, plant.time, tick))
        if first_wrong_tick <= tick < first_wrong_tick + 20 and stack.tick_next:
            plant.lies["v"] = off_by(1, 2.0)
        run(stack, 1)
        plant.lies.clear()
    assert np.abs(plant.q - HOME).max() < 1e-3


def test_an_arm_that_nobody_drives_does_not_sink_when_the_others_source_falls_silent(
    plant: Arms,
) -> None:
    stack = supervised(plant)
    hand_over(stack, "teleop")
    plant.pushed[8] = 1.0
    run(stack, 300)
    target = HOME[:7].copy()
    for tick in range(600):
        if stack.tick_next and tick < 400:
            target[0] += 0.08
            command = JointCommand(target, OPEN, plant.time, tick + 1, "left_arm")
            assert stack.propose("teleop", command) is None
        run(stack, 1)
    assert stack.state is not ArbiterState.ACTIVE
    np.testing.assert_allclose(stack.output.q_target[7:], HOME[7:], atol=1e-12)
    assert abs(stack.output.q_target[0] - target[0]) > 0.01, "the silent arm stops where it can"


@pytest.mark.parametrize(
    ("share", "then", "after"),
    [(0.1, "silence", 120), (0.1, "hold", 500), (1.0, "hold", 200)],
)
def test_arms_that_brake_beside_their_path_stay_there(
    plant: Arms,
    share: float,
    then: str,
    after: int,
) -> None:
    """The rest of the way to a path that starts beside the arms is not travelled when nobody drives."""
    stack = supervised(plant, config=ArbiterConfig(speed_override=share))
    hand_over(stack, "moveit")
    start = HOME + 0.099
    assert stack.propose("moveit", trajectory(stack, move(start, start, 1.0))) is None
    assert run(stack, after) == []
    if then == "hold":
        stack.request("hold")
    stack.dead = True  # type: ignore[attr-defined]
    run(stack, 300)
    rest = plant.q.copy()
    run(stack, 1500)
    assert stack.output.active_source is None
    assert np.abs(plant.q - rest).max() < 0.015
    assert np.abs(plant.q - start).max() > 0.015
