"""A policy whose input or output is broken is stopped by name, with the arms at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest

from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.pilot import Picture, PolicyPilot
from minidual.policies.policy import PolicyRuntime
from minidual.robot.kinematics import Kinematics
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

AWAY = np.eye(14)[0]
CHUNK = 5


class Scripted(ChunkPolicy):
    """Emits the target of each tick: joints alone with open hands, or with two openings."""

    def __init__(self, target: Callable[[int], np.ndarray]) -> None:
        self.chunk_size = CHUNK
        self.dim = 16
        self.cameras = {"high": (4, 4)}
        self._target = target
        self._tick = 0

    def predict(self, images: Mapping[str, Image], state: np.ndarray) -> np.ndarray:
        rows = [np.r_[self._target(self._tick + k), 1.0, 1.0][:16] for k in range(CHUNK)]
        self._tick += CHUNK
        return np.array(rows)


def _pilot(world: World, target: Callable[[int], np.ndarray], picture: Picture) -> PolicyPilot:
    runtime = PolicyRuntime(
        Scripted(target),
        n_action_steps=CHUNK,
        blend_ticks=0,
        limits=(Q_LOWER, Q_UPPER),
    )
    supervisor = Supervisor(dt_s=world.dt, kinematics=Kinematics())
    return PolicyPilot(ControlStack(world, Kinematics(), supervisor=supervisor), runtime, picture)


def _fly(
    world: World,
    target: Callable[[int], np.ndarray],
    picture: Picture,
    seconds: float = 3.0,
) -> PolicyPilot:
    pilot = _pilot(world, target, picture)
    while not pilot.done and world.time < seconds:
        pilot.step()
    return pilot


def _ramp(tick: int) -> np.ndarray:
    return HOME + min(0.4, 0.01 * tick) * AWAY


def _changing(world: World) -> Picture:
    """A camera whose picture changes with the arms."""
    return lambda name: (np.full((4, 4, 3), int(1e4 * world.q[0]) % 251, np.uint8), world.time)


class BrokenOutput(NamedTuple):
    """Targets of each tick, and the most that the arms move until the fault is named."""

    fault: str
    target: Callable[[int], np.ndarray]
    moved_max_rad: float
    named_before_s: float


BROKEN_OUTPUTS = (
    BrokenOutput("all_zero", lambda tick: np.zeros(14), 1e-6, 0.05),
    BrokenOutput(
        "out_of_bounds",
        lambda tick: HOME + (1e6 if tick > 20 else 0.0) * AWAY,
        1e-6,
        0.45,
    ),
    BrokenOutput(
        "oscillation",
        lambda tick: HOME + (0.04 if tick % 2 else -0.04) * AWAY,
        0.01,
        0.25,
    ),
    BrokenOutput(
        "out_of_bounds: the policy asks the right hand for 1.6; bounds -0.5 to 1.5",
        lambda tick: np.r_[HOME, 1.0, 1.6],
        1e-6,
        0.05,
    ),
    BrokenOutput(
        "oscillation: the target of the left hand turned back 9 times by more than 0.2",
        lambda tick: np.r_[HOME, tick % 2, 1.0],
        1e-3,
        0.25,
    ),
)


@pytest.mark.parametrize("broken", BROKEN_OUTPUTS, ids=lambda broken: broken.fault)
def test_a_broken_output_stops_the_trial_by_name(world: World, broken: BrokenOutput) -> None:
    """The arms stay where they are; under alternating targets (0.08 rad) a joint moves 8 mrad."""
    pilot = _pilot(world, broken.target, _changing(world))
    moved_rad = 0.0
    named_s = np.inf
    while not pilot.done and world.time < 3.0:
        pilot.step()
        moved_rad = max(moved_rad, float(np.abs(world.q - HOME).max()))
        if pilot.aborted and np.isinf(named_s):
            named_s = world.time
    assert pilot.aborted is not None
    assert pilot.aborted.startswith(broken.fault)
    assert pilot.stack.reflex is None
    assert moved_rad < broken.moved_max_rad
    assert named_s < broken.named_before_s
    assert np.abs(world.v).max() < 0.05
    assert pilot.stack.source is None


class Feeling(Scripted):
    """Keeps the states that it gets, with joint torques and the wrenches of the hands."""

    def __init__(self) -> None:
        super().__init__(_ramp)
        self.inputs = {"joint_torques": 14, "hand_wrench": 12}
        self.states: list[np.ndarray] = []

    def predict(self, images: Mapping[str, Image], state: np.ndarray) -> np.ndarray:
        self.states.append(state)
        return super().predict(images, state)


def test_a_policy_gets_the_forces_that_it_reads_at_each_look(world: World) -> None:
    """Torques hold the arms up from the first look on; nothing touches the hands."""
    policy = Feeling()
    runtime = PolicyRuntime(policy, n_action_steps=CHUNK, blend_ticks=0, limits=(Q_LOWER, Q_UPPER))
    supervisor = Supervisor(dt_s=world.dt, kinematics=Kinematics())
    stack = ControlStack(world, Kinematics(), supervisor=supervisor)
    pilot = PolicyPilot(stack, runtime, _changing(world))
    while world.time < 0.35:
        pilot.step()
    assert pilot.aborted is None
    assert len(policy.states) >= 2
    for state in policy.states:
        assert state.shape == (42,)
        assert np.abs(state[16:30]).max() > 5.0
        assert np.abs(state[30:]).max() < 5.0


def test_forces_that_are_not_sensed_are_refused_before_the_first_step(world: World) -> None:
    runtime = PolicyRuntime(Feeling(), n_action_steps=CHUNK, blend_ticks=0)
    with pytest.raises(UsageError, match="reads hand_wrench, and no supervisor observes"):
        PolicyPilot(ControlStack(world, Kinematics()), runtime, _changing(world))
    assert world.time == 0.0


def test_a_sound_policy_flies_on(world: World) -> None:
    pilot = _fly(world, _ramp, _changing(world), 1.5)
    assert pilot.aborted is None
    assert world.q[0] == pytest.approx(HOME[0] + 0.4, abs=0.01)


def _frozen(world: World) -> Picture:
    return lambda name: (np.full((4, 4, 3), 7, np.uint8), world.time)


def _late(world: World) -> Picture:
    return lambda name: (_changing(world)(name)[0], min(world.time, 0.6))


def _ahead(world: World) -> Picture:
    return lambda name: (_changing(world)(name)[0], world.time + (1.0 if world.time > 0.6 else 0.0))


def _broken(world: World) -> Picture:
    def picture(name: str) -> tuple[Image, float]:
        if world.time > 0.6:
            raise OSError("no frame within 100 ms")
        return _changing(world)(name)

    return picture


@pytest.mark.parametrize(
    ("camera", "reason"),
    [
        (_frozen, "frozen_picture: camera 'high' gives the same picture after 0."),
        (_late, "stale_picture: the picture of camera 'high' is 0.1"),
        (_ahead, "stale_picture: the picture of camera 'high' is -1.000 s old"),
        (
            _broken,
            "camera_failed: camera 'high' gives no picture (OSError: no frame within 100 ms)",
        ),
    ],
)
def test_a_broken_camera_stops_the_trial_by_name(
    world: World,
    camera: Callable[[World], Any],
    reason: str,
) -> None:
    pilot = _fly(world, _ramp, camera(world))
    assert (pilot.aborted or "").startswith(reason)
    assert np.abs(world.v).max() < 0.05
    assert 0.02 < world.q[0] - HOME[0] < 0.35
    before = world.q
    for _ in range(200):
        pilot.step()
    assert np.abs(world.q - before).max() < 0.02


def test_a_policy_that_answers_late_stops_the_trial_by_name(world: World) -> None:
    """The clock runs on while the policy infers."""
    pilot = _pilot(world, _ramp, _changing(world))
    answer = pilot._runtime.act

    def late(images: Any, state: Any) -> Any:
        if world.time > 0.6:
            world.data.time += 0.5
        return answer(images, state)

    pilot._runtime.act = late
    while not pilot.done and world.time < 3.0:
        pilot.step()
    assert (pilot.aborted or "").startswith(
        "late_answer: the policy answered after 0.500 s; limit 0.1 s",
    )
    assert np.abs(world.v).max() < 0.05


def test_an_error_in_a_policy_is_raised_when_the_arms_rest(world: World) -> None:
    def breaks(tick: int) -> np.ndarray:
        if tick > 30:
            raise RuntimeError("CUDA error")
        return _ramp(tick)

    pilot = _pilot(world, breaks, _changing(world))
    speeds = [0.0]

    def fly() -> None:
        for _ in range(3000):
            pilot.step()
            speeds.append(float(np.abs(world.v).max()))

    with pytest.raises(RuntimeError, match="CUDA error"):
        fly()
    assert max(speeds) > 0.2
    assert np.abs(world.v).max() < 0.05
    assert "controller_failed" in (pilot.aborted or "")
    assert pilot.stack.reflex is not None
