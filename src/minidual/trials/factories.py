"""Methods: object impedance, planned motion with joint control, and learned policies."""

import functools
from collections.abc import Callable, Mapping

from minidual.config.seeds import stream, subseed
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.plant.render import Camera
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.policies.pilot import PolicyPilot, load_runtime
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, robot_from
from minidual.skills.cycle import thing_of
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.skills.phases import OPEN, still
from minidual.skills.pipeline.drive import Drive
from minidual.skills.planned_carry import CompliantCarry, PlannedCarry
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial, pose_of
from minidual.trials.methods import Factory, MethodInputs

_REST_S = 2.0


def _supervisor(inputs: MethodInputs) -> Supervisor:
    config = inputs.config
    task = make_task(inputs.config)
    own = [
        next((i.body for i in task.objects.values() if side in i.grasps), task.scene.object)
        for side in SIDES
    ]
    shapes = [thing_of(body).shape for body in own]
    return trial_supervisor(
        config.supervisor,
        task.scene.physics.timestep_s,
        robot_from(config.robot),
        shapes=shapes,
    )


def impedance(inputs: MethodInputs) -> Factory:
    """Impedance of the object in both hands, else of what one hand holds."""
    if not make_task(inputs.config).together:
        return planned(inputs, CompliantCarry)
    config = inputs.config
    supervisor = _supervisor(inputs)
    return lambda world, kinematics, trial: ImpedanceCarry(
        world,
        kinematics,
        config.carry,
        trial,
        seed=inputs.seed,
        supervisor=supervisor,
        arbiter=config.arbiter,
    )


def _plans(
    inputs: MethodInputs,
    task: Task,
    kind: type[PlannedCarry] = PlannedCarry,
) -> Callable[[World, Kinematics, Trial, Mapping[str, Array]], PlannedCarry]:
    config = inputs.config
    supervisor = _supervisor(inputs)
    planner = Planner(config=config.plan.planner, robot=robot_from(config.robot))

    def drive(
        world: World,
        kinematics: Kinematics,
        trial: Trial,
        poses: Mapping[str, Array],
    ) -> PlannedCarry:
        stack = ControlStack(world, kinematics, config.arbiter, supervisor=supervisor)
        own = subseed(inputs.seed, f"planner/{trial.purpose}", trial.index)
        return kind(stack, planner, task, trial, own, poses=poses)

    return drive


def planned(inputs: MethodInputs, kind: type[PlannedCarry] = PlannedCarry) -> Factory:
    """Plan from one pose reading, then control joint trajectories."""
    config = inputs.config
    task = make_task(inputs.config)
    drive = _plans(inputs, task, kind)

    def make(world: World, kinematics: Kinematics, trial: Trial) -> PlannedCarry:
        # Same sensor, noise and stream as object impedance: both start from the same reading.
        rng = stream(inputs.seed, f"sensing/{trial.purpose}", trial.index)
        seen = {
            name: Sensors(world, config.carry.sensing, rng, name).sense().pose
            for name in task.objects
        }
        poses = {name: sample.T_world_object for name, sample in seen.items() if sample is not None}
        if len(poses) < len(seen):
            raise RuntimeError("the first reading of the sensors holds a pose")
        return drive(world, kinematics, trial, poses)

    return make


def replayed(inputs: MethodInputs) -> Factory:
    """Drive the plan of the first demonstration's trial, whatever the start."""
    task = make_task(inputs.config)
    widen = inputs.config.teleop.widen
    shown = task.trial(inputs.seed, "demonstrations", 0, widen=widen)
    drive = _plans(inputs, task)
    poses = {name: pose_of(task.objects[name].body, T) for name, T in shown.start.items()}
    return lambda world, kinematics, trial: drive(world, kinematics, shown, poses)


class Rest(Drive):
    """Holds the arms at home."""

    def __init__(self, stack: ControlStack[World]) -> None:
        self.world = stack.plant
        super().__init__(stack, [still("hold", self.world.q, _REST_S, (OPEN, OPEN))])


def resting(inputs: MethodInputs) -> Factory:
    """Hold still."""
    config = inputs.config
    supervisor = _supervisor(inputs)
    return lambda world, kinematics, trial: Rest(
        ControlStack(world, kinematics, config.arbiter, supervisor=supervisor),
    )


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
        stack = ControlStack(
            world,
            kinematics,
            config.arbiter,
            rate_hz=config.teleop.rate_hz,
            supervisor=supervisor,
        )
        return PolicyPilot(
            stack,
            runtime,
            lambda name: (camera(world.model).picture(world.data, name), world.time),
        )

    return make
