"""Factories of the compared methods; heavy parts load when a method is used."""

from __future__ import annotations

from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.tasks.task import Trial
from minidual.trials.methods import Factory, MethodInputs


def impedance(inputs: MethodInputs) -> Factory:
    """Object impedance."""
    from minidual.skills.impedance_carry import ImpedanceCarry
    from minidual.skills.supervised import trial_supervisor

    config = inputs.config
    supervisor = trial_supervisor(config.supervisor, config.scene.physics.timestep_s, robot_from(config.robot))
    return lambda world, kinematics, trial: ImpedanceCarry(
        world, kinematics, config.carry, trial, seed=inputs.seed, supervisor=supervisor, arbiter=config.arbiter
    )


def planned(inputs: MethodInputs) -> Factory:
    """Plan from one reading of the pose sensor, execute with joint trajectory control."""
    from minidual.config.seeds import stream
    from minidual.plant.sensing import Sensors
    from minidual.skills.planned_carry import PlannedCarry, make_planners
    from minidual.skills.supervised import trial_supervisor

    config = inputs.config
    supervisor = trial_supervisor(config.supervisor, config.scene.physics.timestep_s, robot_from(config.robot))
    planner, carrier = make_planners(config.plan.planner)

    def make(world: World, kinematics: Kinematics, trial: Trial) -> PlannedCarry:
        # The sensor and the noise that object impedance has, on the same stream: both begin from the same reading.
        rng = stream(inputs.seed, f"sensing/{trial.purpose}", trial.index)
        seen = Sensors(world, config.carry.sensing, rng).sense().pose
        if seen is None:
            raise RuntimeError("the first reading of the sensors holds a pose")
        return PlannedCarry(
            world,
            kinematics,
            planner,
            carrier,
            trial,
            inputs.seed + trial.index,
            config.arbiter,
            T_world_object=seen.T_world_object,
            supervisor=supervisor,
        )

    return make


def policy(inputs: MethodInputs) -> Factory:
    """Run a trained policy from camera and joints through the command arbiter."""
    from minidual.errors import UsageError
    from minidual.plant.render import Camera
    from minidual.policies.pilot import PolicyPilot, load_runtime
    from minidual.skills.supervised import trial_supervisor

    if inputs.checkpoint is None:
        raise UsageError("method 'act' needs a checkpoint", remedy="minidual train-act")
    config = inputs.config
    runtime = load_runtime(inputs.checkpoint, config.deploy, robot_from(config.robot))
    supervisor = trial_supervisor(config.supervisor, config.scene.physics.timestep_s, robot_from(config.robot))
    cameras: dict[int, Camera] = {}  # one a model, not one a trial: an OpenGL context is slow to make

    def make(world: World, kinematics: Kinematics, trial: Trial) -> PolicyPilot:
        camera = cameras.get(id(world.model))
        if camera is None:
            camera = cameras[id(world.model)] = Camera.recorded(world.model, config.scene.camera)
        return PolicyPilot(
            world,
            kinematics,
            runtime,
            lambda name: camera.picture(world.data, name),
            config.arbiter,
            config.teleop.rate_hz,
            supervisor=supervisor,
        )

    return make
