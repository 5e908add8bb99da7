"""Compiled parts of the control laws.

Vectors of three are tuples, which numba keeps in registers: arrays cost the object impedance four times as much.
Import late: it imports numba.
"""

import math
from typing import Any

import numpy as np
from numba import from_dtype, njit
from numba.core import types

from minidual.robot import vectors
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.pair import Array

_REAL = types.float64
_TURNED = types.float64[::1, :]  # Pinocchio's matrices are column-major
_POSE = types.Array(_REAL, 2, "A", readonly=True)
_HANDS = types.Tuple([_TURNED, VECTOR, VECTOR, _TURNED, _TURNED])

LAW = np.dtype(  # one argument instead of eight saves 0.5 us a call
    [
        *((name, "f8", 6) for name in ("K", "D")),
        *((name, "f8") for name in ("mass", "posture_stiffness", "posture_damping")),
        *((name, "f8") for name in ("force_gain", "force_limit", "force_max")),
        *(("inertia", "f8", (3, 3)), ("axis", "f8", 3), ("R_tcps_object", "f8", (2, 3, 3))),
    ],
)
"""What `impedance` knows before the first step."""
HAND_LAW = np.dtype(
    [
        *((name, "f8", 6) for name in ("K", "most")),
        *(
            ("D", "f8", (6, 6)),
            ("centre", "f8", 3),
            ("T_tcp_object", "f8", (4, 4)),
            ("learning", "f8"),
        ),
        *(("posture_stiffness", "f8"), ("posture_damping", "f8")),
    ],
)
"""What `hand_impedance` knows."""

Vector = tuple[float, float, float]
Elements = Any
"""A vector of three, as a tuple or an array."""
Placed = tuple[Array, Array, Array, Array, Array]
"""See `Hands.views`."""
_shared = vectors.cross, vectors.plus, vectors.minus, vectors.times, vectors.inner, vectors.larger
_algebra: Any = map(njit, (*_shared, vectors.solve_gram, vectors.rotation_vector))
cross, plus, minus, times, inner, larger, solve_gram, rotation_vector = _algebra


@njit
def within(x: float, low: float, high: float) -> float:
    """Return x clipped; NaN stays NaN."""
    if x > high:
        return high
    if x < low:
        return low
    return x


@njit
def three(a: Elements, i: int) -> Vector:
    """Return a[i : i + 3]."""
    return a[i], a[i + 1], a[i + 2]


@njit
def apply(A: Array, x: Elements) -> Vector:
    """Return A x."""
    return inner(A[0], x), inner(A[1], x), inner(A[2], x)


@njit
def add_product(y: Array, sign: float, A: Array, x: Array) -> None:
    """Add sign A x to y, term by term."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            y[i] += sign * A[i, j] * x[j]


@njit
def turn(wanted: Array, actual: Array) -> tuple[Vector, float]:
    """Return log(wanted actual^T) [rad] and its angle."""
    return rotation_vector(
        apply(actual, wanted[0]),
        apply(actual, wanted[1]),
        apply(actual, wanted[2]),
    )


@kernel(types.UniTuple(_REAL, 2)(_POSE, _POSE, VECTOR))
def apart(T: Array, T_other: Array, way: Array) -> tuple[float, float]:
    """Fill `way` (6,) with the motion from T_other to T, world axes; return its distance [m] and angle [rad]."""
    moved = minus(three(T[:, 3], 0), three(T_other[:, 3], 0))
    turned, angle = turn(T, T_other)
    way[:3] = moved
    way[3:] = turned
    return math.sqrt(inner(moved, moved)), angle


@kernel(types.UniTuple(_REAL, 2)(_POSE, _POSE, _REAL, ROWS))
def approach(T: Array, goal: Array, share: float, moved: Array) -> tuple[float, float]:
    """Fill `moved` (4, 4) with T moved by a share of the way to a goal; return that way's distance [m] and angle [rad]."""
    p = three(T[:, 3], 0)
    turned, angle = turn(goal, T)
    way = minus(three(goal[:, 3], 0), p)
    axis = times(share, turned)
    square = inner(axis, axis)
    size = math.sqrt(square)
    sine = 1.0
    cosine = 0.5
    if size > 1e-6:
        sine = math.sin(size) / size
        cosine = (1.0 - math.cos(size)) / square
    for k in range(3):  # Rodrigues
        across = cross(axis, three(T[:, k], 0))
        moved[:3, k] = plus(
            three(T[:, k], 0),
            plus(times(sine, across), times(cosine, cross(axis, across))),
        )
        moved[3, k] = T[3, k]
    moved[:3, 3] = plus(p, times(share, way))
    moved[3, 3] = T[3, 3]
    return math.sqrt(inner(way, way)), angle


