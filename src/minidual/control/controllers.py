"""The controllers, their interface and what hands carry.

A  `both_arms`                  joint trajectories
B  `left_arm`, `right_arm`      the same, one arm
   `left_hand`, `right_hand`    the same, by impedance of a hand
C  `object_impedance`           both arms and an object
   `soft_stop`                  stops both arms

A hold learns what a hand holds (docs/control.md).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from minidual.control.arbiter import ArbiterOutput
from minidual.control.commands import ArbiterState, Command, JointCommand, Reason, TrajectoryCommand
from minidual.control.execution import TrajectoryExecution
from minidual.control.gripper import CLOSE_BELOW, GRAVITY_M_PER_S2, OPEN_ABOVE
from minidual.control.joint_control import ComputedTorque, ReferenceFilter
from minidual.control.kernels import minimum_jerk, within
from minidual.errors import UsageError
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array, arms_of

LOAD_MAX_N = 30.0
"""The Panda's payload."""
_GAIN_N_PER_M_S = 2000.0  # slow beside the joints' stiffness, about 1.2 kN/m at a hand
_NEAR_M = 2e-4
_RAMP_N_PER_S = 100.0  # a moving arm's Jacobian in each step makes it a third longer
_EVERY_S = 0.01


class Payload:
    """The load of each hand, for all controllers of a stack."""

    def __init__(self, kinematics: Kinematics, dt_s: float) -> None:
        self._kinematics = kinematics
        self._hands = Hands(kinematics)
        self._dt = dt_s
        self.every = max(1, round(_EVERY_S / dt_s))
        """Steps from one update of moving arms' torques to the next."""
        self.reset()

    def reset(self) -> None:
        """Start without loads, hands open."""
        self.force_n = [0.0, 0.0]
        self._wanted_n = [0.0, 0.0]
        self.closed = [False, False]
        self._held = [False, False]
        self.idle: tuple[int, ...] = ()
        """Arms whose torques do not reach the motors: what they miss is no load."""

    def bear(self, arm: int, mass_kg: float) -> None:
        """Tell what a hand takes up now, at 100 N/s.

        Raises:
            UsageError: No such arm, or a mass that it cannot bear.
        """
        if not (arm in (0, 1) and 0.0 <= mass_kg * GRAVITY_M_PER_S2 <= LOAD_MAX_N):
            most_kg = LOAD_MAX_N / GRAVITY_M_PER_S2
            raise UsageError(
                f"arm {arm} cannot be told to bear {mass_kg} kg: arms 0 and 1 bear 0 to {most_kg:.2f} kg",
            )
        self._wanted_n[arm] = mass_kg * GRAVITY_M_PER_S2

    def take_over(self, force_n: float) -> None:
        """Bear this in each hand at once: another controller has borne it until now."""
        self.force_n[:] = self._wanted_n[:] = force_n, force_n

    def feel(self, q: Array, torque: Array, arms: Sequence[int]) -> None:
        """Bear at once what these hands lift at q (n,), where external torques (n,) [Nm] are felt."""
        self._hands.update(q)
        for arm in arms:
            joints = self._kinematics.robot.joints_of(arm)
            rise = self._hands.rise(arm)
            felt_n = -float(rise @ torque[joints]) / float(rise @ rise)
            if felt_n > self.force_n[arm]:  # false for NaN
                self.force_n[arm] = self._wanted_n[arm] = min(felt_n, LOAD_MAX_N)

    def follow(self, gripper: Array, lost: Sequence[bool], held: Sequence[bool]) -> None:
        """Take commanded openings (2,), and which hands lost their grip or hold something.

        What opens or has lost lets go of its load; only what holds something learns one.
        """
        self._held = held
        for arm, opening in enumerate(gripper.tolist()):
            if lost[arm] or (self.closed[arm] and opening > OPEN_ABOVE):
                self._wanted_n[arm] = 0.0
                if arm in self.idle:  # the stop bounds the torque's rate
                    self.force_n[arm] = 0.0
            self.closed[arm] = opening < CLOSE_BELOW or (self.closed[arm] and opening <= OPEN_ABOVE)

    def torque(self, q: Array, q_ref: Array, arms: Sequence[int], *, learn: bool) -> Array | None:
        """Return the torques (n,) [Nm] that bear these arms' loads, or None.

        Call it in each step with `learn` if they hold still, else in `every` so many.
        """
        if not (learn or any(self.force_n + self._wanted_n)):
            return None
        self._hands.update(q)
        tau = np.zeros(len(q))
        wanted_n = self._wanted_n
        step_n = _RAMP_N_PER_S * self._dt * (1 if learn else self.every)
        for arm in arms:
            joints = self._kinematics.robot.joints_of(arm)
            rise = self._hands.rise(arm)
            below_m = float(rise @ (q_ref - q)[joints])
            now_n = self.force_n[arm]
            if (
                learn and self._held[arm] and arm not in self.idle and abs(below_m) > _NEAR_M
            ):  # false for NaN
                wanted_n[arm] = within(
                    wanted_n[arm] + _GAIN_N_PER_M_S * self._dt * below_m,
                    0.0,
                    LOAD_MAX_N,
                )
            self.force_n[arm] = within(wanted_n[arm], now_n - step_n, now_n + step_n)
            tau[joints] = self.force_n[arm] * rise
        return tau if any(self.force_n) else None


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

    def regain(self, arms: Sequence[int], q: Array, v: Array) -> None:
        """Take over again where power has returned to some arms."""
        self.activate(q, v)

    def follow(self, output: ArbiterOutput) -> None:  # noqa: B027 - a controller may follow nothing
        """Receive the arbiter's output."""

    @abstractmethod
    def update(self, q: Array, v: Array) -> Array:
        """Run one control step; return torques (n,), valid for its joints."""


