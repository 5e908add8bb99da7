"""Object impedance: the held object behaves like a damped spring; the squeeze (internal force) is servoed.

Hand impedance: one hand along a joint reference is a damped spring of bounded force.

Laws and sources: docs/force-control.md. Object paths are straight minimum-jerk segments between level poses.

The object's pose is estimated from delayed, noisy samples and the joint encoders. At rest it is the mean of all samples.
When held, its pose X in a frame H of the hands is estimated: origin midway between the tool centre points, y from right
to left, x along the mean finger direction. Samples z correct X:

    X <- X + g (T_H(t - delay)^-1 z - X),  g = max(1 / n, sample period / memory)
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.config.control import ImpedanceConfig
from minidual.control.joint_control import ComputedTorque, motor_torque
from minidual.control.kernels import (
    HAND_LAW,
    LAW,
    approach,
    follow,
    from_hand,
    hand_impedance,
    impedance,
    on_path,
)
from minidual.errors import DataError, MinidualError
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import SIDES, Array, inverse

SQUEEZE_MAX_N = 80.0
"""Highest internal force."""
POSTURE_STIFFNESS_PER_S2 = 20.0
POSTURE_DAMPING_PER_S = 9.0
"""Of the null space: keeps the elbows in place."""
_BENT = "keep the elbows bent: a stretched arm cannot carry"


class SingularPostureError(MinidualError):
    """A stretched arm's hand cannot accelerate in every direction."""


_STILL: Array = np.zeros(6)
_STILL.setflags(write=False)


class ObjectState(NamedTuple):
    """Object pose (4, 4), twist (6,) and acceleration (6,) at its centre of mass, world axes."""

    T_world_object: Array
    twist: Array = _STILL
    acceleration: Array = _STILL

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
        self._work = np.zeros((19, max(6, kinematics.robot.dof_per_arm)))
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


STIFFNESS_N_PER_M = 2000.0
STIFFNESS_NM_PER_RAD = 100.0
DAMPING_RATIO = 1.0
FORCE_MAX_N = 10.0
MOMENT_MAX_NM = 1.2
"""Bounds of the spring along and about each axis: beyond the dry friction of a joint."""
_LEARNING_PER_S = 4.0
_ELBOW_STIFFNESS_PER_S2 = 100.0
_ELBOW_DAMPING_PER_S = 20.0
"""Of one hand's null space: dry friction of 0.5 Nm holds an elbow off by 0.03 to 0.04 rad (0.1 with 20 and 9)."""
_HEAVIEST = 20.0
"""Largest inertia [kg, kg m^2] of a hand that damping is made for: near a singularity it is hundreds, and soon past."""
_AT_TCP = np.eye(4)
_AT_TCP.setflags(write=False)