@njit
def hand_wrenches(
    force: Vector,
    moment: Vector,
    r_left: Vector,
    r_right: Vector,
    squeeze: Vector,
) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]]:
    """Return G^+ w + (I - G^+ G) [-squeeze; 0; squeeze; 0] as (force, moment) of each hand (docs/force-control.md)."""
    m = times(0.5, plus(r_left, r_right))
    h = times(0.5, minus(r_left, r_right))
    n = plus(moment, plus(cross(force, m), times(2.0, cross(h, squeeze))))
    share = times(0.5 / (1.0 + inner(h, h)), plus(n, times(inner(h, n), h)))
    press = minus(cross(share, h), squeeze)
    half = times(0.5, force)
    return (plus(half, press), share), (minus(half, press), share)


@njit
def hand_motion(J: Array, p: Elements, v: Array, J_hand: Array) -> tuple[Vector, Vector]:
    """Fill J_hand (6, n), [linear; angular] at p, and return Jdot v (linear, angular).

    J (6, n) is of the points at the world's origin; each column turns with the joints before it.
    """
    V = omega = a = alpha = (0.0, 0.0, 0.0)
    for j in range(len(v)):
        linear = three(J[:, j], 0)
        angular = three(J[:, j], 3)
        V = plus(V, times(v[j], linear))
        omega = plus(omega, times(v[j], angular))
        a = plus(a, times(v[j], plus(cross(omega, linear), cross(V, angular))))
        alpha = plus(alpha, times(v[j], cross(omega, angular)))
        J_hand[:3, j] = plus(linear, cross(angular, p))
        J_hand[3:, j] = angular
    return plus(plus(a, cross(alpha, p)), cross(omega, plus(V, cross(omega, p)))), alpha


@njit
def least_norm(J: Array, y: Array, x: Array, L: Array) -> bool:
    """Add J^T (J J^T)^-1 y to x, J (6, n), and overwrite y and L (6, 6); return False if J lost a rank."""
    if not solve_gram(J, y, 0.0, L):
        return False
    for i in range(5, -1, -1):
        for k in range(J.shape[1]):
            x[k] += J[i, k] * y[i]
    return True


@kernel(types.void(_HANDS, VECTOR, VECTOR, _REAL, ROWS), heap=True)
def hand_look(hands: Placed, v: Array, torque: Array, ahead_s: float, out: Array) -> None:
    """Fill `out` (2, 5): each hand's force |(J J^T + 1e-3)^-1 J torque| [N], speed [m/s], and place [m] in `ahead_s`."""
    J, p_left, p_right, _, _ = hands
    n = len(v) // 2
    J_hand = np.empty((6, n))
    y = np.empty(6)
    velocity = np.empty(3)
    for i, p in enumerate((three(p_left, 0), three(p_right, 0))):
        own = slice(n * i, n * i + n)
        hand_motion(J[:, own], p, v[own], J_hand)
        y[:] = 0.0
        velocity[:] = 0.0
        add_product(y, 1.0, J_hand, torque[own])
        solve_gram(J_hand, y, 1e-3, np.empty((6, 6)))
        add_product(velocity, 1.0, J_hand[:3], v[own])
        out[i, 0] = math.sqrt(inner(y, y))
        out[i, 1] = math.sqrt(inner(velocity, velocity))
        out[i, 2:] = plus(p, times(ahead_s, velocity))


