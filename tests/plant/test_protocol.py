"""The simulator and the delayed plant of docs/howto-plant.md keep the plant protocol.

The control stack needs no more than it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from minidual.control.commands import JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.plant.protocol import Plant
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from tests.support import howto
from tests.support.control_plant import ArmsPlant

_PAGE: dict[str, Any] = {"np": np}
exec(
    next(block for block in howto.blocks("howto-plant.md") if "class DelayedPlant" in block),
    _PAGE,
)
DelayedPlant = _PAGE["DelayedPlant"]
SEAM = {name for name in vars(Plant) if not name.startswith("_")} | set(Plant.__annotations__)

OPTIONAL = {"kind", "braking_share", "catch_up"}
"""What a plant may say and has a default."""


class OnlyAPlant:
    """Passes on what the protocol names, and refuses everything else."""

    def __init__(self, plant: Any) -> None:
        self._plant = plant

    def __getattr__(self, name: str) -> Any:
        if name in OPTIONAL:
            raise AttributeError(name)
        if name not in SEAM:
            raise AssertionError(f"{name} is not part of a plant")
        return getattr(self._plant, name)


def wave(plant: Any, stack: ControlStack, seconds: float, joint: int = 3) -> np.ndarray:
    """Stream a slow sine on one joint; return the tracking error of that joint (ticks,) [rad]."""
    start = plant.q
    began = plant.time
    errors = []
    sequence = 0
    stack.request("teleop")
    while stack.source != "teleop":
        stack.step()
    while plant.time - began < seconds:
        if stack.tick_next:
            sequence += 1
            q = start.copy()
            q[joint] += 0.05 * np.sin(2.0 * np.pi * 0.5 * (plant.time - began))
            assert (
                stack.propose("teleop", JointCommand(q, np.ones(2), plant.time, sequence)) is None
            )
        stack.step()
        errors.append(plant.q[joint] - stack.manager.reference[joint])
    return np.array(errors)


def test_the_stack_reads_nothing_but_the_seam(scene, compiled_model, kinematics):
    world = World(scene, model=compiled_model)
    plant = OnlyAPlant(world)
    stack = ControlStack(plant, kinematics, supervisor=Supervisor(dt_s=world.dt))
    assert np.abs(wave(plant, stack, 0.6)).max() < 0.01
    with pytest.raises(AssertionError, match="truth is not part"):
        _ = plant.truth


def test_world_keeps_the_seam(scene, compiled_model):
    world = World(scene, model=compiled_model)
    assert all(hasattr(world, name) for name in SEAM)
    assert world.stamp_s == world.time
    assert world.fingers == pytest.approx([0.04, 0.04])
    assert not world.health


@pytest.mark.parametrize("delay_s", [0.0, 0.001, 0.007])
def test_measurements_arrive_late_by_the_delay(scene, compiled_model, delay_s):
    world = World(scene, model=compiled_model)
    late = DelayedPlant(world, delay_s)
    seen = []
    for _ in range(30):
        seen.append((world.time, world.q, world.v, world.tau, world.fingers, world.grip))
        k = max(0, len(seen) - 1 - round(delay_s / world.dt))
        now = (late.stamp_s, late.q, late.v, late.tau, late.fingers, late.grip)
        assert all(np.array_equal(a, b) for a, b in zip(now, seen[k], strict=True))
        assert late.time == world.time
        late.command(np.full(14, 3.0), np.zeros(2))
        late.step()


def test_readings_are_copies(scene, compiled_model):
    late = DelayedPlant(World(scene, model=compiled_model), 0.002)
    late.q[:] = 9.0
    assert np.abs(late.q).max() < 4.0


def test_tracking_degrades_with_the_delay_and_holds(scene, compiled_model):
    """Computed torque at 20 rad/s: 10 ms of delay keep it stable, 60 ms do not."""
    worst = {}
    for delay_s in (0.0, 0.010):
        plant = DelayedPlant(World(scene, model=compiled_model), delay_s)
        worst[delay_s] = np.abs(wave(plant, ControlStack(plant, Kinematics()), 1.0)).max()
    assert worst[0.0] < worst[0.010] < 0.02
    plant = DelayedPlant(World(scene, model=compiled_model), 0.060)
    stack = ControlStack(plant, Kinematics(), supervisor=Supervisor(dt_s=plant.dt))
    with pytest.raises((ReflexError, AssertionError)):
        assert np.abs(wave(plant, stack, 1.5)).max() < 0.02


def test_stale_measurements_stop_the_arms_under_a_supervisor(scene):
    plant = ArmsPlant(scene)
    stack = ControlStack(plant, Kinematics(), supervisor=Supervisor(dt_s=plant.dt))
    plant.age_s = 0.019
    for _ in range(60):
        stack.step()
    plant.age_s = 0.022
    stack.step()  # overtaken by the last reading, which is 20 ms old
    with pytest.raises(ReflexError, match=r"measurement.stale at .* \(0.021 s, bound 0.02 s\)"):
        stack.step()
    for _ in range(50):  # once; the soft stop goes on
        stack.step()


@pytest.mark.parametrize("bounded", [True, False])
def test_a_plant_in_bad_health_is_not_driven(scene, bounded):
    plant = ArmsPlant(scene)
    supervisor = Supervisor(dt_s=plant.dt, bounded=bounded)
    stack = ControlStack(plant, Kinematics(), supervisor=supervisor)
    stack.step()
    plant.health = "the brakes are closed"
    with pytest.raises(ReflexError, match=r"plant_failed.* the brakes are closed"):
        stack.step()
