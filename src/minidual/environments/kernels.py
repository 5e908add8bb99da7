"""Compiled parts of batched worlds: hands, inverse kinematics, joint control and strain of N worlds.

They call the kernels of one world, so that both follow one law. numba's cache watches this file
alone; after a change of a kernel that is called here delete the `__pycache__` folders.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from minidual.control.gripper import advance
from minidual.control.kernels import add_loads, follow_target, servo
from minidual.motion.ik_descent import chain, descend, rest
from minidual.robot import vectors
from minidual.robot.compiled import kernel
from minidual.robot.pair import Array, Indices

_DESCENT_STEPS = 8
_DESCENT_TOLERANCE = 1e-4
_DAMPING = 1e-3
"""Of the map from joint torques to a hand's wrench, as in `control.kernels.hand_look`."""
_solve_gram = njit(vectors.solve_gram)


class State(NamedTuple):
    """Memory of a batch, a row a world.

    Attributes:
        qpos, qvel, ctrl: State and commands.
        M: Inertia, stored as MuJoCo stores it.
        bias: Coriolis, centrifugal and gravity torques.
        force: Of the actuators.
        constraint: Generalised forces of contacts, limits and dry friction.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    M: Array
    bias: Array
    force: Array
    constraint: Array


class Addresses(NamedTuple):
    """Where the arms and fingers stand in the memory of a batch.

    Attributes:
        q, v, motor: (n,) of the arms' joints.
        finger, finger_motor: (4,).
        row_n, row_start, column: Layout of M.
    """

    q: Indices
    v: Indices
    motor: Indices
    finger: Indices
    finger_motor: Indices
    row_n: npt.NDArray[np.int32]
    row_start: npt.NDArray[np.int32]
    column: npt.NDArray[np.int32]


class Driven(NamedTuple):
    """Targets and memory of the control law.

    Attributes:
        target: Joint targets (N, n) [rad].
        opening: Of both hands (N, 2), 0 closed to 1 open.
        reference: (N, 6, n), see `control.kernels.follow_target`.
        hands: (N, 4, 2), see `control.gripper.advance`.
    """

    target: Array
    opening: Array
    reference: Array
    hands: Array


class Law(NamedTuple):
    """Constants of the control law.

    Attributes:
        bounds: (5, n), see `control.kernels.follow_target`.
        tau_max: (n,) [Nm].
        gripper: (3,), see `control.gripper.advance`.
        dt_s, ramp_s: Control step, and the time over which a changed target is approached.
        reference_rad_s, servo_rad_s: Bandwidths.
        damping, dry: Friction of the joints.
        pinch_n: Grip force of a closed hand.
    """

    bounds: Array
    tau_max: Array
    gripper: Array
    dt_s: float
    ramp_s: float
    reference_rad_s: float
    servo_rad_s: float
    damping: float
    dry: float
    pinch_n: float


@kernel(heap=True)
def drive(state: State, at: Addresses, driven: Driven, law: Law) -> None:
    """Write the commands of one control step, as `JointLoop` does for one world."""
    n = len(at.q)
    q = np.empty(n)
    v = np.empty(n)
    a = np.empty(n)
    tau = np.empty(n)
    load = np.zeros(n)
    grip_n = np.empty(2)
    fingers_m = np.empty(2)
    opening = np.empty(2)
    a_all = np.zeros(state.qvel.shape[1])
    tau_all = np.empty(state.qvel.shape[1])
    for i in range(len(driven.target)):
        for j in range(n):
            q[j] = state.qpos[i, at.q[j]]
            v[j] = state.qvel[i, at.v[j]]
        reference = driven.reference[i]
        follow_target(
            driven.target[i], reference, law.bounds, law.reference_rad_s, law.dt_s, law.ramp_s
        )
        servo(q, v, reference[0], reference[1], reference[2], law.servo_rad_s, a)
        for j in range(n):
            a_all[at.v[j]] = a[j]
        for row in range(len(tau_all)):
            tau_all[row] = state.bias[i, row]
        for row in range(len(tau_all)):  # M is symmetric: its lower half is stored
            for k in range(at.row_start[row], at.row_start[row] + at.row_n[row]):
                column = at.column[k]
                tau_all[row] += state.M[i, k] * a_all[column]
                if column != row:
                    tau_all[column] += state.M[i, k] * a_all[row]
        for j in range(n):
            tau[j] = tau_all[at.v[j]]
        add_loads(tau, load, v, law.damping, law.dry, law.tau_max)
        for j in range(n):
            state.ctrl[i, at.motor[j]] = tau[j]
        for hand in range(2):
            first = 2 * hand
            second = first + 1
            force = state.force[i, at.finger_motor[first]] + state.force[i, at.finger_motor[second]]
            place = state.qpos[i, at.finger[first]] + state.qpos[i, at.finger[second]]
            grip_n[hand] = -0.5 * force
            fingers_m[hand] = 0.5 * place
            opening[hand] = driven.opening[i, hand]
        advance(opening, grip_n, fingers_m, driven.hands[i], law.pinch_n, law.gripper)
        for finger in range(4):
            state.ctrl[i, at.finger_motor[finger]] = driven.hands[i, 1, finger // 2]


@kernel(heap=True)
def place_hands(frames: Array, q: Array, Ts: Array) -> None:
    """Fill the tcp poses Ts (N, 2, 4, 4) at q (N, n); frames (2, n / 2 + 1, 4, 4)."""
    per_arm = q.shape[1] // 2
    axes = np.empty((per_arm, 6))
    T = np.empty((3, 4))
    for i in range(len(q)):
        for hand in range(2):
            chain(frames[hand], q[i, per_arm * hand : per_arm * (hand + 1)], T, axes)
            Ts[i, hand, :3] = T
            Ts[i, hand, 3] = 0.0
            Ts[i, hand, 3, 3] = 1.0


class Rest(NamedTuple):
    """What redundant joints prefer: frames, home posture (2, n / 2) and limits (2, 2, n / 2)."""

    frames: Array
    posture: Array
    limits: Array


@kernel(heap=True)
def reach(arms: Rest, Ts: Array, q: Array) -> None:
    """Move q (N, n) to the tcp poses Ts (N, 2, 4, 4), as near to the home posture as they allow."""
    per_arm = q.shape[1] // 2
    mobility = np.ones(per_arm)
    posture = np.empty(per_arm)
    limits = np.empty((2, per_arm))
    own = np.empty(per_arm)
    T = np.empty((4, 4))
    for i in range(len(q)):
        for hand in range(2):
            first = per_arm * hand
            own[:] = q[i, first : first + per_arm]
            posture[:] = arms.posture[hand]
            limits[:] = arms.limits[hand]
            T[:] = Ts[i, hand]
            rest(arms.frames[hand], T, own, posture, mobility, limits)
            descend(arms.frames[hand], T, own, limits, _DESCENT_STEPS, _DESCENT_TOLERANCE)
            q[i, first : first + per_arm] = own


@kernel(heap=True)
def wrenches(frames: Array, q: Array, torque: Array, out: Array) -> None:
    """Fill `out` (N, 2, 6) with (J J^T + 1e-3)^-1 J torque of each hand, [force; moment], world axes.

    torque (N, n) [Nm] is what contacts ask of the joints.
    """
    per_arm = q.shape[1] // 2
    axes = np.empty((per_arm, 6))
    T = np.empty((3, 4))
    J = np.empty((6, per_arm))
    y = np.empty(6)
    for i in range(len(q)):
        for hand in range(2):
            first = per_arm * hand
            chain(frames[hand], q[i, first : first + per_arm], T, axes)
            y[:] = 0.0
            for j in range(per_arm):
                x = T[0, 3] - axes[j, 3]
                lever_y = T[1, 3] - axes[j, 4]
                z = T[2, 3] - axes[j, 5]
                J[0, j] = axes[j, 1] * z - axes[j, 2] * lever_y
                J[1, j] = axes[j, 2] * x - axes[j, 0] * z
                J[2, j] = axes[j, 0] * lever_y - axes[j, 1] * x
                for k in range(3):
                    J[3 + k, j] = axes[j, k]
                for k in range(6):
                    y[k] += J[k, j] * torque[i, first + j]
            _solve_gram(J, y, _DAMPING, np.empty((6, 6)))
            out[i, hand] = y


class Bounds(NamedTuple):
    """Bounds of the supervisor, free and with closed hands; see `control.observer.CONTACT_MODES`.

    Attributes:
        torque: (2, n) [Nm].
        deviation: (2,) [rad].
        share: Gain of the torques' filter, a step.
        travel_m: Place of the fingers of an open hand.
    """

    torque: Array
    deviation: Array
    share: float
    travel_m: float


# Columns of `strain`.
TORQUE_SHARE = 0
"""Largest unexplained torque in relation to its bound, since the column was zeroed."""
LATE_STEPS = 1
"""For how many steps a joint has been further from its reference than it may."""
CLOSED = 2
"""Whether a hand is not wide open."""
STRAIN_N = 3


@kernel(heap=True)
def feel(
    state: State, at: Addresses, driven: Driven, bounds: Bounds, external: Array, strain: Array
) -> None:
    """Filter the external torques (N, n) [Nm] after a physics step and update `strain` (N, 3)."""
    for i in range(len(external)):
        mode = 0
        for hand in range(2):
            is_open = driven.hands[i, 0, hand] == 1.0
            if not is_open or driven.hands[i, 1, hand] < bounds.travel_m:
                mode = 1
        late = False
        share = strain[i, TORQUE_SHARE]
        for j in range(len(at.v)):
            felt = state.constraint[i, at.v[j]]
            external[i, j] += bounds.share * (felt - external[i, j])
            share = max(share, abs(external[i, j]) / bounds.torque[mode, j])
            away = abs(state.qpos[i, at.q[j]] - driven.reference[i, 0, j])
            late = late or away > bounds.deviation[mode]
        strain[i, TORQUE_SHARE] = share if math.isfinite(share) else math.inf
        strain[i, LATE_STEPS] = strain[i, LATE_STEPS] + 1.0 if late else 0.0
        strain[i, CLOSED] = mode