class InHand(NamedTuple):
    """What a hand holds.

    Attributes:
        name: Of the object; empty for nothing.
        T_tcp_object: (4, 4).
        T_tcp_planned: The same in the plan that gave the joint reference.
        centre_m: (3,) centre of compliance, object axes.
    """

    name: str = ""
    T_tcp_object: Array = _AT_TCP
    T_tcp_planned: Array = _AT_TCP
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class HandImpedance(ComputedTorque):
    """The law of one hand."""

    def __init__(self, kinematics: Kinematics, arm: int, dt_s: float) -> None:
        super().__init__(kinematics)
        self._arm = arm
        self._joints = kinematics.robot.joints_of(arm)
        self._hands = Hands(kinematics)
        self.held = InHand()
        self._held = InHand()
        self.other: InHand | None = None
        """What the other hand holds, if the reference moves with it; both from the next engagement on."""
        self._other = self.other
        K, most = np.repeat(
            [[STIFFNESS_N_PER_M, STIFFNESS_NM_PER_RAD], [FORCE_MAX_N, MOMENT_MAX_NM]],
            3,
            axis=1,
        )
        posture = _ELBOW_STIFFNESS_PER_S2, _ELBOW_DAMPING_PER_S
        own = K, most, np.zeros((6, 6)), np.zeros(3), _AT_TCP, _LEARNING_PER_S * dt_s, *posture
        self._law = np.array([own], HAND_LAW)
        self._learnt = np.zeros(6)

    def engage(self, q: Array) -> None:
        """Set the damping from q (n,), and forget what was learnt."""
        held = self._held = self.held
        self._other = self.other
        self._learnt = np.zeros(6)
        T, J = self._placed(q)
        M = self._kinematics.mass_matrix(q)[self._joints, self._joints]
        axes = np.kron(np.eye(2), T[:3, :3])
        squares, modes = np.linalg.eigh(axes.T @ inertia_at_hand(M, J, self._arm) @ axes)
        half = (
            (modes * np.sqrt(np.minimum(squares, _HEAVIEST))) @ modes.T * np.sqrt(self._law["K"][0])
        )
        self._law["D"], self._law["centre"] = DAMPING_RATIO * (half + half.T), held.centre_m
        self._law["T_tcp_object"] = held.T_tcp_object

    def torque(
        self,
        q: Array,
        v: Array,
        q_ref: Array,
        v_ref: Array,
        a_ref: Array,
        load: Array | None = None,
    ) -> Array:
        """See `ComputedTorque`; of its own arm, or raise SingularPostureError."""
        T_ref = self._wanted(q, q_ref)
        qdd = a_ref.copy()
        push = np.zeros(len(q)) if load is None else load.copy()
        of_hand = self._law, self._hands.views, self._arm, T_ref
        if not hand_impedance(*of_hand, q, v, q_ref, v_ref, self._learnt, qdd, push):
            raise lost_direction(self._arm)
        return motor_torque(self._kinematics, q, v, qdd, push)

    def _wanted(self, q: Array, q_ref: Array) -> Array:
        """Return the object's pose (4, 4) that the reference asks for, and update the hands."""
        hands = self._hands
        away = 1 - self._arm
        T = np.empty((4, 4))
        T_away = np.empty((4, 4))
        hands.place(q_ref)
        from_hand(hands.views, self._arm, self._held.T_tcp_planned, _AT_TCP, False, T)
        if self._other is not None:
            from_hand(hands.views, away, self._other.T_tcp_planned, T, True, T_away)
        hands.update(q)
        if self._other is not None:
            from_hand(hands.views, away, self._other.T_tcp_object, T_away, False, T)
        return T

    def _placed(self, q: Array) -> tuple[Array, Array]:
        """Return the object's pose (4, 4) and the Jacobian (6, n) at the centre of compliance."""
        J = self._kinematics.tcp_jacobians(q)[self._arm][:, self._joints].copy()
        T_tcp = self._kinematics.data.oMf[self._kinematics.tcp_ids[self._arm]].homogeneous
        T = T_tcp @ self._held.T_tcp_object
        x, y, z = T[:3, 3] + T[:3, :3] @ self._held.centre_m - T_tcp[:3, 3]
        J[:3] -= np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ J[3:]
        return T, J


_LEVEL = np.eye(4)


@dataclass(frozen=True)
class Waypoint:
    """Level object pose and the time to reach it from the previous one."""

    xyz_m: tuple[float, float, float]
    yaw_rad: float
    duration_s: float


class ObjectPath:
    """Rest-to-rest object motion through level poses (start's duration unused)."""

    def __init__(self, start: Waypoint, waypoints: Sequence[Waypoint]) -> None:
        self._poses = np.array([(*w.xyz_m, w.yaw_rad) for w in (start, *waypoints)])
        self._ends_s = np.cumsum([0.0, *(w.duration_s for w in waypoints)])

    @property
    def duration_s(self) -> float:
        """Total time [s]."""
        return float(self._ends_s[-1])

    def onward(self, by_m: Array, duration_s: float) -> "ObjectPath":
        """Return a path by_m (3,) from the end of this one."""
        x, y, z, yaw = self._poses[-1].tolist()
        onward = tuple((self._poses[-1, :3] + by_m).tolist())
        return ObjectPath(Waypoint((x, y, z), yaw, 0.0), [Waypoint(onward, yaw, duration_s)])

    def at(self, t_s: float, T_level_object: Array = _LEVEL) -> ObjectState:
        """Return the state at a path time of an object that lies at T_level_object (4, 4) in the level frame."""
        T = np.empty((4, 4))
        motion = np.zeros((2, 6))
        on_path(self._poses, self._ends_s, t_s, T_level_object, T, motion)
        return tuple.__new__(ObjectState, (T, motion[0], motion[1]))


