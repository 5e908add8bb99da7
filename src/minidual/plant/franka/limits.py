"""Limits of commanded motions, torques and collisions, with errors by the vendor's names.

Nothing here knows a network or a simulator. The derivatives are those of the commands, at 1 kHz.
Source of the numbers: the arm model, and the Franka Control Interface documentation: "Limits for
Panda", and for the fall of the velocity near a position limit "Limits for Franka Research 3".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.plant.franka.wire import JOINTS_N
from minidual.robot.models import ArmModel
from minidual.robot.pair import Array

DT_S = 1e-3
LOST_PACKETS_MAX = 20
"""So many commands in a row that did not come in time end a motion."""
NOISE = 1.02
"""Third differences of targets that were filtered with the float32 of a state are noisy."""
ROUNDING = 1e-3
"""Velocities and rates may exceed their limits by this."""
START_RAD = 0.02
"""The first target of a motion is no further from where the last one ended."""


@dataclass(frozen=True)
class FciLimits:
    """Limits of one arm behind the control interface; joints (7,).

    Attributes:
        q_lower, q_upper: [rad].
        v_max: [rad/s].
        velocity_offset: [rad/s], see `v_upper`.
        deceleration: [rad/s^2], likewise.
        a_max, jerk_max: [rad/s^2], [rad/s^3].
        tau_max, tau_rate_max: [Nm], [Nm/s].
        linear: Speed, acceleration and jerk of the hand [m].
        angular: The same [rad].
        elbow: The same of the elbow [rad].
        tau_range_nm: Range of the torque sensors.
        power_max_w: Of all motors of the arm.
    """

    q_lower: Array
    q_upper: Array
    v_max: Array
    velocity_offset: Array
    deceleration: Array
    a_max: Array
    jerk_max: Array
    tau_max: Array
    tau_rate_max: Array
    linear: tuple[float, float, float] = (1.7, 13.0, 6500.0)
    angular: tuple[float, float, float] = (2.5, 25.0, 12500.0)
    elbow: tuple[float, float, float] = (2.175, 10.0, 5000.0)
    tau_range_nm: float = 1.2
    power_max_w: float = 600.0

    def v_upper(self, q: Array) -> Array:
        """Return the largest velocities (7,) [rad/s] at q (7,): an arm must be able to stop."""
        room = np.maximum(0.0, 2.0 * self.deceleration * (self.q_upper - q))
        return np.minimum(self.v_max, np.maximum(0.0, np.sqrt(room) - self.velocity_offset))

    def v_lower(self, q: Array) -> Array:
        """Return the least velocities (7,) [rad/s] at q (7,)."""
        room = np.maximum(0.0, 2.0 * self.deceleration * (q - self.q_lower))
        return np.maximum(-self.v_max, np.minimum(0.0, self.velocity_offset - np.sqrt(room)))


_VELOCITY_OFFSET = (0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35)
_DECELERATION = (6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0)


def limits_of(arm: ArmModel) -> FciLimits:
    """Return the interface's limits of an arm with seven joints.

    Raises:
        ValueError: It has another number of joints.
    """
    joints_n = len(arm.joints)
    if joints_n != JOINTS_N:
        raise ValueError(f"arm '{arm.name}' has {joints_n} joints; the interface is for {JOINTS_N}")
    return FciLimits(
        q_lower=np.array(arm.q_lower),
        q_upper=np.array(arm.q_upper),
        v_max=np.array(arm.v_max),
        velocity_offset=np.array(_VELOCITY_OFFSET),
        deceleration=np.array(_DECELERATION),
        a_max=np.array(arm.a_max),
        jerk_max=np.array(arm.jerk_max),
        tau_max=np.array(arm.tau_max),
        tau_rate_max=np.full(JOINTS_N, arm.tau_rate_max),
    )


class JointMotion:
    """Checks joint targets that come one a millisecond.

    Args:
        limits: Of the arm.
        q: Where the target stands when the motion starts (7,) [rad].
        prefix: Of the errors: `joint_motion_generator`, or what follows from poses.
        v: Its velocity (7,) [rad/s].
    """

    def __init__(
        self,
        limits: FciLimits,
        q: Array,
        prefix: str = "joint_motion_generator",
        v: Array | None = None,
    ) -> None:
        self._limits = limits
        after_poses = prefix.startswith("cartesian")
        part = "joint_" if after_poses else ""
        self._position = f"{prefix}_{part}position_limits_violation"
        self._velocity = f"{prefix}_{part}velocity_limits_violation"
        self._acceleration = f"{prefix}_{part}velocity_discontinuity"
        self._jerk = f"{prefix}_{part}acceleration_discontinuity"
        self._start_error = (
            "" if after_poses else "joint_position_motion_generator_start_pose_invalid"
        )
        self.q = q.copy()
        self.v = np.zeros(JOINTS_N) if v is None else v.copy()
        self.a = np.zeros(JOINTS_N)
        self._first = True

    def target(self, q: Array) -> list[str]:
        """Take the next target q (7,); return the errors."""
        if not np.isfinite(q).all():
            return [self._position]
        if self._first and self._start_error and np.abs(q - self.q).max() > START_RAD:
            return [self._start_error]
        return self._advance(q, (q - self.q) / DT_S)

    def velocity(self, v: Array) -> list[str]:
        """Take the next velocity v (7,); return the errors."""
        if not np.isfinite(v).all():
            return [self._velocity]
        return self._advance(self.q + v * DT_S, v)

    def extrapolate(self) -> None:
        """Move the target on without a command, at constant acceleration inside the velocities."""
        limits = self._limits
        v = np.clip(self.v + self.a * DT_S, limits.v_lower(self.q), limits.v_upper(self.q))
        self.q = np.clip(self.q + v * DT_S, limits.q_lower, limits.q_upper)
        self.v = v

    def _advance(self, q: Array, v: Array) -> list[str]:
        limits = self._limits
        a = (v - self.v) / DT_S
        jerk = (a - self.a) / DT_S
        errors: list[str] = []
        if (q < limits.q_lower).any() or (q > limits.q_upper).any():
            errors.append(self._position)
        above = v > limits.v_upper(self.q) + ROUNDING
        below = v < limits.v_lower(self.q) - ROUNDING
        if above.any() or below.any():
            errors.append(self._velocity)
        if (np.abs(a) > limits.a_max * NOISE).any():
            errors.append(self._acceleration)
        if (np.abs(jerk) > limits.jerk_max * NOISE).any():
            errors.append(self._jerk)
        if errors:
            return errors
        self._first = False
        self.q = q.copy()
        self.v = v
        self.a = a
        return errors


class TorqueCommands:
    """Checks torques that come one a millisecond; `tau` (7,) is the last one [Nm]."""

    def __init__(self, limits: FciLimits) -> None:
        self._limits = limits
        self.tau = np.zeros(JOINTS_N)

    def command(self, tau: Array, gravity: Array, v: Array) -> list[str]:
        """Take the next torques (7,), without the gravity that the controller adds; return errors."""
        limits = self._limits
        finite = bool(np.isfinite(tau).all())
        rate = np.abs(tau - self.tau) / DT_S if finite else limits.tau_rate_max * np.inf
        if (rate > limits.tau_rate_max * (1.0 + ROUNDING)).any():
            return ["controller_torque_discontinuity"]
        power_w = float(np.sum(np.abs((tau + gravity) * v)))
        if power_w > limits.power_max_w:
            return ["power_limit_violation"]
        self.tau = tau.copy()
        return []


@dataclass
class Thresholds:
    """Collision thresholds: torques (7,) [Nm] and wrench (6,) [N, Nm], contacts and collisions."""

    lower_torque: Array
    upper_torque: Array
    lower_force: Array
    upper_force: Array

    @classmethod
    def default(cls) -> "Thresholds":
        """Return the default thresholds of a controller."""
        return cls(
            np.full(JOINTS_N, 20.0), np.full(JOINTS_N, 20.0), np.full(6, 20.0), np.full(6, 20.0)
        )

    def valid(self) -> bool:
        """Return whether all are finite, and above 0."""
        rows = (self.lower_torque, self.upper_torque, self.lower_force, self.upper_force)
        return all(bool((np.isfinite(row) & (row > 0.0)).all()) for row in rows)

    def collisions(self, tau_ext: Array, wrench: Array) -> list[str]:
        """Return the errors of external torques (7,) and an external wrench (6,)."""
        errors: list[str] = []
        if (np.abs(tau_ext) > self.upper_torque).any():
            errors.append("joint_reflex")
        if (np.abs(wrench) > self.upper_force).any():
            errors.append("cartesian_reflex")
        return errors


@dataclass(frozen=True)
class MeasuredState:
    """Measurements of an arm that the controller checks.

    Attributes:
        q, v, tau: (7,) [rad], [rad/s], [Nm].
        speed_m_per_s: Of the hand.
        position_m: Of the hand in the base's frame (3,).
    """

    q: Array
    v: Array
    tau: Array
    speed_m_per_s: float
    position_m: Array


def measured_errors(
    state: MeasuredState,
    limits: FciLimits,
    walls: Sequence[tuple[float, float]] = (),
) -> list[str]:
    """Return the errors of a measurement.

    Args:
        state: Of the arm.
        limits: Of the arm.
        walls: Range of x, y and z of the hand in the base's frame [m]; none if empty.
    """
    errors: list[str] = []
    if (state.q < limits.q_lower - 0.01).any() or (state.q > limits.q_upper + 0.01).any():
        errors.append("joint_position_limits_violation")
    if (np.abs(state.v) > 1.05 * limits.v_max).any():
        errors.append("joint_velocity_violation")
    if state.speed_m_per_s > 1.05 * limits.linear[0]:
        errors.append("cartesian_velocity_violation")
    if (np.abs(state.tau) > limits.tau_range_nm * limits.tau_max).any():
        errors.append("tau_j_range_violation")
    outside = [
        not low <= x <= high for x, (low, high) in zip(state.position_m, walls, strict=False)
    ]
    if any(outside):
        errors.append("cartesian_position_limits_violation")
    return errors


class PacketWatch:
    """Counts commands that did not come in time.

    Attributes:
        lost: In a row.
    """

    def __init__(self) -> None:
        self._recent = [True] * 100
        self._next = 0
        self.lost = 0

    def tick(self, *, came: bool) -> list[str]:
        """Take one millisecond; return the error of too many lost commands."""
        self._recent[self._next] = came
        self._next = (self._next + 1) % len(self._recent)
        self.lost = 0 if came else self.lost + 1
        return ["communication_constraints_violation"] if self.lost >= LOST_PACKETS_MAX else []

    @property
    def success_rate(self) -> float:
        """Share of the last 100 commands that came in time."""
        return sum(self._recent) / len(self._recent)
