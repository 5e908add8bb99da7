"""Control stacks on quick plants, and what drives them in tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from minidual.config.control import SupervisorConfig
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


def supervised(
    plant: ArmsPlant,
    *,
    config_of_supervisor: SupervisorConfig | None = None,
    **options: Any,
) -> Attended:
    supervisor = Supervisor(config_of_supervisor, dt_s=plant.dt)
    return stack_on(plant, supervisor=supervisor, **options)


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

    @property
    def true_q(self) -> Array:
        """Positions (14,) [rad] past the sensors."""
        return self.__dict__["q"]

    @property
    def true_v(self) -> Array:
        """Velocities (14,) [rad/s] past the sensors."""
        return self.__dict__["v"]

    def step(self) -> None:
        kept = self.lies  # physics does not read the sensors
        self.lies = {}
        super().step()
        self.lies = kept


def off_by(joint: int, value: float) -> Callable[[Array], Array]:
    """Return a lie that adds to one joint's reading."""
    return lambda x: x + value * np.eye(DOF)[joint]


def nan_of(*joints: int) -> Callable[[Array], Array]:
    """Return a lie by which these joints read NaN."""
    return lambda x: np.where(np.isin(np.arange(DOF), joints), np.nan, x)


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
    """As MuJoCo, implicit in the joints' damping.

    Attributes:
        pushed: External torques (14,) [Nm].
        stuck: (14,) joints that stand still.
        limp: Whether the fingers stay where they are.
    """

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        model = self._kinematics.model.copy()  # all workspaces share the original
        self._kinematics.model = model
        model.armature = model.armature + self.dt * JOINT_DAMPING
        self.pushed = np.zeros(DOF)
        self.stuck = np.zeros(DOF, dtype=bool)
        self.limp = False

    def step(self) -> None:
        told = self.tau
        q = self.true_q
        self.tau = told + self.pushed
        super().step()
        self.tau = told
        crawl = 1e-6 * (-1.0) ** self.steps  # a stuck joint is not a frozen sensor
        self.v = np.where(self.stuck, crawl, self.true_v)
        self.q = np.where(self.stuck, q + self.dt * crawl, self.true_q)

    def command(self, tau: Array, fingers: Array) -> None:
        super().command(tau, self.fingers if self.limp else fingers)

    def touch_nothing(self) -> None:
        self.pushed = np.zeros(DOF)
        self.stuck = np.zeros(DOF, dtype=bool)

    def grip_something(self, *, left_only: bool = False) -> None:
        """Let the hands feel 60 N of something 20 mm wide between their fingers."""
        self.grip = np.array([60.0, 0.0 if left_only else 60.0])
        self.fingers = np.array([0.01, 0.04 if left_only else 0.01])
        self.limp = True


class SlowArms(Arms):
    """Arms that are controlled at a lower rate; their physics stays at 1 kHz."""

    def __init__(self, scene: SceneConfig, rate_hz: int) -> None:
        super().__init__(scene)
        self._every = 1000 // rate_hz
        self.dt = 1e-3 * self._every

    @property
    def time(self) -> float:
        return self.steps * 1e-3

    def step(self) -> None:
        self.dt = 1e-3
        for _ in range(self._every):
            super().step()
        self.dt = 1e-3 * self._every


APART = np.r_[np.full(7, 0.5), np.full(7, -0.5)]
"""A way of both arms away from one another [rad]."""
SPACIOUS = SupervisorConfig(workspace_m=((-2, 2), (-2, 2), (-2, 2.5)))
"""A supervisor whose workspace nothing leaves."""


def in_motion(plant: ArmsPlant) -> ControlStack:
    """Return a supervised stack whose arms move apart at 0.9 rad/s."""
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + APART, 1.0))) is None
    assert run(stack, 480) == []
    assert np.abs(plant.v).max() > 0.85
    return stack


def fastest_in(stack: ControlStack, ticks: int) -> float:
    """Step; return the largest true speed [rad/s] of a joint."""
    fastest = 0.0
    for _ in range(ticks):
        run(stack, 1)
        fastest = max(fastest, float(np.abs(stack.plant.true_v).max()))
    return fastest


def hand_height_m(plant: FailingPlant, arm: int) -> float:
    return float(Kinematics().tcp_poses(plant.true_q)[arm][2, 3])