@kernel(
    types.boolean(
        *(types.Array(from_dtype(LAW), 1, "C"), ROWS, VIEW, ROWS, VIEW, VIEW, _REAL, _REAL),
        *(_HANDS, VIEW, VIEW, VECTOR, VECTOR, VECTOR, ROWS),
    ),
)
def impedance(
    law: Array,
    T: Array,
    twist: Array,
    T_d: Array,
    twist_d: Array,
    a_d: Array,
    wanted_n: float,
    felt_n: float,
    hands: Placed,
    posture: Array,
    q: Array,
    v: Array,
    qdd: Array,
    push: Array,
    work: Array,
) -> bool:
    """Fill qdd (n,) and push (n,) = J^T f; see docs/force-control.md.

    law: (1,) of LAW. work: (19, n / 2, at least 6), overwritten: to make arrays takes a quarter of the law's time. Return
    False if a hand has lost a direction of motion, or something is not finite.
    """
    J, p_left, p_right, R_left, R_right = hands
    s = law[0]
    K = s.K
    D = s.D
    n = len(v) // 2
    J_hand = work[:6, : len(v) // 2]
    L = work[6:12, :6]
    R = work[12:15, :3]
    lacking = work[15, :6]
    wrench = work[16, :6]
    slow = work[17, :3]
    force = work[18, :3]
    for k in range(3):
        force[k] = K[k] * (T_d[k, 3] - T[k, 3]) + D[k] * (twist_d[k] - twist[k]) + s.mass * a_d[k]
    force[2] += 9.81 * s.mass
    a = three(a_d, 0)
    alpha = three(a_d, 3)
    omega = three(twist_d, 3)
    I_alpha = apply(T, apply(s.inertia, apply(T.T, alpha)))  # I_w = R I_o R^T
    I_omega = apply(T, apply(s.inertia, apply(T.T, omega)))
    moment = plus(I_alpha, cross(omega, I_omega))
    p = three(T[:, 3], 0)
    p_hands = (three(p_left, 0), three(p_right, 0))
    r = (minus(p_left, p), minus(p_right, p))
    correction = within(s.force_gain * (wanted_n - felt_n), -s.force_limit, s.force_limit)
    squeeze_n = within(wanted_n + correction, 0.0, s.force_max)
    f = hand_wrenches(three(force, 0), moment, r[0], r[1], times(squeeze_n, apply(T, s.axis)))
    for i, R_hand in enumerate((R_left, R_right)):
        own = slice(n * i, n * i + n)
        drift = hand_motion(J[:, own], p_hands[i], v[own], J_hand)
        # Half the rotational stiffness, on the object's orientation as this hand's grasp implies it.
        for k in range(3):
            R[k] = apply(s.R_tcps_object[i].T, R_hand[k])
        error, _ = turn(T_d, R)
        wrench[:3] = f[i][0]
        wrench[3:] = f[i][1]
        slow[:] = omega
        add_product(slow, -1.0, J_hand[3:], v[own])
        for k in range(3):
            wrench[3 + k] += 0.5 * (K[3 + k] * error[k] + D[3 + k] * slow[k])
        push[own] = 0.0
        add_product(push[own], 1.0, J_hand.T, wrench)
        # qdd_posture + J^+ (a_hand - J qdd_posture - Jdot v): only the null space keeps the posture.
        a_hand = plus(a, plus(cross(alpha, r[i]), cross(omega, cross(omega, r[i]))))
        lacking[:3] = minus(a_hand, drift[0])
        lacking[3:] = minus(alpha, drift[1])
        for j in range(n * i, n * i + n):
            qdd[j] = s.posture_stiffness * (posture[j] - q[j]) - s.posture_damping * v[j]
        add_product(lacking, -1.0, J_hand, qdd[own])
        if not least_norm(J_hand, lacking, qdd[own], L):
            return False
    return math.isfinite(push.sum() + qdd.sum())


@kernel(
    types.boolean(
        *(types.Array(from_dtype(HAND_LAW), 1, "C"), _HANDS, types.intp, ROWS),
        *(VIEW, VIEW, VIEW, VIEW, VECTOR, VECTOR, VECTOR),
    ),
    heap=True,
)
def hand_impedance(
    law: Array,
    hands: Placed,
    arm: int,
    T_ref: Array,
    q: Array,
    v: Array,
    q_ref: Array,
    v_ref: Array,
    learnt: Array,
    qdd: Array,
    push: Array,
) -> bool:
    """Add the part of one hand to qdd (n,) and push (n,), and move `learnt` (6,); see docs/force-control.md.

    law: (1,) of HAND_LAW. Return False if the hand has lost a direction of motion.
    """
    s = law[0]
    J = hands[0]
    n = len(v) // 2
    R_tcp = hands[4] if arm else hands[3]
    p_tcp = hands[2] if arm else hands[1]
    own = slice(n * arm, n * arm + n)
    R = np.empty((3, 3))
    J_hand = np.empty((6, n))
    pull = np.empty(6)
    wrench = np.empty(6)
    for i in range(3):
        for k in range(3):
            R[i, k] = inner(R_tcp[i], s.T_tcp_object[:3, k])
    p = plus(three(p_tcp, 0), plus(apply(R_tcp, s.T_tcp_object[:3, 3]), apply(R, s.centre)))
    hand_motion(J[:, own], p, v[own], J_hand)
    late = np.zeros(6)
    add_product(late, 1.0, J_hand, v_ref[own])
    add_product(late, -1.0, J_hand, v[own])
    axes = T_ref.T
    late_along = np.empty(6)
    pull[:3] = apply(axes, minus(plus(three(T_ref[:, 3], 0), apply(T_ref, s.centre)), p))
    pull[3:] = apply(axes, turn(T_ref, R)[0])
    late_along[:3] = apply(axes, late[:3])
    late_along[3:] = apply(axes, late[3:])
    for k in range(6):
        pull[k] *= s.K[k]
        learnt[k] = within(learnt[k] + s.learning * pull[k], -s.most[k], s.most[k])
        pull[k] = within(pull[k] + learnt[k], -s.most[k], s.most[k])
    add_product(pull, 1.0, s.D, late_along)
    wrench[:3] = apply(T_ref, pull[:3])
    wrench[3:] = apply(T_ref, pull[3:])
    add_product(push[own], 1.0, J_hand.T, wrench)
    posture = np.empty(n)
    lacking = np.zeros(6)
    for j in range(n):
        k = n * arm + j
        posture[j] = s.posture_stiffness * (q_ref[k] - q[k]) + s.posture_damping * (v_ref[k] - v[k])
        qdd[k] += posture[j]
    add_product(lacking, -1.0, J_hand, posture)  # only the null space keeps the posture
    return least_norm(J_hand, lacking, qdd[own], np.empty((6, 6)))


@kernel(types.void(_HANDS, types.intp, _POSE, _POSE, types.boolean, ROWS))
def from_hand(hands: Placed, arm: int, X: Array, T: Array, back: bool, out: Array) -> None:
    """Fill `out` (4, 4) with H T, or H^-1 T if `back`, of the frame H at X in a hand."""
    R = hands[4] if arm else hands[3]
    p_tcp = hands[2] if arm else hands[1]
    p = three(p_tcp, 0)
    p_X = three(X[:, 3], 0)
    for k in range(4):
        x = three(T[:, k], 0)
        one = T[3, k]
        if back:
            out[:3, k] = apply(X.T, minus(apply(R.T, minus(x, times(one, p))), times(one, p_X)))
        else:
            out[:3, k] = plus(apply(R, plus(apply(X, x), times(one, p_X))), times(one, p))
        out[3, k] = one


@njit
def hand_twist(J: Array, p: Elements, v: Array) -> tuple[Vector, Vector]:
    """Return the velocity (linear, angular) of a hand at p."""
    linear = omega = (0.0, 0.0, 0.0)
    for j in range(len(v)):
        linear = plus(linear, times(v[j], three(J[:, j], 0)))
        omega = plus(omega, times(v[j], three(J[:, j], 3)))
    return plus(linear, cross(omega, p)), omega


@kernel(_REAL(_HANDS, VECTOR, ROWS, ROWS, ROWS, VECTOR))
def follow(hands: Placed, v: Array, X: Array, T_hands: Array, T: Array, twist: Array) -> float:
    """Fill the frame T_hands (4, 4) of both hands, and pose T = T_hands X and twist (6,) of an object that follows them.

    Return the distance between the hands.
    """
    J, p_left, p_right, R_left, R_right = hands
    left = three(p_left, 0)
    right = three(p_right, 0)
    n = len(v) // 2
    apart = minus(left, right)
    distance = math.sqrt(inner(apart, apart))
    y = times(1.0 / distance, apart)
    x = plus(three(R_left[:, 1], 0), three(R_right[:, 1], 0))  # mean finger direction
    x = minus(x, times(inner(x, y), y))
    x = times(1.0 / math.sqrt(inner(x, x)), x)
    z = cross(x, y)
    p = times(0.5, plus(left, right))
    for i in range(3):
        T_hands[i, 0] = x[i]
        T_hands[i, 1] = y[i]
        T_hands[i, 2] = z[i]
        T_hands[i, 3] = p[i]
        for k in range(4):
            T[i, k] = x[i] * X[0, k] + y[i] * X[1, k] + z[i] * X[2, k]
        T[i, 3] += p[i]
    T_hands[3, :] = 0.0
    T[3, :] = 0.0
    T_hands[3, 3] = 1.0
    T[3, 3] = 1.0
    v_left, w_left = hand_twist(J[:, :n], left, v[:n])
    v_right, w_right = hand_twist(J[:, n:], right, v[n:])
    # Rotation about x and z follows from the two points, about y only from the hands' angular velocities.
    about_y = 0.5 * inner(plus(w_left, w_right), y)
    omega = plus(times(1.0 / distance, cross(y, minus(v_left, v_right))), times(about_y, y))
    middle = times(0.5, plus(v_left, v_right))
    lever = minus(three(T[:, 3], 0), p)
    twist[:3] = plus(middle, cross(omega, lever))
    twist[3:] = omega
    return distance


@kernel(_REAL(VECTOR, ROWS))
def pressed(felt: Array, T: Array) -> float:
    """Return the internal force [N] that the hands' forces felt[:6] have along y of T; NaN stays NaN."""
    y = three(T[:, 1], 0)
    left = -inner(three(felt, 0), y)
    right = inner(three(felt, 3), y)
    return right if right < left or right != right else left


@kernel(
    types.Tuple([types.intp, _REAL])(
        ROWS,
        VECTOR,
        VECTOR,
        VECTOR,
        _REAL,
        _REAL,
        types.boolean,
        ROWS,
    ),
)
def smooth(
    forces: Array,
    pinch: Array,
    raw: Array,
    felt: Array,
    share: float,
    glitch_n: float,
    patient: bool,
    T: Array,
) -> tuple[int, float]:
    """Fill `raw` (8,) with forces (2, 3) and pinch (2,), and move `felt` (8,) towards it by `share`.

    A value further away than `glitch_n` is left out if `patient`, one that is not finite always. Return 0 if all were
    near, 1 if finite, else 2; and `pressed`.
    """
    odd = 0
    for i in range(8):
        raw[i] = pinch[i - 6] if i >= 6 else forces[i // 3, i % 3]
        change = raw[i] - felt[i]
        near = abs(change) <= glitch_n
        finite = math.isfinite(raw[i])
        kind = 0
        if not near:
            kind = 1 if finite else 2
        odd = max(odd, kind)
        if near or (finite and not patient):
            felt[i] += share * change
    return odd, pressed(felt, T)


@kernel(types.UniTuple(_REAL, 3)(_REAL))
def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Return the quintic rest-to-rest blend at s, clipped to 0..1, and its first two derivatives."""
    s = within(s, 0.0, 1.0)
    return (
        s**3 * (10.0 + s * (6.0 * s - 15.0)),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 + s * (2.0 * s - 3.0)),
    )


@kernel(types.void(ROWS, VECTOR, _REAL, ROWS, ROWS, ROWS))
def on_path(poses: Array, ends_s: Array, t_s: float, X: Array, T: Array, motion: Array) -> None:
    """Fill T (4, 4) with a path's level pose times X, and `motion` (2, 6) with twist and acceleration.

    poses: (k, 4), x, y, z and yaw each, reached at ends_s (k,).
    """
    first = 0
    while first < len(ends_s) - 2 and ends_s[first + 1] <= t_s:
        first += 1
    start = poses[first]
    end = poses[first + 1]
    span = ends_s[first + 1] - ends_s[first]
    s, ds, dds = minimum_jerk((t_s - ends_s[first]) / span)
    yaw = start[3] + s * (end[3] - start[3])
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    for k in range(4):
        T[0, k] = cosine * X[0, k] - sine * X[1, k]
        T[1, k] = sine * X[0, k] + cosine * X[1, k]
        T[2, k] = X[2, k]
        T[3, k] = X[3, k]
    for i in range(4):
        way = end[i] - start[i]
        if i < 3:
            T[i, 3] += start[i] + s * way
        axis = i if i < 3 else 5
        motion[0, axis] = ds / span * way
        motion[1, axis] = dds / span**2 * way


@kernel(types.boolean(_POSE, VIEW, VIEW, VIEW, ROWS, VECTOR, VECTOR))
def adopt(
    T: Array,
    twist: Array,
    acceleration: Array,
    most: Array,
    T_own: Array,
    twist_own: Array,
    a_own: Array,
) -> bool:
    """Copy a pose and its motion, if the pose is near the last one and the motion within bounds; else, or for NaN, return false.

    most (6,): difference of rotations' entries and of positions', speed, rate of turning, and their accelerations.
    """
    for i in range(3):
        for k in range(4):
            largest = most[1] if k == 3 else most[0]
            if not abs(T[i, k] - T_own[i, k]) <= largest:
                return False
    for i in range(4):
        x = three(twist if i < 2 else acceleration, 3 * (i % 2))
        if not inner(x, x) <= most[2 + i] ** 2:
            return False
    for k in range(4):
        T_own[:3, k] = three(T[:, k], 0)
    for k in range(6):
        twist_own[k] = twist[k]
        a_own[k] = acceleration[k]
    return True


@kernel(_REAL(VECTOR, VECTOR))
def farthest(a: Array, b: Array) -> float:
    """Return the largest |a - b|; NaN stays."""
    most = 0.0
    for i in range(len(a)):
        most = larger(abs(a[i] - b[i]), most)
    return most


@kernel(types.void(VECTOR, VECTOR, _REAL, VECTOR, VECTOR))
def strain(tau: Array, tau_max: Array, saturated: float, ticks: Array, worst: Array) -> None:
    """Count in `ticks` (n,) for how many calls |tau| / tau_max was saturated; update the largest ratio and count in `worst`.

    NaN stays.
    """
    for j in range(len(tau)):
        ratio = abs(tau[j]) / tau_max[j]
        ticks[j] = ticks[j] + 1.0 if ratio >= saturated else 0.0
        worst[0] = larger(ratio, worst[0])
        worst[1] = max(worst[1], ticks[j])


@kernel(types.void(*[VIEW] * 5, _REAL, VECTOR))
def servo(q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array, w: float, a: Array) -> None:
    """Fill a (n,) with a_ref + 2 w (v_ref - v) + w^2 (q_ref - q)."""
    for j in range(len(a)):
        a[j] = a_ref[j] + 2.0 * w * (v_ref[j] - v[j]) + w * w * (q_ref[j] - q[j])


@kernel(types.void(VECTOR, VIEW, VIEW, _REAL, _REAL, VIEW))
def add_loads(
    tau: Array,
    load: Array,
    v: Array,
    damping: float,
    dry: float,
    tau_max: Array,
) -> None:
    """Add load (n,) and friction d v + c tanh(v / v_s) to tau (n,) and clip; tanh, because near rest the sign of v is noise."""
    for j in range(len(tau)):
        tau[j] += load[j]
        tau[j] += damping * v[j] + (dry * math.tanh(v[j] / 0.02) if dry != 0.0 else 0.0)
        tau[j] = within(tau[j], -tau_max[j], tau_max[j])


@kernel(types.void(VIEW, ROWS, ROWS, _REAL, _REAL, _REAL))
def follow_target(
    target: Array,
    state: Array,
    bounds: Array,
    w: float,
    dt: float,
    ramp_s: float,
) -> None:
    """Advance `state` (6, n) in place: q, v, a, and the ramp's start, its end and the share that is left of it.

    bounds (5, n): a_max, v_max, d, lower, upper. See `joint_control`.
    """
    q = state[0]
    v = state[1]
    start = state[3]
    end = state[4]
    left = state[5]
    for j in range(len(target)):
        a_max = bounds[0, j]
        v_max = bounds[1, j]
        near = bounds[2, j]
        if target[j] != end[j]:
            start[j] = end[j] + left[j] * (start[j] - end[j])
            end[j] = target[j]
            left[j] = 1.0
        left[j] = max(0.0, left[j] - dt / ramp_s)
        e = within(end[j] + left[j] * (start[j] - end[j]), bounds[3, j], bounds[4, j]) - q[j]
        s = near / max(abs(e), near)
        a = within(w * w * e * math.sqrt(s * (2.0 - s)) - 2.0 * w * v[j], -a_max, a_max)
        v_after = within(v[j] + dt * a, -v_max, v_max)
        state[2, j] = (v_after - v[j]) / dt  # recomputed: the speed bound may have cut it
        q[j] = q[j] + dt * v_after
        v[j] = v_after