class JointTrajectoryController(Controller):
    """Follows streamed targets through the reference filter, timed trajectories directly; holds learn the payload."""

    takes = (JointCommand, TrajectoryCommand)

    def __init__(self, group: str, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        self.name = group
        self.arms = arms_of(group)
        self._dt = dt_s
        self._payload = payload
        self._holds = False
        self._servo = ComputedTorque(kinematics)
        self._filter = ReferenceFilter(dt_s, kinematics.robot)
        self._executions: dict[TrajectoryExecution, tuple[Array, float]] = {}
        """Running, with the offset of the start and the steps of its fade by the path's clock, or -1."""
        self._rows = np.zeros((4, kinematics.robot.dof))
        self._target = np.zeros(kinematics.robot.dof)
        """_rows: q, v, a of the reference with the fading offsets, and a without them."""
        self.reference = self._target

    def activate(self, q: Array, v: Array) -> None:
        """Start the reference at the measurement."""
        self._filter.reset(q, v)
        self._target = np.array(q, dtype=float)
        self._executions.clear()
        self.reference = np.array(q, dtype=float)
        self.acceleration = None
        self._load = None
        self._age = 0

    def follow(self, output: ArbiterOutput) -> None:
        """Take the target, newly begun trajectories and the speed override."""
        self._target = output.q_target.copy()
        self._holds = output.state is ArbiterState.HOLDING
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
            q_ref, v_ref, a_ref, self.acceleration = self._trajectory_reference()
        else:
            q_ref, v_ref, a_ref = self._filter.step(self._target)
            self.acceleration = a_ref
        self.reference = q_ref
        if self._holds or self._age % self._payload.every == 0:
            self._load = self._payload.torque(q, q_ref, self.arms, learn=self._holds)
        self._age += 1
        return self._servo.torque(q, v, q_ref, v_ref, a_ref, self._load)

    def _trajectory_reference(self) -> tuple[Array, Array, Array, Array | None]:
        execution, (_, k) = next(iter(self._executions.items()))
        braking = execution.braking or (
            len(self._executions) > 1 and any(one.braking for one in self._executions)
        )
        if (
            k < 0 and len(execution.q) == len(self._target) and not execution.finished
        ):  # it drives all joints
            return execution.q, execution.v, execution.a, None if braking else execution.a
        driven = {arm for execution in self._executions for arm in execution.arms}
        if not driven.issuperset(self.arms):
            self._rows[:3] = self._filter.step(self._target)
        self._rows[3] = self._rows[2]
        for execution, (offset, k) in list(self._executions.items()):
            joints = execution.joints
            self._rows[:, joints] = execution.q, execution.v, execution.a, execution.a
            if k >= 0:
                (s, ds, dds) = minimum_jerk(k * self._dt / _BLEND_S)
                rate = execution.rate / _BLEND_S
                fade = 1.0 - s, -ds * rate, -dds * rate**2
                self._rows[:3, joints] += np.outer(fade, offset)
                execution.left = fade[0] * offset
                self._executions[execution] = (
                    offset,
                    k + execution.rate if k * self._dt < _BLEND_S else -1,
                )
            if execution.finished:
                del self._executions[execution]
                self._target = self._target.copy()
                self._target[joints] = execution.q + execution.left * execution.braking
                self._filter.reset(*self._rows[:2], joints=joints)
        q, v, a, planned = self._rows.copy()
        return q, v, a, None if braking else planned
