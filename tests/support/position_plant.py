"""A quick plant that takes joint targets: joints follow them exactly one step later, or with a fault."""

from __future__ import annotations

import numpy as np

from minidual.plant.lifecycle import ArmHealth, CommandKind, Sent
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, Robot, slower_robot


class Follower:
    """Two arms at 50 Hz with ideal drives.

    Faults: `stuck` joints stay, `late_arm_s` ages one arm's stamps, `lag_ticks` delays an arm's
    joints, `jitter_s` makes steps uneven, `tau_off` adds to the torques, `sag_rad_s` lets joints
    sink, `fingers_least_m` stops the fingers, `limits_rad` is what it declares, `swapped` arms.
    """

    place = "test double"
    kinds = (CommandKind.POSITION,)
    kind = CommandKind.POSITION

    def __init__(self, robot: Robot = DUAL_PANDA, dt: float = 0.02) -> None:
        self.robot = robot
        self.dt = dt
        self.grip_max_n = 70.0
        self.braking_share = 1.0
        self.calls: list[str] = []
        self.targets: list[Array] = [robot.home.copy()]
        self.stuck = np.zeros(robot.dof, dtype=bool)
        self.late_arm_s = 0.0
        self.lag_ticks = [0, 0]
        self.jitter_s = 0.0
        self.tau_off = np.zeros(robot.dof)
        self.sag_rad_s = np.zeros(robot.dof)
        self.fingers_least_m = 0.0
        self.limits_rad: tuple[Array, Array] | None = None
        self.swapped = False
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
        return self._ticks * self.dt + self.jitter_s * (self._ticks % 2)

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
        return np.array(self._kinematics.gravity(self._q)) + self.tau_off

    @property
    def sent(self) -> Sent:
        return Sent(CommandKind.POSITION, self.time, q=self._target)

    def follow(self, q: Array, v: Array, openings: Array) -> None:
        self._target = q.copy()
        self.targets.append(q.copy())
        self.openings = np.where(np.isnan(openings), self.openings, openings)
        wide = self.openings * self.robot.hand.travel_m
        self.fingers = np.maximum(wide, self.fingers_least_m)

    def brake(self, arms: tuple[int, ...]) -> None:
        self.braked = arms

    def step(self) -> None:
        self._last = self._q.copy()
        n = self.robot.dof_per_arm
        told = [self.targets[-1 - min(lag, len(self.targets) - 1)] for lag in self.lag_ticks]
        wanted = np.concatenate([told[0][:n], told[1][n:]])
        if self.swapped:
            wanted = np.concatenate([wanted[n:], wanted[:n]])
        self._q = np.where(self.stuck, self._q, wanted) + self.sag_rad_s * self.dt
        self._ticks += 1


def gentle(robot: Robot) -> Follower:
    """Return arms whose steps of 20 ms are small beside what their velocity says."""
    plant = Follower(slower_robot(robot, 0.8, 0.3))
    plant.braking_share = 0.3
    return plant
