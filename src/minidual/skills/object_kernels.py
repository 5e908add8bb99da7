"""Compiled parts of an object's estimate, of its path, and of the watch over it.

numba's cache watches this file alone; after a change of `control/kernels.py` delete the
`__pycache__` folders.
"""

import math

from numba import njit
from numba.core import types

from minidual.control.kernels import (
    HANDS,
    Elements,
    Placed,
    Vector,
    cross,
    inner,
    larger,
    minimum_jerk,
    minus,
    plus,
    three,
    times,
)
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_REAL = types.float64


@njit
def hand_twist(J: Array, p: Elements, v: Array) -> tuple[Vector, Vector]:
    """Return the velocity (linear, angular) of a hand at p."""
    linear = (0.0, 0.0, 0.0)
    omega = (0.0, 0.0, 0.0)
    for j in range(len(v)):
        linear = plus(linear, times(v[j], three(J[:, j], 0)))
        omega = plus(omega, times(v[j], three(J[:, j], 3)))
    return plus(linear, cross(omega, p)), omega


@kernel(_REAL(HANDS, VECTOR, ROWS, ROWS, ROWS, VECTOR))
def follow(hands: Placed, v: Array, X: Array, T_hands: Array, T: Array, twist: Array) -> float:
    """Fill frame, pose and twist of an object that follows both hands; return the hands' distance.

    Args:
        hands: See `Hands.views`.
        v: Joint velocities (n,) [rad/s].
        X: Pose (4, 4) of the object in the hands' frame.
        T_hands: (4, 4), overwritten by the frame of the hands.
        T: (4, 4), overwritten by T_hands X.
        twist: (6,), overwritten by the object's twist.
    """
    J, p_left, p_right, R_left, R_right, n = hands
    left = three(p_left, 0)
    right = three(p_right, 0)
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
    # Rotation about x and z follows from the two points, about y only from the hands' angular
    # velocities.
    about_y = 0.5 * inner(plus(w_left, w_right), y)
    omega = plus(times(1.0 / distance, cross(y, minus(v_left, v_right))), times(about_y, y))
    middle = times(0.5, plus(v_left, v_right))
    lever = minus(three(T[:, 3], 0), p)
    twist[:3] = plus(middle, cross(omega, lever))
    twist[3:] = omega
    return distance


@kernel(_REAL(VECTOR, ROWS))
def pressed(felt: Array, T: Array) -> float:
    """Return the internal force [N] of the hands' forces felt[:6] along y of T; NaN stays NaN."""
    y = three(T[:, 1], 0)
    left = -inner(three(felt, 0), y)
    right = inner(three(felt, 3), y)
    return right if right < left or right != right else left


# One array an argument: numba unpacks a structure at a cost of a microsecond a call.
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
    """Filter forces and pinches, without glitches.

    It has eight arguments, because a kernel takes arrays and numbers only.

    Args:
        forces: (2, 3) [N], of the hands.
        pinch: (2,) [N].
        raw: (8,), overwritten by forces and pinches.
        felt: (8,), moved towards `raw`.
        share: Of the difference, by which `felt` moves.
        glitch_n: Difference from which a value is a glitch.
        patient: Whether glitches are left out; values that are not finite always are.
        T: Pose (4, 4) of the object.

    Returns:
        0 if all values were near, 1 if all were finite, else 2; and `pressed`.
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


@kernel(types.void(ROWS, VECTOR, _REAL, ROWS, ROWS, ROWS))
def on_path(poses: Array, ends_s: Array, t_s: float, X: Array, T: Array, motion: Array) -> None:
    """Fill pose, twist and acceleration at a time of a path.

    Args:
        poses: (k, 4), x, y, z and yaw each.
        ends_s: (k,), times at which they are reached.
        t_s: Path time.
        X: Pose (4, 4) of the object in the level frame.
        T: (4, 4), overwritten by the level pose times X.
        motion: (2, 6), overwritten by twist and acceleration.
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


@kernel(_REAL(VECTOR, VECTOR))
def farthest(a: Array, b: Array) -> float:
    """Return the largest |a - b|; NaN stays."""
    most = 0.0
    for i in range(len(a)):
        most = larger(abs(a[i] - b[i]), most)
    return most
