"""What a policy sees and emits is checked before the clamp: a broken one is stopped by name, with the arms at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.policies.kinds import ChunkPolicy, Image
from minidual.policies.pilot import Picture, PolicyPilot
from minidual.policies.plausible import SWING_RAD, TURNS_MAX, Plausible, PolicyStoppedError
from minidual.policies.policy import PolicyRuntime
from minidual.robot.kinematics import Kinematics
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

CHUNK = 5
AWAY = np.eye(14)[0]


class Scripted(ChunkPolicy):
    """Emits what `target` says of each tick: joints alone with open hands, or with two openings."""

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


def _open(q: np.ndarray) -> np.ndarray:
    return np.r_[q, 1.0, 1.0]


def _ramp(tick: int) -> np.ndarray:
    return HOME + min(0.4, 0.01 * tick) * AWAY


def _seen(world: World) -> Picture:
    """A camera whose picture changes with the arms."""
    return lambda name: (np.full((4, 4, 3), int(1e4 * world.q[0]) % 251, np.uint8), world.time)


OUTPUTS: dict[str, Callable[[int], np.ndarray]] = {
    "all_zero": lambda tick: np.zeros(14),
    "out_of_bounds": lambda tick: HOME + (1e6 if tick > 20 else 0.0) * AWAY,
    "oscillation": lambda tick: HOME + (0.04 if tick % 2 else -0.04) * AWAY,
    "out_of_bounds: the policy asks the right hand for 1.6; bounds -0.5 to 1.5": lambda tick: np.r_[
        HOME,
        1.0,
        1.6,
    ],
    "oscillation: the target of the left hand turned back 9 times by more than 0.2": lambda tick: (
        np.r_[HOME, tick % 2, 1.0]
    ),
}


@pytest.mark.parametrize(
    ("name", "most_rad", "at_s"),
    list(zip(OUTPUTS, (1e-6, 1e-6, 0.01, 1e-6, 1e-3), (0.05, 0.45, 0.25, 0.05, 0.25), strict=True)),
)
def test_a_broken_output_stops_the_trial_by_name(
    world: World,
    name: str,
    most_rad: float,
    at_s: float,
) -> None:
    """Zeros drove both arms 2.29 rad, 1e6 rad was followed to the limit, alternating targets shook for ever.

    Now the arms stay where they are; under alternating targets (0.08 rad) the joint moves 8 mrad.
    """
    pilot = _pilot(world, OUTPUTS[name], _seen(world))
    moved = 0.0
    named_s = np.inf
    while not pilot.done and world.time < 3.0:
        pilot.step()
        moved = max(moved, float(np.abs(world.q - HOME).max()))
        named_s = min(named_s, world.time if pilot.aborted else np.inf)
    assert pilot.aborted is not None
    assert pilot.aborted.startswith(name)
    assert pilot.stack.reflex is None
    assert moved < most_rad
    assert named_s < at_s
    assert np.abs(world.v).max() < 0.05
    assert pilot.stack.source is None


def test_slow_swings_are_noticed_too_and_a_task_is_not() -> None:
    check = Plausible(np.r_[Q_LOWER, 0.0, 0.0], np.r_[Q_UPPER, 1.0, 1.0])

    def swing() -> None:
        for tick in range(2000):  # one turn in 20 ticks
            check.action(_open(HOME + 0.6 * SWING_RAD * (1.0 if tick % 40 < 20 else -1.0) * AWAY))

    with pytest.raises(
        PolicyStoppedError,
        match=rf"joint 1 of 14 \[rad\] turned back 9 times .* bound {TURNS_MAX}",
    ):
        swing()
    check.reset()
    for tick in range(2000):  # there and back four times in 20 s
        check.action(_open(HOME + 0.5 * np.sin(2.0 * np.pi * tick / 500) * AWAY))
    for tick in range(2000):  # noise within the swing
        check.action(_open(HOME + 0.4 * SWING_RAD * (1.0 if tick % 2 else -1.0) * AWAY))
    for tick in range(2000):  # hands that open and close twice in 4 s, and tremble by 0.1
        check.action(np.r_[HOME, tick % 100 < 50, 1.0 - 0.1 * (tick % 2)])


def test_a_sound_policy_flies_on(world: World) -> None:
    pilot = _fly(world, _ramp, _seen(world), 1.5)
    assert pilot.aborted is None
    assert world.q[0] == pytest.approx(HOME[0] + 0.4, abs=0.01)


def _frozen(world: World) -> Picture:
    return lambda name: (np.full((4, 4, 3), 7, np.uint8), world.time)


def _late(world: World) -> Picture:
    return lambda name: (_seen(world)(name)[0], min(world.time, 0.6))


def _ahead(world: World) -> Picture:
    return lambda name: (_seen(world)(name)[0], world.time + (1.0 if world.time > 0.6 else 0.0))


def _broken(world: World) -> Picture:
    def picture(name: str) -> tuple[Image, float]:
        if world.time > 0.6:
            raise OSError("no frame within 100 ms")
        return _seen(world)(name)

    return picture


@pytest.mark.parametrize(
    ("camera", "said"),
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
    said: str,
) -> None:
    pilot = _fly(world, _ramp, camera(world))
    assert (pilot.aborted or "").startswith(said)
    assert np.abs(world.v).max() < 0.05
    assert 0.02 < world.q[0] - HOME[0] < 0.35
    before = world.q
    for _ in range(200):
        pilot.step()
    assert np.abs(world.q - before).max() < 0.02


def test_a_policy_that_answers_late_stops_the_trial_by_name(world: World) -> None:
    """A clock that runs on while it infers: before, the arms followed the answer to a state of 2 s ago at 0.9 rad/s."""
    pilot = _pilot(world, _ramp, _seen(world))
    answer = pilot._runtime.act

    def late(*seen: Any) -> Any:
        if world.time > 0.6:
            world.data.time += 0.5
        return answer(*seen)

    pilot._runtime.act = late
    while not pilot.done and world.time < 3.0:
        pilot.step()
    assert (pilot.aborted or "").startswith(
        "late_answer: the policy answered after 0.500 s; limit 0.1 s",
    )
    assert np.abs(world.v).max() < 0.05


def test_an_error_in_a_policy_is_raised_when_the_arms_rest(world: World) -> None:
    """Before, it was raised with the arms at 0.9 rad/s, in a tick without torque."""

    def breaks(tick: int) -> np.ndarray:
        if tick > 30:
            raise RuntimeError("CUDA error")
        return _ramp(tick)

    pilot = _pilot(world, breaks, _seen(world))
    fastest = [0.0]

    def fly() -> None:
        for _ in range(3000):
            pilot.step()
            fastest.append(float(np.abs(world.v).max()))

    with pytest.raises(RuntimeError, match="CUDA error"):
        fly()
    assert max(fastest) > 0.2
    assert np.abs(world.v).max() < 0.05
    assert "controller_failed" in (pilot.aborted or "")
    assert pilot.stack.reflex is not None


def test_arms_that_stand_may_see_the_same_picture() -> None:
    check = Plausible(np.full(16, -np.inf), np.full(16, np.inf))
    image = {"high": np.zeros((4, 4, 3), np.uint8)}
    for _ in range(100):
        check.pictures(image, HOME)
    with pytest.raises(PolicyStoppedError, match="frozen_picture"):
        check.pictures(image, HOME + 0.11)
