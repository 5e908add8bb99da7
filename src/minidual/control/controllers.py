"""The controllers and their interface.

A  `both_arms`                  joint trajectories
B  `left_arm`, `right_arm`      the same, one arm
C  `object_impedance`           both arms and an object
   `soft_stop`                  stops both arms
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from minidual.control.command_checks import Fault
from minidual.control.commands import Command, JointCommand, TrajectoryCommand, arms_of
from minidual.control.execution import ArbiterOutput, TrajectoryExecution
from minidual.control.joint_control import ComputedTorque
from minidual.control.object_path import minimum_jerk
from minidual.control.reference import ReferenceFilter
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

_BLEND_S = 0.5
"""Fade time of a trajectory's start offset."""


class Controller(ABC):
    """Turns commands into torques of the arms it claims."""

    name: str
    arms: tuple[int, ...] = (0, 1)

    @abstractmethod
    def find_fault(self, command: Command) -> Fault | None:
        """Return why it refuses a command now, or None."""

    def not_ready(self) -> str:
        """Return why it cannot be activated, or ""."""
        return ""

    @abstractmethod
    def activate(self, q: Array, v: Array) -> None:
        """Take over smoothly at measured q, v (n,)."""

    def follow(self, output: ArbiterOutput) -> None:  # noqa: B027 - a controller may follow nothing
        """Receive the arbiter's output."""

    @abstractmethod
    def update(self, q: Array, v: Array) -> Array:
        """Run one control step; return torques (n,), valid for its joints."""

    @property
    @abstractmethod
    def reference(self) -> Array:
        """Last joint reference (n,) [rad]; measured joints if none."""

    @property
    def acceleration(self) -> Array | None:
        """Last commanded reference acceleration (n,) [rad/s^2], or None."""
        return None


class JointTrajectoryController(Controller):
    """Follows streamed targets through the reference filter, and timed trajectories directly."""

    def __init__(
        self,
        group: str,
        kinematics: Kinematics,
        dt_s: float,
        *,
        natural_frequency_rad_s: float = 20.0,
        bandwidth_rad_s: float = 30.0,
    ) -> None:
        self.name = group
        self.arms = arms_of(group)
        self._dt = dt_s
        self._servo = ComputedTorque(kinematics, natural_frequency_rad_s=natural_frequency_rad_s)
        self._filter = ReferenceFilter(dt_s, kinematics.robot, bandwidth_rad_s=bandwidth_rad_s)
        n = kinematics.robot.dof
        self._target = np.zeros(n)
        self._executions: dict[TrajectoryExecution, tuple[Array, int]] = {}
        self._q, self._v, self._a = np.zeros(n), np.zeros(n), np.zeros(n)
        self._last_q, self._last_v = self._q, self._v
        self._last_a: Array | None = None
        self._a_asked = np.zeros(n)

    def find_fault(self, command: Command) -> Fault | None:
        """Refuse all but joint commands."""
        if isinstance(command, JointCommand | TrajectoryCommand):
            return None
        return "wrong_controller", f"controller {self.name} takes joint commands, no {type(command).__name__}"

    def activate(self, q: Array, v: Array) -> None:
        """Start the reference at the measurement."""
        self._filter.reset(q, v)
        self._target = np.array(q, dtype=float)
        self._executions.clear()
        self._last_q, self._last_v = np.array(q, dtype=float), np.array(v, dtype=float)
        self._last_a = None

    def follow(self, output: ArbiterOutput) -> None:
        """Take the target and newly begun trajectories."""
        self._target = output.q_target
        for execution in output.executions:
            if not isinstance(execution, TrajectoryExecution) or execution in self._executions:
                continue
            if set(execution.arms) & set(self.arms):
                offset = self._last_q[execution.joints] - execution.q
                self._executions[execution] = (offset, 0 if np.abs(offset).max() > 1e-12 else -1)

    def update(self, q: Array, v: Array) -> Array:
        """Run one control step."""
        if self._executions:
            braking = any(execution.braking for execution in self._executions)
            q_ref, v_ref, a_ref = self._trajectory_reference()
            self._last_a = None if braking else self._a_asked
        else:
            q_ref, v_ref, a_ref = self._filter.step(self._target)
            self._last_a = a_ref
        self._last_q, self._last_v = q_ref, v_ref
        return self._servo.torque(q, v, q_ref, v_ref, a_ref)

    @property
    def reference(self) -> Array:
        """Last joint reference (n,) [rad]."""
        return self._last_q

    @property
    def acceleration(self) -> Array | None:
        """As commanded, without the fading offset; None while braking."""
        return self._last_a

    def _trajectory_reference(self) -> tuple[Array, Array, Array]:
        driven = {arm for execution in self._executions for arm in execution.arms}
        if not driven.issuperset(self.arms):
            self._q[:], self._v[:], self._a[:] = self._filter.step(self._target)
        self._a_asked[:] = self._a
        ended = False
        for execution, (offset, k) in list(self._executions.items()):
            joints = execution.joints
            self._q[joints], self._v[joints], self._a[joints] = execution.q, execution.v, execution.a
            self._a_asked[joints] = execution.a
            if k >= 0:
                s, ds, dds = minimum_jerk(k * self._dt / _BLEND_S)
                self._q[joints] += offset * (1.0 - s)
                self._v[joints] -= offset * (ds / _BLEND_S)
                self._a[joints] -= offset * (dds / _BLEND_S**2)
                self._executions[execution] = (offset, k + 1 if k * self._dt < _BLEND_S else -1)
            if execution.finished:
                del self._executions[execution]
                self._target = self._target.copy()
                self._target[joints] = execution.q
                ended = True
        if ended:
            self._filter.reset(self._q, self._v)
        return self._q.copy(), self._v.copy(), self._a.copy()
