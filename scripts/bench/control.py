"""One 1 kHz step of every controller against bare physics of the same model, in the same run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from minidual.control.joint_control import JointLoop
from minidual.robot.kinematics import Hands
from minidual.show.report.bench import BenchRow, BenchTable
from scripts.bench.scenes import BenchScene, free_scene, held_scene
from scripts.bench.step import COLUMNS as STEP_COLUMNS
from scripts.bench.step import NOTES as STEP_NOTES
from scripts.bench.step import Step, StepCost, step_cost
from scripts.bench.tables import BenchInputs

JOINT_RATIO_MAX = 1.5
"""A whole step of joint control over bare physics, the mean of all steps."""
OBJECT_RATIO_MAX = 2.0
"""A whole step of object impedance over bare physics, the mean of all steps."""

COLUMNS = (*STEP_COLUMNS, "real_time", "read_us", "dynamics_us", "algebra_us")
_NOTES = (
    *STEP_NOTES,
    "real_time = simulated time / mean processor time",
    "algebra = step - bare - read - dynamics, all means",
    "held: both hands hold the rod in the air, their contacts are solved",
    "free: open hands, nothing touched; object impedance then runs on an imagined object, to show",
    "    the law beside the cheapest physics there is",
)


@dataclass(frozen=True)
class Case:
    """One controller in one situation.

    Attributes:
        name: For the table.
        step: One whole step of control and physics.
        before: Takes the sample that the step follows; not timed, a controller is given its sample.
        parts: `read` (and write) of the world, and `dynamics` in Pinocchio.
        ratio_max: Limit.
    """

    name: str
    step: Step
    before: Step
    parts: Mapping[str, Step]
    ratio_max: float


MakeCase = Callable[[BenchScene], Case]


def trajectory_14(scene: BenchScene) -> Case:
    """Controller A: both arms follow a timed trajectory of 14 joints."""
    loop = _loop(scene)
    samples = _Latest(scene.joint_samples())

    def step() -> None:
        loop.follow(*samples.latest, scene.gripper)

    return Case(
        "A trajectory, 14 joints",
        step,
        samples.take,
        _joint_parts(scene),
        JOINT_RATIO_MAX,
    )


def trajectory_7(scene: BenchScene) -> Case:
    """Controller B: the left arm follows a trajectory of 7 joints, the right one is held."""
    loop = _loop(scene)
    arm = scene.world.robot.groups["left_arm"]
    q = scene.q_rest.copy()
    v = np.zeros(len(scene.q_rest))
    a = np.zeros(len(scene.q_rest))
    samples = _Latest(scene.joint_samples(arm))

    def step() -> None:
        q[arm], v[arm], a[arm] = samples.latest
        loop.follow(q, v, a, scene.gripper)

    return Case(
        "B trajectory, 7 joints of one arm",
        step,
        samples.take,
        _joint_parts(scene),
        JOINT_RATIO_MAX,
    )


def targets_14(scene: BenchScene) -> Case:
    """Controller A behind the reference filter: 14 joint targets at 50 Hz, from leader or policy."""
    loop = _loop(scene)
    targets = _Latest(scene.joint_targets())

    def step() -> None:
        loop.step(targets.latest, scene.gripper)

    return Case(
        "A targets at 50 Hz, reference filter",
        step,
        targets.take,
        _joint_parts(scene),
        JOINT_RATIO_MAX,
    )


def object_impedance(scene: BenchScene) -> Case:
    """Controller C: contacts and pose are read, the law is evaluated, hands and arms commanded."""
    world = scene.world
    law = scene.law
    grippers = scene.grippers()
    desired = _Latest(scene.object_samples())
    squeeze_n = scene.squeeze_n

    def step() -> None:
        measured, felt_n = scene.sense()
        tau = law.torque(
            world.q,
            world.v,
            measured,
            desired.latest,
            wanted_n=squeeze_n,
            felt_n=felt_n,
        )
        world.command(tau, grippers.step(scene.gripper, world.fingers, world.grip))
        world.step()

    hands = Hands(scene.kinematics)
    kinematics = scene.kinematics
    rest = np.zeros(len(scene.q_rest))

    def dynamics() -> None:
        hands.update(scene.q_rest)
        kinematics.rnea(scene.q_rest, rest, rest)

    tau = np.zeros(len(scene.q_rest))
    gripper_targets = np.zeros(2)

    def read() -> None:
        scene.sense()
        _read_and_write(scene, tau, gripper_targets)

    return Case(
        "C object impedance",
        step,
        desired.take,
        {"read": read, "dynamics": dynamics},
        OBJECT_RATIO_MAX,
    )


CASES: tuple[MakeCase, ...] = (trajectory_14, trajectory_7, targets_14, object_impedance)


def measure(inputs: BenchInputs) -> BenchTable:
    """Time all cases in both situations."""
    gains = inputs.config.carry.impedance
    rows: list[BenchRow] = []
    for make_scene in (held_scene, free_scene):
        scene = make_scene(inputs.config.scene, gains)
        for make in CASES:
            row = measure_case(scene, make, inputs.repeats_n)
            rows.append(row)
            inputs.advance(row.name)
    title = (
        f"One step of {scene.world.dt * 1e3:g} ms: control and physics beside bare mj_step, "
        f"{inputs.repeats_n} steps in turns of 50"
    )
    return BenchTable(title, COLUMNS, tuple(rows), _NOTES)


def measure_case(scene: BenchScene, make: MakeCase, steps_n: int) -> BenchRow:
    """Time one case from where its situation began."""
    scene.restore()
    case = make(scene)
    case.before()
    cost = step_cost(scene.world, case.step, steps_n, parts=case.parts, before=case.before)
    limits = {"mean_ratio": case.ratio_max}
    if scene.virtual and case.ratio_max == OBJECT_RATIO_MAX:
        limits = {}  # free physics costs too little: nobody impedes an object that is not there
    return BenchRow(f"{case.name}, {scene.name}", _numbers(cost), limits)


class _Latest[T]:
    """The sample that a step follows; `take` goes on to the next one."""

    def __init__(self, samples: Iterator[T]) -> None:
        self._samples = samples
        self.latest = next(samples)

    def take(self) -> None:
        self.latest = next(self._samples)


def _loop(scene: BenchScene) -> JointLoop:
    loop = JointLoop(scene.world, scene.kinematics)
    loop.grippers = scene.grippers()
    return loop


def _joint_parts(scene: BenchScene) -> dict[str, Step]:
    rest = np.zeros(len(scene.q_rest))
    tau = np.zeros(len(scene.q_rest))
    gripper_targets = np.zeros(2)
    return {
        "read": lambda: _read_and_write(scene, tau, gripper_targets),
        "dynamics": lambda: scene.kinematics.rnea(scene.q_rest, rest, rest),
    }


def _read_and_write(scene: BenchScene, tau: np.ndarray, gripper_targets: np.ndarray) -> None:
    """Read the joints and write commands as a step does; leave the commands as they were."""
    world = scene.world
    _ = world.q
    _ = world.v
    ctrl = world.data.ctrl.copy()
    world.command(tau, gripper_targets)
    world.data.ctrl[:] = ctrl


def _numbers(cost: StepCost) -> dict[str, float]:
    read_us = cost.parts_us["read"]
    dynamics_us = cost.parts_us["dynamics"]
    return {
        **cost.numbers(),
        "real_time": cost.real_time_factor,
        "read_us": read_us,
        "dynamics_us": dynamics_us,
        "algebra_us": cost.whole.mean_us - cost.bare.mean_us - read_us - dynamics_us,
    }
