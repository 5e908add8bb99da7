"""Learned methods: a trained policy drives through the command arbiter."""

from minidual.errors import UsageError
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.policies.pilot import PolicyPilot, load_runtime
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
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
    cameras: dict[int, Camera] = {}  # one per model: an OpenGL context is slow to create

    def make(world: World, kinematics: Kinematics, trial: Trial) -> PolicyPilot:
        camera = cameras.get(id(world.model))
        if camera is None:
            camera = cameras[id(world.model)] = Camera.recorded(world.model, config.scene.camera)
        return PolicyPilot(
            world,
            kinematics,
            runtime,
            lambda name: (camera.picture(world.data, name), world.time),
            config.arbiter,
            config.teleop.rate_hz,
            supervisor=supervisor,
        )

    return make
