"""Model-based methods: object impedance, and planned motion with joint control."""

from __future__ import annotations

from minidual.config.seeds import stream, subseed
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.motion.api import Planner
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES
from minidual.skills.cycle import thing_of
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.task import Trial, make_task
from minidual.trials.methods import Factory, MethodInputs


def _supervisor(inputs: MethodInputs) -> Supervisor:
    config, task = inputs.config, make_task(inputs.config)
    own = [next((i.body for i in task.objects.values() if side in i.grasps), task.scene.object) for side in SIDES]
    shapes = [thing_of(body).shape for body in own]
    return trial_supervisor(config.supervisor, task.scene.physics.timestep_s, robot_from(config.robot), shapes=shapes)


def impedance(inputs: MethodInputs) -> Factory:
    """Object impedance."""
    config, supervisor = inputs.config, _supervisor(inputs)
    return lambda world, kinematics, trial: ImpedanceCarry(
        world, kinematics, config.carry, trial, seed=inputs.seed, supervisor=supervisor, arbiter=config.arbiter
    )


def planned(inputs: MethodInputs) -> Factory:
    """Plan from one pose reading, then control joint trajectories."""
    config = inputs.config
    supervisor = _supervisor(inputs)
    planner, task = Planner(config=config.plan.planner, robot=robot_from(config.robot)), make_task(config)

    def make(world: World, kinematics: Kinematics, trial: Trial) -> PlannedCarry:
        # Same sensor, noise and stream as object impedance: both start from the same reading.
        rng = stream(inputs.seed, f"sensing/{trial.purpose}", trial.index)
        seen = {name: Sensors(world, config.carry.sensing, rng, name).sense().pose for name in task.objects}
        poses = {name: sample.T_world_object for name, sample in seen.items() if sample is not None}
        if len(poses) < len(seen):
            raise RuntimeError("the first reading of the sensors holds a pose")
        stack = ControlStack(world, kinematics, config.arbiter, supervisor=supervisor)
        own = subseed(inputs.seed, f"planner/{trial.purpose}", trial.index)
        return PlannedCarry(stack, planner, task, trial, own, poses=poses)

    return make
