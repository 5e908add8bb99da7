"""One episode through the arbiter: what is recorded is what led to the next state, and faults are named."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.leading import MirrorConfig
from minidual.config.learning import TeleopConfig
from minidual.control.joint_control import JointLoop
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders.scripted import ScriptedLeader
from minidual.demos.mirror import check_start, leader_joints
from minidual.demos.session import (
    SessionResult,
    TeleopSession,
    Tick,
)
from minidual.errors import UsageError
from minidual.plant.render import StampedImage
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.operator import ScriptedOperator
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.panda import HOME

SEED = 7


def _session(
    world: World,
    pictures: Callable[[], dict[str, StampedImage]] = dict,
    **teleop: float,
) -> TeleopSession:
    config = TeleopConfig.model_validate(teleop)
    stack = ControlStack(world, Kinematics(), rate_hz=config.rate_hz)
    return TeleopSession(stack, config, pictures)


def _run(
    session: TeleopSession,
    index: int,
    length: int | None = None,
) -> tuple[SessionResult, list[Tick]]:
    scene = session.world.scene
    trial = sample_trial(scene, SEED, "demonstrations", index, widen=1.3)
    ticks: list[Tick] = []
    demonstration = ScriptedOperator(scene).plan(trial, seed=SEED)
    if length is not None:
        demonstration = dataclasses.replace(demonstration, q=demonstration.q[:length])
    result = session.run(
        carry_task(session.world.scene),
        trial,
        ScriptedLeader(demonstration),
        on_tick=ticks.append,
    )
    return result, ticks


def test_joints_and_pictures_bear_the_times_of_their_reading(
    world: World,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The camera whose picture is furthest from the joints in time counts."""

    def pictures() -> dict[str, StampedImage]:
        nothing = np.zeros((2, 2, 3), np.uint8)
        fresh = StampedImage(nothing, world.time)
        late = StampedImage(nothing, world.time - 0.01)
        return {"high": fresh, "left": late, "right": fresh}

    _, ticks = _run(_session(world, pictures), 0, length=5)
    assert _image_delays_s(ticks) == pytest.approx([-0.01] * 5)
    assert ticks[0].timestamps == pytest.approx(0.02), "the arbiter hands over in the first tick"
    monkeypatch.setattr(World, "stamp_s", property(lambda world: world.time - 0.015))
    _, ticks = _run(_session(world, pictures), 0, length=5)
    assert _image_delays_s(ticks) == pytest.approx([0.015] * 5)


def test_a_tick_without_pictures_has_no_stamp_of_them(world: World) -> None:
    _, ticks = _run(_session(world), 0, length=2)
    assert [tick.image_timestamps for tick in ticks] == [None, None]


def _image_delays_s(ticks: list[Tick]) -> list[float]:
    """Return the time from joints to pictures of each tick."""
    return [(tick.image_timestamps or np.nan) - tick.timestamps for tick in ticks]


def test_an_episode_succeeds_and_its_actions_lead_to_the_next_state(world: World) -> None:
    result, ticks = _run(_session(world), 0)
    assert result.outcome.success, result.reason
    assert result.reason == ""
    assert result.ended_by == "leader"
    assert result.outcome.number("goal_error_m") < 0.002
    assert result.outcome.number("tilt_max_rad") < np.deg2rad(0.5)
    assert len(ticks) == round(ScriptedOperator(world.scene).phases()["rest"][1] * 50.0)
    times = np.array([t.timestamps for t in ticks])
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-9)
    assert len(result.latencies_s) == len(ticks)
    assert min(result.latencies_s) > 0.0

    action = np.array([t.action for t in ticks])
    assert np.abs(action - result.q).max() > 0.05, "commands, not readings"
    # Whoever replays the recorded actions on the same plant must meet every recorded state, to the bit.
    trial = sample_trial(world.scene, SEED, "demonstrations", 0, widen=1.3)
    assert _replay_error(world, trial.start, ticks, action) == 0.0
    # The readings put in place of the commands, or the commands a tick late, lead elsewhere.
    assert _replay_error(world, trial.start, ticks, result.q) > 1e-2
    assert _replay_error(world, trial.start, ticks, np.vstack([action[:1], action[:-1]])) > 1e-3


@pytest.mark.parametrize("broken", ["leader", "writer"])
def test_an_error_in_a_leader_or_a_writer_is_raised_when_the_arms_rest(
    world: World,
    broken: str,
) -> None:
    """The arms keep their torques until they rest."""
    config = TeleopConfig()
    stack = ControlStack(
        world,
        Kinematics(),
        rate_hz=config.rate_hz,
        supervisor=Supervisor(dt_s=world.dt),
    )
    session = TeleopSession(stack, config)
    trial = sample_trial(world.scene, SEED, "demonstrations", 0, widen=1.3)
    speeds: list[float] = []

    class Unplugged(ScriptedLeader):
        def read(self, now_s: float) -> Any:
            if broken == "leader" and now_s > 0.8:
                raise OSError("the device is gone")
            return super().read(now_s)

    def write(tick: Tick) -> None:
        speeds.append(float(np.abs(world.v).max()))
        if broken == "writer" and len(speeds) > 40:
            raise OSError("the device is gone")

    leader = Unplugged(ScriptedOperator(world.scene).plan(trial, seed=SEED))
    with pytest.raises(OSError, match="the device is gone"):
        session.run(carry_task(world.scene), trial, leader, on_tick=write)
    assert speeds[-1] > 0.2
    assert np.abs(world.v).max() < 0.05
    assert stack.reflex is not None
    assert "controller_failed" in stack.reflex.message


