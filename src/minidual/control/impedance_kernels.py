"""Compiled laws of object and hand impedance.

Vectors of three are tuples, which numba keeps in registers: arrays cost the object impedance four times as much.
numba's cache watches this file alone; after a change of `kernels.py` delete the `__pycache__` folders.
"""

import math

import numpy as np
from numba import from_dtype, njit
from numba.core import types

from minidual.control.kernels import (
    HANDS,
    POSE,
    Placed,
    Vector,
    add_product,
    apply,
    cross,
    hand_motion,
    inner,
    least_norm,
    minus,
    own_joints,
    plus,
    three,
    times,
    turn,
    within,
)
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.pair import Array

_REAL = types.float64
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


# One array an argument: a structure would cost half of the law's time.
@kernel(
    types.boolean(
        *(types.Array(from_dtype(LAW), 1, "C"), ROWS, VIEW, ROWS, VIEW, VIEW, _REAL, _REAL),
        *(HANDS, VIEW, VIEW, VECTOR, VECTOR, VECTOR, ROWS),
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

    law: (1,) of LAW. work: (19, joints of one arm, at least 6), overwritten: to make arrays takes a quarter of the law's time. Return
    False if a hand has lost a direction of motion, or something is not finite.
    """
    J, p_left, p_right, R_left, R_right, left_n = hands
    s = law[0]
    K = s.K
    D = s.D
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
        first, end = own_joints(i, left_n, len(v))
        own = slice(first, end)
        J_hand = work[:6, : end - first]
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
        for j in range(first, end):
            qdd[j] = s.posture_stiffness * (posture[j] - q[j]) - s.posture_damping * v[j]
        add_product(lacking, -1.0, J_hand, qdd[own])
        if not least_norm(J_hand, lacking, qdd[own], L):
            return False
    return math.isfinite(push.sum() + qdd.sum())


# One array an argument: see `impedance`.
@kernel(
    types.boolean(
        *(types.Array(from_dtype(HAND_LAW), 1, "C"), HANDS, types.intp, ROWS),
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
    first, end = own_joints(arm, hands[5], len(v))
    n = end - first
    R_tcp = hands[4] if arm else hands[3]
    p_tcp = hands[2] if arm else hands[1]
    own = slice(first, end)
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
        k = first + j
        posture[j] = s.posture_stiffness * (q_ref[k] - q[k]) + s.posture_damping * (v_ref[k] - v[k])
        qdd[k] += posture[j]
    add_product(lacking, -1.0, J_hand, posture)  # only the null space keeps the posture
    return least_norm(J_hand, lacking, qdd[own], np.empty((6, 6)))


@kernel(types.void(HANDS, types.intp, POSE, POSE, types.boolean, ROWS))
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
