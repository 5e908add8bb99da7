"""A quick plant that takes joint targets: joints follow them exactly one step later."""

from __future__ import annotations

import numpy as np

from minidual.plant.lifecycle import ArmHealth, CommandKind, Sent
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, Robot


class Follower:
    """Two arms at 50 Hz with ideal drives; `stuck` joints stay, `late_arm_s` ages one arm's stamps."""

    place = "test double"
    kinds = (CommandKind.POSITION,)
    kind = CommandKind.POSITION

    def __init__(self, robot: Robot = DUAL_PANDA, dt: float = 0.02) -> None:
        self.robot = robot
        self.dt = dt
        self.grip_max_n = 70.0
        self.calls: list[str] = []
        self.targets: list[Array] = []
        self.stuck = np.zeros(robot.dof, dtype=bool)
        self.late_arm_s = 0.0
        self.faults: list[tuple[str, ...]] = [(), ()]
        self.recovers = True
        self.braked: tuple[int, ...] = ()
        self._kinematics = Kinematics(robot)
        self._rng = np.random.default_rng(0)
        self._q = robot.home.copy()
        self._last = self._q.copy()
        self._target = self._q.copy()
        self._ticks = 0
        self.fingers = np.full(2, robot.hand.travel_m)
        self.grip = np.zeros(2)
        self.openings = np.ones(2)

    def connect(self) -> None:
        self.calls.append("connect")

    def activate(self, kind: CommandKind) -> None:
        self.calls.append(f"activate {kind}")

    def recover(self) -> None:
        self.calls.append("recover")
        if self.recovers:
            self.faults = [(), ()]

    def close(self) -> None:
        self.calls.append("close")

    @property
    def health(self) -> str:
        return "; ".join(fault for faults in self.faults for fault in faults)

    @property
    def healths(self) -> list[ArmHealth]:
        return [
            ArmHealth(side, faults)
            for side, faults in zip(("left", "right"), self.faults, strict=True)
        ]

    @property
    def time(self) -> float:
        return self._ticks * self.dt

    stamp_s = time

    @property
    def stamps_s(self) -> Array:
        return np.array([self.time, self.time - self.late_arm_s])

    @property
    def q(self) -> Array:
        return self._q + self._noise

    @property
    def v(self) -> Array:
        return (self._q - self._last) / self.dt

    @property
    def _noise(self) -> Array:
        return 1e-7 * self._rng.standard_normal(self.robot.dof)

    @property
    def tau(self) -> Array:
        return np.array(self._kinematics.gravity(self._q))

    @property
    def sent(self) -> Sent:
        return Sent(CommandKind.POSITION, self.time, q=self._target)

    def follow(self, q: Array, v: Array, openings: Array) -> None:
        self._target = q.copy()
        self.targets.append(q.copy())
        self.openings = openings.copy()

    def brake(self, arms: tuple[int, ...]) -> None:
        self.braked = arms

    def step(self) -> None:
        self._last = self._q.copy()
        self._q = np.where(self.stuck, self._q, self._target)
        self._ticks += 1