def _replay_error(world: World, start: Any, ticks: list[Tick], actions: Array) -> float:
    """Return the largest joint difference between the recorded states and a replay of `actions` (2 s of it)."""
    world.reset(poses=start)
    loop = JointLoop(world, Kinematics())
    for _ in range(20):  # the tick in which the arbiter hands over
        loop.step(HOME, np.ones(2))
    worst = 0.0
    for tick, action in zip(ticks[:100], actions, strict=False):
        worst = max(worst, float(np.abs(world.q - tick.qpos).max()))
        for _ in range(20):
            loop.step(action, tick.action_gripper)
    return worst


def test_the_same_trial_gives_the_same_episode_whatever_ran_before(world: World) -> None:
    session = _session(world)
    first, _ = _run(session, 1, 200)  # up to the closed hands
    _run(session, 2, 200)
    again, _ = _run(session, 1, 200)
    assert len(first.q) == 200
    np.testing.assert_array_equal(again.q, first.q)
    assert again.outcome == first.outcome


class _Broken(ScriptedLeader):
    """Goes wrong after a second."""

    def __init__(self, leader: ScriptedLeader, kind: str) -> None:
        super().__init__(leader.demonstration)
        self.kind = kind

    def read(self, now_s: float) -> LeaderSample | None:
        sample = super().read(now_s)
        if now_s < 1.0 or sample is None:
            return sample
        if self.kind == "silent":
            return None
        q = np.full(14, np.nan) if self.kind == "nan" else np.zeros(14)
        return dataclasses.replace(sample, q=q)


def _broken(world: World, kind: str) -> SessionResult:
    trial = sample_trial(world.scene, SEED, "demonstrations", 0)
    leader = ScriptedLeader(ScriptedOperator(world.scene).plan(trial, seed=SEED))
    return _session(world).run(carry_task(world.scene), trial, _Broken(leader, kind))


def test_a_leader_that_falls_silent_ends_the_episode(world: World) -> None:
    result = _broken(world, "silent")
    assert result.ended_by == "stopped"
    assert result.reason == "the leader fell silent"
    assert not result.outcome.success
    assert len(result.q) < 120, "one second of motion, one of silence"
    assert np.abs(world.v).max() < 0.05, "the arms came to rest"


def test_a_leader_that_sends_nan_is_stopped_and_named(world: World) -> None:
    result = _broken(world, "nan")
    assert result.ended_by == "stopped"
    assert {r.name for r in result.refusals} == {"not_finite"}
    assert np.isfinite(result.q).all()


def test_a_leader_that_lost_its_values_is_stopped_and_named(world: World) -> None:
    # The mirror must not clip zeros into the joints' range: they would look like a posture.
    result = _broken(world, "zero")
    assert result.ended_by == "stopped"
    assert {r.name for r in result.refusals} == {"all_zero"}


def test_a_leader_too_far_away_may_not_begin(world: World) -> None:
    trial = sample_trial(world.scene, SEED, "demonstrations", 0)
    demonstration = ScriptedOperator(world.scene).plan(trial, seed=SEED)
    demonstration.q[0, 3] += 0.4
    with pytest.raises(UsageError, match="left_panda_joint4"):
        _session(world).run(carry_task(world.scene), trial, ScriptedLeader(demonstration))
    assert world.time == 0.0, "nothing has moved"


def test_a_rate_that_does_not_divide_the_control_rate_is_refused(world: World) -> None:
    with pytest.raises(UsageError, match="rate_hz 60"):
        _session(world, rate_hz=60.0)


def test_a_leader_that_stands_elsewhere_is_refused_and_the_joint_named() -> None:
    leader = HOME.copy()
    leader[10] += 0.25
    with pytest.raises(
        UsageError,
        match=r"\+0\.250 rad away from the follower at right_panda_joint4",
    ) as error:
        check_start(DUAL_PANDA, MirrorConfig(), leader, HOME)
    assert "joint order" in (error.value.remedy or "")
    leader[10] = HOME[10] + 0.09 - 2.0 * np.pi  # its encoder counts from another turn
    check_start(DUAL_PANDA, MirrorConfig(), leader, HOME)


def test_joints_of_another_number_are_refused() -> None:
    np.testing.assert_array_equal(leader_joints(DUAL_PANDA, HOME), HOME)
    with pytest.raises(UsageError, match=r"shape \(7,\)"):
        leader_joints(DUAL_PANDA, HOME[:7])
