"""Carries with the sensors of the simulated world that they drive."""

from __future__ import annotations

from minidual.config.control import ArbiterConfig, CarryConfig
from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.control.supervisor import Supervisor
from minidual.plant.protocol import ObjectSensors
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.tasks.task import Task, Trial


def impedance_carry(
    world: World,
    kinematics: Kinematics,
    carry: CarryConfig,
    trial: Trial,
    *,
    sensors: ObjectSensors | None = None,
    seed: int = 0,
    supervisor: Supervisor | None = None,
    arbiter: ArbiterConfig | None = None,
) -> ImpedanceCarry:
    """Return a carry in the world's scene; by default with simulated sensors, their noise by seed."""
    if sensors is None:
        rng = stream(seed, f"sensing/{trial.purpose}", trial.index)
        sensors = Sensors(world, carry.sensing, rng)
    arbiter = ArbiterConfig() if arbiter is None else arbiter
    config = Config(scene=world.scene, carry=carry, arbiter=arbiter)
    return ImpedanceCarry(world, kinematics, config, trial, sensors=sensors, supervisor=supervisor)


def true_poses(world: World, task: Task) -> dict[str, Array]:
    """Return the poses (4, 4) of a task's objects as they are."""
    return {name: world.object_pose(name) for name in task.objects}
