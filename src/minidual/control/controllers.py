"""The controllers and their interface.

A  `both_arms`                  joint trajectories
B  `left_arm`, `right_arm`      the same, one arm
C  `object_impedance`           both arms and an object
   `soft_stop`                  stops both arms
"""

from abc import ABC, abstractmethod

import numpy as np

from minidual.control.commands import ArbiterState, Command, JointCommand, Reason, TrajectoryCommand, arms_of
from minidual.control.execution import ArbiterOutput, TrajectoryExecution
from minidual.control.joint_control import ComputedTorque
from minidual.control.object_path import minimum_jerk
from minidual.control.payload import Payload
from minidual.control.reference import ReferenceFilter
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

_BLEND_S = 0.5
"""Fade time of a trajectory's start offset."""


class Controller(ABC):
    """Turns commands into torques of its arms."""

    name: str
    arms: tuple[int, ...] = (0, 1)
    takes: tuple[type, ...] = ()
    """Kinds of commands."""
    reference: Array
    """Last joint reference (n,) [rad]; measured joints if none."""
    acceleration: Array | None = None
    """Last commanded acceleration (n,) [rad/s^2], without the fading offset; None while braking."""

    def refuses(self, command: Command) -> Reason | None:
        """Return why it refuses a command, or None."""
        if isinstance(command, self.takes):
            return None
        taken = " and ".join(kind.__name__ for kind in self.takes) or "no command: ask for a mode"
        return "wrong_controller", f"controller {self.name} takes {taken}, no {type(command).__name__}"

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


class JointTrajectoryController(Controller):
    """Follows streamed targets through the reference filter, timed trajectories directly; holds learn the payload."""

    takes = (JointCommand, TrajectoryCommand)

    def __init__(self, group: str, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        self.name, self.arms, self._dt, self._payload, self._holds = group, arms_of(group), dt_s, payload, False
        self._servo, self._filter = ComputedTorque(kinematics), ReferenceFilter(dt_s, kinematics.robot)
        self._executions: dict[TrajectoryExecution, tuple[Array, int]] = {}
        """Running, with the offset of the start and the steps of its fade, or -1."""
        self._q, self._v, self._a, self._a_asked, self._target = np.zeros((5, kinematics.robot.dof))
        self.reference = self._q

    def activate(self, q: Array, v: Array) -> None:
        """Start the reference at the measurement."""
        self._filter.reset(q, v)
        self._target = np.array(q, dtype=float)
        self._executions.clear()
        self.reference, self.acceleration = np.array(q, dtype=float), None

    def follow(self, output: ArbiterOutput) -> None:
        """Take the target, newly begun trajectories and the speed override."""
        self._target, self._holds = output.q_target, output.state is ArbiterState.HOLDING
        self._payload.follow(output.gripper)
        self._filter.limit_speed(output.speed)
        for execution in output.executions:
            if not isinstance(execution, TrajectoryExecution) or execution in self._executions:
                continue
            if set(execution.arms) & set(self.arms):
                offset = self.reference[execution.joints] - execution.q
                self._executions[execution] = (offset, 0 if np.abs(offset).max() > 1e-12 else -1)

    def update(self, q: Array, v: Array) -> Array:
        """See `Controller`."""
        if self._executions:
            braking = any(execution.braking for execution in self._executions)
            q_ref, v_ref, a_ref = self._trajectory_reference()
            self.acceleration = None if braking else self._a_asked
        else:
            q_ref, v_ref, a_ref = self._filter.step(self._target)
            self.acceleration = a_ref
        self.reference = q_ref
        load = self._payload.torque(q, q_ref, self.arms, learn=self._holds)
        return self._servo.torque(q, v, q_ref, v_ref, a_ref, load)

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
