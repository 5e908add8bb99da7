"""Learned methods: a trained policy drives through the command arbiter."""

import functools

from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.policies.pilot import PolicyPilot, load_runtime
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.task import Trial
from minidual.trials.methods import Factory, MethodInputs


def policy(inputs: MethodInputs) -> Factory:
    """Run the policy of the checkpoint."""
    if inputs.checkpoint is None:
        raise UsageError("a learned method needs a checkpoint", remedy="minidual train-act")
    config = inputs.config
    robot = robot_from(config.robot)
    runtime = load_runtime(inputs.checkpoint, config.deploy, robot)
    supervisor = trial_supervisor(config.supervisor, config.scene.physics.timestep_s, robot)
    # One per model: an OpenGL context is slow to create.
    camera = functools.cache(lambda model: Camera.recorded(model, config.scene.camera))

    def make(world: World, kinematics: Kinematics, trial: Trial) -> PolicyPilot:
        picture = lambda name: (camera(world.model).picture(world.data, name), world.time)  # noqa: E731
        rate_hz = config.teleop.rate_hz
        stack = ControlStack(world, kinematics, config.arbiter, rate_hz=rate_hz, supervisor=supervisor)
        return PolicyPilot(stack, runtime, picture)

    return make
