"""The controllers, their interface and what hands carry.

A  `both_arms`                  joint trajectories
B  `left_arm`, `right_arm`      the same, one arm
   `left_hand`, `right_hand`    the same, by impedance of a hand
C  `object_impedance`           both arms and an object
   `soft_stop`                  stops both arms

A joint trajectory controller that holds learns what its hand holds (see payload.py).
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from minidual.control.arbiter import ArbiterOutput
from minidual.control.commands import ArbiterState, Command, JointCommand, Reason, TrajectoryCommand
from minidual.control.execution import TrajectoryExecution
from minidual.control.joint_control import SERVO_RAD_S, ComputedTorque, ReferenceFilter
from minidual.control.kernels import minimum_jerk
from minidual.control.payload import Payload
from minidual.control.target_lead import AnticipatingFilter
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, arms_of

_BLEND_S = 0.5
"""Fade time of a trajectory's start offset."""


class Controller(ABC):
    """Turns commands into torques of its arms."""

    name: str
    arms: tuple[int, ...] = (0, 1)
    takes: tuple[type, ...] = ()
    """Kinds of commands."""
    compliant: bool = False
    """Whether its arms leave their reference: others start from where they are."""
    reference: Array
    """Last joint reference (n,) [rad]; measured joints if none."""
    acceleration: Array | None = None
    """Last commanded acceleration (n,) [rad/s^2], without the fading offset; None while braking."""

    def refuses(self, command: Command) -> Reason | None:
        """Return why it refuses a command, or None."""
        if isinstance(command, self.takes):
            return None
        taken = " and ".join(kind.__name__ for kind in self.takes) or "no command: ask for a mode"
        return (
            "wrong_controller",
            f"controller {self.name} takes {taken}, no {type(command).__name__}",
        )

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


class _Fade(NamedTuple):
    """A trajectory's start offset that fades: the offset [rad], and steps so far by the path's clock."""

    offset: Array
    steps: float


class JointTrajectoryController(Controller):
    """Follows streamed targets through the reference filter, timed trajectories directly; holds learn the payload."""

    takes = (JointCommand, TrajectoryCommand)

    def __init__(self, group: str, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        dof = kinematics.robot.dof
        self.name = group
        self.arms = arms_of(group)
        self._dt = dt_s
        self._payload = payload
        self._holds = False
        self._kinematics = kinematics
        self._servo = ComputedTorque(kinematics)
        self._robot = kinematics.robot
        self._filter: ReferenceFilter | AnticipatingFilter
        self._filter = ReferenceFilter(dt_s, kinematics.robot)
        self._executions: dict[TrajectoryExecution, _Fade | None] = {}
        """Running trajectories, with the fade of their start; None where it is over."""
        self._faded = np.zeros((3, dof))
        """Reference q, v, a with the fading offsets."""
        self._planned = np.zeros(dof)
        """Reference acceleration without them."""
        self._target = np.zeros(dof)
        self.reference = self._target

    def anticipate(self, period_s: float) -> None:
        """Feed the velocity of streamed targets of this period forward; the arms stand still."""
        self._filter = AnticipatingFilter(self._dt, period_s, self._robot)
        self._filter.reset(self.reference)

    def soften(self, share: float) -> None:
        """Track the reference with a share of the full stiffness; 1 restores it."""
        frequency = SERVO_RAD_S * share**0.5
        self._servo = ComputedTorque(self._kinematics, natural_frequency_rad_s=frequency)

    def activate(self, q: Array, v: Array) -> None:
        """Start the reference at the measurement."""
        self._filter.reset(q, v)
        self._target = np.array(q, dtype=float)
        self._executions.clear()
        self.reference = np.array(q, dtype=float)
        self.acceleration = None
        self._load: Array | None = None
        self._ticks = 0

    def follow(self, output: ArbiterOutput) -> None:
        """Take the target, newly begun trajectories and the speed override."""
        self._target = output.q_target.copy()
        self._holds = output.state is ArbiterState.HOLDING
        self._filter.limit_speed(output.speed)
        if isinstance(self._filter, AnticipatingFilter):
            self._filter.feeds = output.state is ArbiterState.ACTIVE
        for execution in output.executions:
            if not isinstance(execution, TrajectoryExecution) or execution in self._executions:
                continue
            if set(execution.arms) & set(self.arms):
                offset = self.reference[execution.joints] - execution.q
                differs = np.abs(offset).max() > 1e-12
                self._executions[execution] = _Fade(offset, 0) if differs else None

    def update(self, q: Array, v: Array) -> Array:
        """See `Controller`."""
        if self._executions:
            q_ref, v_ref, a_ref, self.acceleration = self._trajectory_reference()
        else:
            q_ref, v_ref, a_ref = self._filter.step(self._target)
            self.acceleration = a_ref
        self.reference = q_ref
        if self._holds or self._ticks % self._payload.every == 0:
            self._load = self._payload.torque(q, q_ref, self.arms, learn=self._holds)
        self._ticks += 1
        return self._servo.torque(q, v, q_ref, v_ref, a_ref, self._load)

    def _trajectory_reference(self) -> tuple[Array, Array, Array, Array | None]:
        """Return q, v, a (n,) of the reference, and the planned acceleration; None while a trajectory brakes."""
        executions = list(self._executions)
        braking = any(execution.braking for execution in executions)
        first = executions[0]
        drives_all = len(first.q) == len(self._target)
        if drives_all and self._executions[first] is None and not first.finished:
            return first.q, first.v, first.a, None if first.braking else first.a
        driven = {arm for execution in executions for arm in execution.arms}
        if not driven.issuperset(self.arms):
            self._faded[:] = self._filter.step(self._target)
        self._planned[:] = self._faded[2]
        for execution in executions:
            joints = execution.joints
            self._faded[:, joints] = execution.q, execution.v, execution.a
            self._planned[joints] = execution.a
            self._fade_start(execution)
            if execution.finished:
                self._end(execution)
        q, v, a = self._faded.copy()
        return q, v, a, None if braking else self._planned.copy()

    def _fade_start(self, execution: TrajectoryExecution) -> None:
        """Add what is left of the start offset, which fades by the path's clock."""
        fade = self._executions[execution]
        if fade is None:
            return
        s, ds, dds = minimum_jerk(fade.steps * self._dt / _BLEND_S)
        rate = execution.rate / _BLEND_S
        shares = 1.0 - s, -ds * rate, -dds * rate**2
        self._faded[:, execution.joints] += np.outer(shares, fade.offset)
        execution.left = shares[0] * fade.offset
        over = fade.steps * self._dt >= _BLEND_S
        self._executions[execution] = (
            None if over else fade._replace(steps=fade.steps + execution.rate)
        )

    def _end(self, execution: TrajectoryExecution) -> None:
        joints = execution.joints
        del self._executions[execution]
        self._target = self._target.copy()
        self._target[joints] = execution.q + execution.left * execution.braking
        self._filter.reset(self._faded[0], self._faded[1], joints=joints)