class RestingEstimate:
    """Mean pose of a resting object.

    Attributes:
        innovation: (distance [m], angle [rad]) of the last sample from the previous mean.
    """

    def __init__(self, T_world_object: Array) -> None:
        self.T_world_object = T_world_object.copy()
        self.samples_n = 1
        self.innovation = (0.0, 0.0)

    def add(self, T_world_object: Array, least_gain: float = 0.0) -> None:
        """Add a sample (4, 4) to the mean, which a least gain makes forget."""
        self.samples_n += 1
        gain = max(1.0 / self.samples_n, least_gain)
        self.T_world_object, self.innovation = towards(self.T_world_object, T_world_object, gain)


_ODD_M = 0.03  # one frame off by more says nothing of the object: a marker was taken for another
_ODD_RAD = 0.2


class HeldEstimate:
    """Pose and twist of an object in both hands.

    Args:
        q: Joints (n,) after closing.
        T_world_object: Pose (4, 4), weighted as five samples.
        delay_ticks: Largest sample age.
        least_gain: Smallest g.

    Attributes:
        innovation: (distance [m], angle [rad]) of the last sample.
        spread_m: Distance between the hands.
        moved_m: Distance that they moved between the last two samples.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        q: Array,
        T_world_object: Array,
        *,
        delay_ticks: int,
        least_gain: float,
    ) -> None:
        self._hands = Hands(kinematics)
        self._least_gain = least_gain
        self._samples_n = 5
        self._history: deque[Array] = deque(maxlen=delay_ticks + 1)
        self.innovation = (0.0, 0.0)
        self._odd = False
        self.spread_m = self.moved_m = 0.0
        self._T_hands_object = np.eye(4)
        T_world_hands = self._follow(q, np.zeros_like(q))[0]
        self._T_hands_object = inverse(T_world_hands) @ T_world_object
        self._sampled_m = T_world_hands[:3, 3]
        self.state = ObjectState(T_world_object)

    def update(
        self,
        q: Array,
        v: Array,
        sample: Array | None = None,
        age_ticks: int = 0,
    ) -> ObjectState:
        """Return the object's state at joints q, v (n,).

        Samples (4, 4) older than `delay_ticks` are ignored, and a single one that is far off.
        """
        T_world_hands, T, twist = self._follow(q, v)
        self._history.append(T_world_hands)
        if sample is not None and age_ticks < len(self._history):
            self._samples_n += 1
            gain = max(1.0 / self._samples_n, self._least_gain)
            T_then = self._history[-1 - age_ticks]
            way_m = T_then[:3, 3] - self._sampled_m
            self._sampled_m = T_then[:3, 3]
            self.moved_m = math.sqrt(way_m @ way_m)
            moved, self.innovation = towards(self._T_hands_object, inverse(T_then) @ sample, gain)
            before = self._odd
            self._odd = self.innovation[0] > _ODD_M or self.innovation[1] > _ODD_RAD
            if before or not self._odd:
                self._T_hands_object = moved
            T, twist = self._follow(q, v)[1:]
        self.state = tuple.__new__(
            ObjectState,
            (T, twist, _STILL),
        )  # ObjectState(...) takes three times as long
        return self.state

    def _follow(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return T_world_hands (4, 4), and pose (4, 4) and twist (6,) of the object; set `spread_m`."""
        hands = self._hands
        hands.update(q)
        T_hands = np.empty((4, 4))
        T = np.empty((4, 4))
        twist = np.empty(6)
        self.spread_m = follow(hands.views, v, self._T_hands_object, T_hands, T, twist)
        return T_hands, T, twist


def towards(T: Array, sample: Array, gain: float) -> tuple[Array, tuple[float, float]]:
    """Return T moved towards the sample, and their innovation."""
    moved = np.empty((4, 4))
    innovation = approach(T, sample, gain, moved)
    return moved, innovation
