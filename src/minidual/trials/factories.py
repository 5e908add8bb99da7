"""Methods: object impedance, planned motion with joint control, and learned policies."""

from collections.abc import Callable, Mapping

from minidual.config.scene import ObjectConfig
from minidual.config.seeds import stream, subseed
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leader import follows_swiftly
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.plant.protocol import ObjectSensors, Plant
from minidual.policies.facts import Place
from minidual.policies.pilot import PolicyPilot, load_runtime
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array
from minidual.skills.compliant_carry import CompliantCarry
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.skills.pipeline.drive import Drive
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.states import OPEN, still
from minidual.skills.supervised import trial_supervisor
from minidual.skills.things import thing_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial, pose_of
from minidual.trials.methods import Factory, MethodInputs

_REST_S = 2.0

type _Plan = Callable[[Plant, Kinematics, Trial, Mapping[str, Array]], PlannedCarry]
"""(plant, kinematics, trial, sensed poses) -> planned trial."""


def _supervisor(inputs: MethodInputs) -> Supervisor:
    config = inputs.config
    task = make_task(config)
    return trial_supervisor(
        config.supervisor,
        inputs.period_s,
        inputs.robot,
        shapes=[thing_of(_object_in(side, task)).shape for side in SIDES],
    )


def _object_in(side: str, task: Task) -> ObjectConfig:
    """Return the object that a hand grasps, by default the task's first."""
    for item in task.objects.values():
        if side in item.grasps:
            return item.body
    return task.scene.object


def impedance(inputs: MethodInputs) -> Factory:
    """Impedance of the object in both hands, else of the object in one hand."""
    if not make_task(inputs.config).together:
        return planned(inputs, CompliantCarry)
    config = inputs.config
    supervisor = _supervisor(inputs)

    senses = inputs.sensed

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> ImpedanceCarry:
        rng = stream(inputs.seed, f"sensing/{trial.purpose}", trial.index)
        return ImpedanceCarry(
            plant,
            kinematics,
            config,
            trial,
            sensors=senses.of_object(config.carry.sensing, rng),
            supervisor=supervisor,
        )

    return make


def _plans(inputs: MethodInputs, task: Task, kind: type[PlannedCarry] = PlannedCarry) -> _Plan:
    config = inputs.config
    supervisor = _supervisor(inputs)
    planner = Planner(config=config.plan.planner, robot=inputs.planned_robot)

    def plan(
        plant: Plant,
        kinematics: Kinematics,
        trial: Trial,
        poses: Mapping[str, Array],
    ) -> PlannedCarry:
        stack = ControlStack(plant, kinematics, config.arbiter, supervisor=supervisor)
        seed = subseed(inputs.seed, f"planner/{trial.purpose}", trial.index)
        return kind(stack, planner, task, trial, seed, poses)

    return plan


def planned(inputs: MethodInputs, kind: type[PlannedCarry] = PlannedCarry) -> Factory:
    """Plan from one pose reading, then control joint trajectories."""
    config = inputs.config
    task = make_task(config)
    plan = _plans(inputs, task, kind)
    senses = inputs.sensed

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> PlannedCarry:
        # Same sensor, noise and stream as object impedance: both start from the same reading.
        rng = stream(inputs.seed, f"sensing/{trial.purpose}", trial.index)
        poses: dict[str, Array] = {}
        sensors: dict[str, ObjectSensors] = {}
        for name in task.objects:
            sensors[name] = senses.of_object(config.carry.sensing, rng, name)
            sample = sensors[name].sense().pose
            if sample is None:
                raise RuntimeError(f"the first reading of the sensors holds no pose of '{name}'")
            poses[name] = sample.T_world_object
        carry = plan(plant, kinematics, trial, poses)
        if isinstance(carry, CompliantCarry):
            carry.sensors = sensors
        return carry

    return make


def replayed(inputs: MethodInputs) -> Factory:
    """Drive the plan of the first demonstration's trial, whatever the start."""
    task = make_task(inputs.config)
    widen = inputs.config.teleop.widen
    demonstrated = task.trial(inputs.seed, "demonstrations", 0, widen=widen)
    plan = _plans(inputs, task)
    poses = {
        name: pose_of(task.objects[name].body, start) for name, start in demonstrated.start.items()
    }

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> PlannedCarry:
        return plan(plant, kinematics, demonstrated, poses)

    return make


class Rest(Drive):
    """Holds the arms at home."""

    def __init__(self, stack: ControlStack[Plant]) -> None:
        super().__init__(stack, [still("hold", stack.plant.q, _REST_S, (OPEN, OPEN))])


def resting(inputs: MethodInputs) -> Factory:
    """Hold still."""
    config = inputs.config
    supervisor = _supervisor(inputs)

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> Rest:
        return Rest(ControlStack(plant, kinematics, config.arbiter, supervisor=supervisor))

    return make


def policy(inputs: MethodInputs) -> Factory:
    """Run the policy of the checkpoint.

    Raises:
        UsageError: There is no checkpoint.
    """
    if inputs.checkpoint is None:
        raise UsageError("a learned method needs a checkpoint", remedy="minidual train-act")
    config = inputs.config
    robot = inputs.robot
    pictures = config.scene.camera
    place = Place((pictures.height_px, pictures.width_px), config.teleop.rate_hz)
    instruction = make_task(config).instruction
    runtime = load_runtime(inputs.checkpoint, config.deploy, robot, place, instruction)
    supervisor = trial_supervisor(config.supervisor, inputs.period_s, robot)
    senses = inputs.sensed

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> PolicyPilot:
        stack = ControlStack(
            plant,
            kinematics,
            config.arbiter,
            rate_hz=config.teleop.rate_hz,
            supervisor=supervisor,
        )
        if follows_swiftly(config.teleop):  # as its demonstrations were led
            stack.anticipate(config.teleop.rate_hz)
        return PolicyPilot(stack, runtime, senses.picture)

    return make
