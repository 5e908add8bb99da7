"""The arbiter, rule by rule: who may drive, from where, how far at once, and what is refused by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from minidual.config.control import ArbiterConfig
from minidual.control.arbiter import ArbiterOutput, CommandArbiter
from minidual.control.commands import ArbiterState, JointCommand
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from tests.support.panda import A_MAX, HOME, Q_UPPER

DT = 0.02
STILL = np.zeros(14)


class Desk:
    """An arbiter with a clock, and arms that stand wherever they are told to."""

    def __init__(self, **config: Any) -> None:
        self.arbiter = CommandArbiter(DUAL_PANDA, ArbiterConfig(**config))
        self.now = 0.0
        self.q = HOME.copy()
        self.v = STILL
        self.sequence = 0
        self.refused: list[tuple[str, str]] = []

    def propose(
        self,
        source: str,
        q: Any,
        *,
        gripper: Any = (1.0, 1.0),
        age: float = 0.0,
        **fields: Any,
    ) -> str:
        """Propose a command stamped `age` ago; return the name of its refusal or an empty string."""
        self.sequence += 1
        sequence = fields.pop("sequence", self.sequence)
        command = JointCommand(
            np.asarray(q, float),
            np.asarray(gripper, float),
            self.now - age,
            sequence,
            **fields,
        )
        refusal = self.arbiter.propose(source, command)
        return "" if refusal is None else refusal.name

    def tick(self) -> ArbiterOutput:
        out = self.arbiter.tick(self.now, self.q, self.v)
        self.refused += [(r.source, r.name) for r in out.refusals]
        self.now = round(self.now + DT, 9)
        return out

    def drive(self, source: str, q: Any, **fields: Any) -> ArbiterOutput:
        """Propose and tick."""
        assert self.propose(source, q, **fields) == ""
        return self.tick()

    def hand_over(self, source: str) -> None:
        self.arbiter.request(source)
        for _ in range(2):
            out = self.tick()
        assert out.switched_to == source
        assert out.state == ArbiterState.WAITING


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_nobody_drives_until_requested(desk: Desk) -> None:
    out = desk.drive("policy", HOME + 0.05)
    assert out.state == ArbiterState.HOLDING
    assert out.active_source is None
    np.testing.assert_array_equal(out.q_target, HOME)


def test_a_switch_holds_the_measured_posture_then_lets_one_source_through(desk: Desk) -> None:
    desk.tick()
    desk.q = HOME + 0.03  # the arms stand elsewhere than the last target
    desk.arbiter.request("teleop")
    out = desk.drive("teleop", HOME + 0.05)
    assert out.state == ArbiterState.SETTLING
    np.testing.assert_array_equal(out.q_target, desk.q)
    out = desk.tick()
    assert out.switched_to == "teleop"
    out = desk.drive("teleop", HOME + 0.05)
    assert out.state == ArbiterState.ACTIVE
    assert out.active_source == "teleop"
    np.testing.assert_array_equal(out.q_target, HOME + 0.05)


def test_the_other_sources_are_not_heard(desk: Desk) -> None:
    desk.hand_over("teleop")
    desk.propose("policy", HOME - 0.05)
    out = desk.drive("teleop", HOME + 0.05)
    np.testing.assert_array_equal(out.q_target, HOME + 0.05)


def test_moving_arms_are_waited_for_and_then_the_switch_is_given_up(desk: Desk) -> None:
    desk.tick()
    desk.v = np.full(14, 0.2)
    desk.arbiter.request("policy")
    states = [desk.tick().state for _ in range(30)]
    assert states[:25] == [ArbiterState.SETTLING] * 25  # 0.5 s of 20 ms
    assert states[-1] == ArbiterState.STOPPED
    assert ("policy", "not_still") in desk.refused
    desk.v = STILL
    assert desk.drive("policy", HOME + 0.01).active_source is None, (
        "a switch given up must be asked for again"
    )
    desk.hand_over("policy")


def test_arms_that_come_to_rest_in_time_are_handed_over(desk: Desk) -> None:
    desk.tick()
    desk.v = np.full(14, 0.2)
    desk.arbiter.request("policy")
    for _ in range(10):
        assert desk.tick().state == ArbiterState.SETTLING
    desk.v = STILL
    assert desk.tick().switched_to == "policy"


def test_an_old_chunk_never_runs_after_a_switch(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    desk.hand_over("teleop")
    desk.hand_over("policy")
    out = desk.tick()
    assert out.state == ArbiterState.WAITING
    np.testing.assert_array_equal(out.q_target, HOME)
    assert desk.propose("policy", HOME + 0.05, age=0.09) == "before_switch"


def test_sources_are_told_to_drop_their_queues(desk: Desk) -> None:
    told: list[str] = []
    desk.arbiter.on_flush.append(told.append)
    desk.hand_over("policy")
    desk.hand_over("teleop")
    assert told == ["policy", "teleop"]


def test_asking_for_who_drives_already_changes_nothing(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    desk.arbiter.request("policy")
    assert desk.drive("policy", HOME + 0.06).state == ArbiterState.ACTIVE


def test_the_last_request_counts_and_the_others_are_named(desk: Desk) -> None:
    desk.arbiter.request("policy")
    desk.arbiter.request("moveit")
    desk.tick()
    assert desk.tick().switched_to == "moveit"
    assert desk.refused == [("policy", "superseded")]


def test_hold_takes_the_arms_from_everybody(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    desk.arbiter.request("hold")
    desk.tick()
    assert desk.tick().switched_to == "hold"
    assert desk.drive("policy", HOME + 0.05).state == ArbiterState.HOLDING


def test_a_far_first_command_is_aligned_at_a_bounded_rate_until_caught_up() -> None:
    desk = Desk(align_speed_rad_s=1.0)
    desk.hand_over("teleop")
    target = HOME + np.linspace(0.1, 0.3, 14)
    last = HOME
    ticks = 0
    for _ in range(100):
        out = desk.drive("teleop", target, gripper=(0.0, 0.0))
        assert np.abs(out.q_target - last).max() <= 1.0 * DT + 1e-12
        last = out.q_target
        ticks += 1
        if out.state == ArbiterState.ACTIVE:
            break
        assert out.state == ArbiterState.ALIGNING
        np.testing.assert_array_equal(
            out.gripper,
            [1.0, 1.0],
            "hands keep what they hold while aligning",
        )
    assert ticks == 15  # 0.3 rad at 0.02 rad a tick
    np.testing.assert_array_equal(last, target)
    np.testing.assert_array_equal(out.gripper, [0.0, 0.0])


def test_a_jump_in_the_middle_is_aligned_too(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    assert desk.drive("policy", HOME + 0.14).state == ArbiterState.ACTIVE
    out = desk.drive("policy", HOME + 0.34)
    assert out.state == ArbiterState.ALIGNING
    assert np.abs(out.q_target - (HOME + 0.14)).max() <= 0.1


def test_silence_holds_then_stops_and_is_reported(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    states = []
    for _ in range(60):
        out = desk.tick()
        states.append(out.state)
        np.testing.assert_array_equal(out.q_target, HOME + 0.05)
        assert (out.active_source is None) == (out.state != ArbiterState.ACTIVE)
    assert states[:5] == [ArbiterState.ACTIVE] * 5  # 0.1 s of 20 ms
    assert states[5] == ArbiterState.STALE
    assert states[-1] == ArbiterState.STOPPED
    assert desk.drive("policy", HOME + 0.05).state == ArbiterState.STOPPED


def test_a_source_that_comes_back_in_time_goes_on(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    for _ in range(8):
        state = desk.tick().state
    assert state == ArbiterState.STALE
    assert desk.drive("policy", HOME + 0.06).state == ArbiterState.ACTIVE


def test_a_source_that_never_speaks_loses_its_turn(desk: Desk) -> None:
    desk.hand_over("policy")
    assert [desk.tick().state for _ in range(60)][-1] == ArbiterState.STOPPED


def _with(index: int, value: float) -> Any:
    q = HOME.copy()
    q[index] = value
    return q


@pytest.mark.parametrize(
    ("name", "q", "fields"),
    [
        ("not_finite", _with(3, np.nan), {}),
        ("not_finite", _with(3, np.inf), {}),
        ("not_finite", HOME, {"gripper": (np.nan, 1.0)}),
        ("all_zero", np.zeros(14), {}),
        ("all_zero", np.zeros(7), {"group": "left_arm"}),
        ("out_of_limits", _with(8, float(Q_UPPER[8]) + 0.01), {}),
        ("gripper_out_of_range", HOME, {"gripper": (0.0, 1.2)}),
        ("wrong_shape", HOME[:13], {}),
        ("wrong_shape", HOME, {"group": "left_arm"}),
        ("unknown_group", HOME, {"group": "both"}),
        ("out_of_order", HOME, {"sequence": 1}),
    ],
)
def test_bad_commands_are_refused_and_named_and_do_not_drive(
    desk: Desk,
    name: str,
    q: Any,
    fields: Any,
) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    assert desk.propose("policy", q, **fields) == name
    out = desk.tick()
    assert desk.refused == [("policy", name)]
    np.testing.assert_array_equal(out.q_target, HOME + 0.05)


def test_a_source_that_sends_only_refused_commands_goes_stale(desk: Desk) -> None:
    desk.hand_over("policy")
    desk.drive("policy", HOME + 0.05)
    for _ in range(8):
        desk.propose("policy", np.zeros(14))
        out = desk.tick()
    assert out.state == ArbiterState.STALE


def test_the_refusal_names_joint_value_and_bound(desk: Desk) -> None:
    refusal = desk.arbiter.propose("policy", JointCommand(_with(8, 1.9), np.ones(2), 0.0, 1))
    assert refusal is not None
    assert refusal.detail == "right_panda_joint2 = 1.9000000 rad; -1.7628 to 1.7628"


def test_a_stamp_from_the_future_is_dropped(desk: Desk) -> None:
    desk.hand_over("policy")
    assert desk.propose("policy", HOME + 0.05, age=-5.0) == ""
    out = desk.tick()
    assert out.state == ArbiterState.WAITING
    assert ("policy", "from_future") in desk.refused


def test_one_arm_drives_while_the_other_is_held(desk: Desk) -> None:
    desk.hand_over("moveit")
    out = desk.drive("moveit", HOME[:7] + 0.05, gripper=(0.0, 0.0), group="left_arm")
    np.testing.assert_array_equal(out.q_target, np.r_[HOME[:7] + 0.05, HOME[7:]])
    np.testing.assert_array_equal(out.gripper, [0.0, 1.0])
    out = desk.drive("moveit", HOME[7:] - 0.05, group="right_arm")
    np.testing.assert_array_equal(out.q_target, np.r_[HOME[:7] + 0.05, HOME[7:] - 0.05])
    for _ in range(5):  # the left arm's command grows stale
        out = desk.drive("moveit", HOME[7:] - 0.05, group="right_arm")
    np.testing.assert_array_equal(out.q_target[:7], HOME[:7] + 0.05)


@pytest.mark.parametrize("other", ["streams", "falls silent too"])
def test_an_arm_whose_commands_end_in_motion_stops_where_it_can(desk: Desk, other: str) -> None:
    """It does not go on to its last target, whether or not the other arm's commands come."""
    desk.hand_over("teleop")
    for k in range(1, 6):  # targets run ahead of arms that an override slows down
        assert desk.propose("teleop", HOME[:7] + 0.07 * k, group="left_arm") == ""
        desk.drive("teleop", HOME[7:] + 0.01 * k, group="right_arm")
    desk.q = HOME + 0.1
    desk.v = np.where(np.arange(14) < 7, 0.2, 0.0)
    for _ in range(10):
        if other == "streams":
            assert desk.propose("teleop", HOME[7:] + 0.05, group="right_arm") == ""
        out = desk.tick()
    # Within the distance in which it comes to rest with half of its acceleration limits.
    assert (out.q_target[:7] >= HOME[:7] + 0.1).all()
    assert (out.q_target[:7] <= HOME[:7] + 0.1 + 0.2**2 / A_MAX[:7] + 1e-12).all()
    np.testing.assert_array_equal(
        out.q_target[7:],
        HOME[7:] + (0.05 if other == "streams" else 0.1),
    )
    assert out.state == (ArbiterState.ACTIVE if other == "streams" else ArbiterState.STALE)
    assert desk.refused == ([("teleop", "stale")] if other == "streams" else [])
    out = desk.drive("teleop", HOME[:7] + 0.1, group="left_arm")
    np.testing.assert_array_equal(out.q_target[:7], HOME[:7] + 0.1, "it may come back")


def test_grippers_keep_their_grip_through_a_switch(desk: Desk) -> None:
    desk.hand_over("teleop")
    desk.drive("teleop", HOME, gripper=(0.0, 0.0))
    desk.arbiter.request("policy")
    for _ in range(4):
        np.testing.assert_array_equal(desk.tick().gripper, [0.0, 0.0])


def test_misuse_is_named(desk: Desk) -> None:
    with pytest.raises(UsageError, match=r"(?s)no mode 'polcy'.*did you mean 'policy'"):
        desk.arbiter.request("polcy")
    with pytest.raises(
        UsageError,
        match="no command source 'leader'; there are moveit, policy, teleop",
    ):
        desk.propose("leader", HOME)


def test_a_step_at_a_start_that_fades_beyond_the_acceleration_limits_is_refused() -> None:
    with pytest.raises(ValueError, match="switch_step_max_rad"):
        ArbiterConfig(switch_step_max_rad=0.5)
