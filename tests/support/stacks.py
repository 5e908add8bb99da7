"""Control stacks on quick plants, and what drives them in tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.commands import TrajectoryCommand
from minidual.control.kernels import minimum_jerk
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from tests.support.control_plant import ArmsPlant
from tests.support.panda import DOF, HOME, JOINT_DAMPING

OPEN = np.ones(2)
CLOSED = np.zeros(2)
PAIR = ("left_arm", "right_arm")


def move(a: Array, b: Array, duration_s: float, group: str = "both_arms") -> Trajectory:
    """A rest-to-rest trajectory at 1 kHz."""
    n = round(1000 * duration_s)
    blend = np.array([minimum_jerk(k / n) for k in range(n + 1)])
    step = b - a
    return Trajectory(
        np.arange(n + 1) * 1e-3,
        a + blend[:, :1] * step,
        blend[:, 1:2] * step / duration_s,
        blend[:, 2:] * step / duration_s**2,
        group,
    )


class Attended(ControlStack):
    """A stack whose driving source says all the time that it is there, until it dies."""

    dead = False

    def step(self) -> None:
        if self.source is not None and not self.dead:
            self.affirm(self.source)
        super().step()


def stack_on(plant: Any, **options: Any) -> Attended:
    return Attended(plant, Kinematics(), **options)


def hand_over(stack: ControlStack, mode: str, controllers: Any = None) -> None:
    stack.request(mode, controllers)
    for _ in range(700):
        stack.step()
        if stack.source == mode:
            return
    raise AssertionError(f"{mode} was not handed over: {stack.state}, {stack.refusals}")


def trajectory(
    stack: ControlStack,
    motion: Any,
    sequence: int = 1,
    **fields: Any,
) -> TrajectoryCommand:
    fields = {"gripper": OPEN, "stamp_s": stack.plant.time, "sequence": sequence, **fields}
    return TrajectoryCommand(motion, **fields)


def supervised(plant: ArmsPlant, **options: Any) -> ControlStack:
    return stack_on(plant, supervisor=Supervisor(dt_s=plant.dt), **options)


def run(stack: ControlStack, ticks: int) -> list[str]:
    """Step; return the names of the reflexes."""
    names = []
    for _ in range(ticks):
        try:
            stack.step()
        except ReflexError as error:
            names.append(error.reflex.label)
    return names


class FailingPlant(ArmsPlant):
    """Arms whose readings can be replaced: `lies[name]` gets the true one and may raise."""

    def __init__(self, scene: SceneConfig) -> None:
        self.lies: dict[str, Callable[[Any], Any]] = {}
        super().__init__(scene)

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        lies = super().__getattribute__("lies")
        return lies[name](value) if name in lies else value

    def step(self) -> None:
        kept = self.lies  # physics does not read the sensors
        self.lies = {}
        super().step()
        self.lies = kept


def breaks(*_args: object, **_kwargs: object) -> Any:
    raise ZeroDivisionError("the bus is gone")


def under_way(plant: FailingPlant) -> ControlStack:
    """Return a supervised stack in the middle of a motion."""
    distance: list[Callable[[Array], tuple[str, float]]] = [lambda q: ("a with b", 1.0)]
    supervisor = Supervisor(dt_s=plant.dt, self_distance=lambda q: distance[0](q))
    supervisor.distance = distance  # type: ignore[attr-defined]
    stack = stack_on(plant, supervisor=supervisor)
    hand_over(stack, "moveit")
    assert (
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8), gripper=CLOSED))
        is None
    )
    for _ in range(400):
        stack.step()
    assert np.abs(plant.v).max() > 0.5
    return stack


class Arms(FailingPlant):
    """As MuJoCo, implicit in the joints' damping."""

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        model = self._kinematics.model = (
            self._kinematics.model.copy()
        )  # all workspaces share the original
        model.armature = model.armature + self.dt * JOINT_DAMPING
        self.pushed = np.zeros(DOF)
        self.stuck = np.zeros(DOF, dtype=bool)
        self.limp = False

    def step(self) -> None:
        told = self.tau
        q = self.__dict__["q"]
        self.tau = told + self.pushed
        super().step()
        self.tau = told
        crawl = (
            1e-6 * (-1.0) ** self.steps
        )  # readings that stay the same to the bit are frozen, not stuck
        self.v = np.where(self.stuck, crawl, self.__dict__["v"])
        self.q = np.where(self.stuck, q + self.dt * crawl, self.__dict__["q"])

    def command(self, tau: Array, fingers: Array) -> None:
        super().command(tau, self.fingers if self.limp else fingers)

    def touch_nothing(self) -> None:
        self.pushed = np.zeros(DOF)
        self.stuck = np.zeros(DOF, dtype=bool)
