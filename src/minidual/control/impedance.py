"""Object impedance: the held object behaves like a damped spring; the squeeze (internal force) is servoed.

Law and sources: docs/force-control.md.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.config.control import ImpedanceConfig
from minidual.control.impedance_kernels import LAW, impedance
from minidual.control.joint_control import motor_torque
from minidual.control.kernels import approach
from minidual.errors import DataError, MinidualError
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import SIDES, Array

SQUEEZE_MAX_N = 80.0
"""Highest internal force."""
POSTURE_STIFFNESS_PER_S2 = 20.0
POSTURE_DAMPING_PER_S = 9.0
"""Of the null space: keeps the elbows in place."""
_BENT = "keep the elbows bent: a stretched arm cannot carry"


class SingularPostureError(MinidualError):
    """A stretched arm's hand cannot accelerate in every direction."""


STILL: Array = np.zeros(6)
STILL.setflags(write=False)


class ObjectState(NamedTuple):
    """Object pose (4, 4), twist (6,) and acceleration (6,) at its centre of mass, world axes."""

    T_world_object: Array
    twist: Array = STILL
    acceleration: Array = STILL

    def copied(self) -> "ObjectState":
        """Return it with arrays of its own: who made it may use the same ones again."""
        return tuple.__new__(ObjectState, (self[0].copy(), self[1].copy(), self[2].copy()))


@dataclass(frozen=True)
class HeldObject:
    """Object data.

    Attributes:
        inertia_kg_m2: (3, 3) about the centre of mass, object axes.
        T_object_tcps: Left, right.
        axis: (3,) unit vector, object axes, from right to left hand.
    """

    mass_kg: float
    inertia_kg_m2: Array
    T_object_tcps: tuple[Array, Array]
    axis: Array


def lost_direction(arm: int) -> SingularPostureError:
    """Return the error of a stretched arm."""
    text = f"the {SIDES[arm]} hand has lost a direction of motion: J J^T is singular"
    return SingularPostureError(text, remedy=_BENT)


def inertia_at_hand(M: Array, J: Array, arm: int) -> Array:
    """Return (J M^-1 J^T)^-1 (k, k) for an arm's M (n, n) and J (k, n), or raise SingularPostureError."""
    try:
        return np.array(np.linalg.inv(J @ np.linalg.solve(M, J.T)), dtype=float)
    except np.linalg.LinAlgError as error:
        raise lost_direction(arm) from error


class ObjectImpedance:
    """The law for one object and grasp."""

    def __init__(self, kinematics: Kinematics, held: HeldObject, gains: ImpedanceConfig) -> None:
        self._kinematics = kinematics
        self.held = held
        self.gains = gains
        K = np.repeat([gains.stiffness_n_per_m, gains.stiffness_nm_per_rad], 3)
        posture = POSTURE_STIFFNESS_PER_S2, POSTURE_DAMPING_PER_S
        R_tcps_object = [T[:3, :3].T for T in held.T_object_tcps]
        servo = gains.force_gain, gains.force_correction_max_n, SQUEEZE_MAX_N
        data = (
            K,
            np.zeros(6),
            held.mass_kg,
            *posture,
            *servo,
            held.inertia_kg_m2,
            held.axis,
            R_tcps_object,
        )
        self._law = np.array([data], LAW)
        self._by_world = gains.squeeze_axes == "world"
        self._posture = kinematics.robot.home
        self._world_axis = np.zeros(3)
        self._hands = Hands(kinematics)
        self._work = np.zeros((19, max(6, kinematics.robot.dof_most)))
        self._qdd, self.push = np.zeros((2, kinematics.robot.dof))
        """push: (n,) [Nm], last J^T f."""

    def engage(self, q: Array) -> None:
        """Set damping and null-space posture from q (n,).

        Raises:
            SingularPostureError: A hand lost a direction of motion.
        """
        M = self._kinematics.mass_matrix(q)
        moving = np.r_[np.full(3, self.held.mass_kg), np.diag(self.held.inertia_kg_m2)]
        lever = max(float(np.linalg.norm(T[:3, 3])) for T in self.held.T_object_tcps)
        for index, J in enumerate(self._kinematics.tcp_jacobians(q)):
            arm = self._kinematics.robot.joints_of(index)
            mass, inertia = (
                np.diag(inertia_at_hand(M[arm, arm], part, index))
                for part in (J[:3, arm], J[3:, arm])
            )
            moving[:3] += mass
            moving[3:] += lever**2 * float(np.mean(mass)) + inertia
        left, right = self._kinematics.tcp_poses(q)
        self._world_axis = (left - right)[:3, 3] / np.linalg.norm((left - right)[:3, 3])
        self._posture = np.array(q, dtype=float)
        self._law["D"] = 2.0 * self.gains.damping_ratio * np.sqrt(self._law["K"] * moving)

    def torque(
        self,
        q: Array,
        v: Array,
        measured: ObjectState,
        desired: ObjectState,
        *,
        wanted_n: float,
        felt_n: float,
    ) -> Array:
        """Return motor torques (n,) [Nm], clipped to the limits.

        `wanted_n`, `felt_n`: internal force; it must be felt at the contacts, never computed from the hands' distance.

        Raises:
            SingularPostureError: A hand lost a direction of motion.
            DataError: The object's measurement is not finite.
        """
        hands = self._hands
        hands.update(q)
        if self._by_world:
            self._law["axis"] = measured.T_world_object[:3, :3].T @ self._world_axis
        sound = impedance(
            *(self._law, measured.T_world_object, measured.twist),
            *(desired.T_world_object, desired.twist, desired.acceleration, wanted_n, felt_n),
            *(hands.views, self._posture, q, v, self._qdd, self.push, self._work),
        )
        if not sound and np.isfinite(q + v).all():  # of joints, the supervisor says what is wrong
            raise self._unsound(measured, felt_n)
        return motor_torque(self._kinematics, q, v, self._qdd, self.push)

    @staticmethod
    def _unsound(measured: ObjectState, felt_n: float) -> MinidualError:
        """Return why the law gave no torque."""
        values = {
            "pose": measured.T_world_object,
            "twist": measured.twist,
            "internal force": np.array(felt_n),
        }
        missing = [name for name, value in values.items() if not np.isfinite(value).all()]
        if missing:
            text = f"the object's {' and '.join(missing)} is not finite"
            return DataError(text, remedy="look at what measures it")
        text = "a hand has lost a direction of motion: J J^T is singular"
        return SingularPostureError(text, remedy=_BENT)


def towards(T: Array, sample: Array, gain: float) -> tuple[Array, tuple[float, float]]:
    """Return T moved towards the sample, and their innovation."""
    moved = np.empty((4, 4))
    innovation = approach(T, sample, gain, moved)
    return moved, innovation
