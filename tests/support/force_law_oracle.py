"""The object impedance law written out plainly, one line an equation: the oracle for the fast one.

It shares no code with `minidual.control.impedance`: the pseudo-inverse is numpy's, the time derivative of the
Jacobians is a finite difference of Pinocchio's, the dynamics are M qdd + h.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.config.control import ImpedanceConfig
from minidual.control.impedance import (
    POSTURE_DAMPING_PER_S,
    POSTURE_STIFFNESS_PER_S2,
    SQUEEZE_MAX_N,
    HeldObject,
    ObjectState,
)
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from tests.support.panda import DOF, GROUPS, JOINT_DAMPING, TAU_MAX

GRAVITY = np.array([0.0, 0.0, -9.81])


def cross_matrix(r: Array) -> Array:
    """Return the (3, 3) matrix of the cross product with r."""
    return np.cross(r, -np.eye(3))


def grasp_matrix(r_left: Array, r_right: Array) -> Array:
    """Return G (6, 12)."""
    one = np.eye(3)
    none = np.zeros((3, 3))
    return np.block(
        [[one, none, one, none], [cross_matrix(r_left), one, cross_matrix(r_right), one]],
    )


def split(G: Array, f: Array) -> tuple[Array, Array]:
    """Return the parts of hand wrenches f (12,) that move the object and that only squeeze it."""
    motion = np.linalg.pinv(G) @ (G @ f)
    return motion, f - motion


def squeeze_reference(axis: Array, force_n: float) -> Array:
    """Return f_int (12,) [N]: both hands press towards each other along the axis from the right to the left hand."""
    return np.concatenate([-force_n * axis, np.zeros(3), force_n * axis, np.zeros(3)])


def drift(kinematics: Kinematics, q: Array, v: Array) -> Array:
    """Return Jdot v (12,) of both hands by central differences along the motion."""
    h = 1e-6
    ahead, behind = (np.vstack(kinematics.tcp_jacobians(q + s * h * v)) for s in (1.0, -1.0))
    return (ahead - behind) @ v / (2.0 * h)


def stiffness(gains: ImpedanceConfig) -> Array:
    """Return the diagonal of K (6,)."""
    return np.array([gains.stiffness_n_per_m] * 3 + [gains.stiffness_nm_per_rad] * 3)


def damping(kinematics: Kinematics, held: HeldObject, gains: ImpedanceConfig, q: Array) -> Array:
    """Return D (6,) at the posture where the law takes over."""
    M = kinematics.mass_matrix(q)
    moving = np.concatenate([np.full(3, held.mass_kg), np.diag(held.inertia_kg_m2)])
    lever = max(np.linalg.norm(T[:3, 3]) for T in held.T_object_tcps)
    for J in kinematics.tcp_jacobians(q):
        mass, inertia = (np.linalg.inv(part @ np.linalg.inv(M) @ part.T) for part in (J[:3], J[3:]))
        moving += np.concatenate(
            [np.diag(mass), lever**2 * np.trace(mass) / 3.0 + np.diag(inertia)],
        )
    return 2.0 * gains.damping_ratio * np.sqrt(stiffness(gains) * moving)


def torque(
    kinematics: Kinematics,
    held: HeldObject,
    gains: ImpedanceConfig,
    q_engaged: Array,
    q: Array,
    v: Array,
    measured: ObjectState,
    desired: ObjectState,
    internal_force_n: float,
    measured_internal_force_n: float,
) -> Array:
    """Return the law's torques (14,) [Nm]."""
    R = measured.T_world_object[:3, :3]
    p = measured.T_world_object[:3, 3]
    R_d = desired.T_world_object[:3, :3]
    p_d = desired.T_world_object[:3, 3]
    a_d = desired.acceleration[:3]
    alpha_d = desired.acceleration[3:]
    omega_d = desired.twist[3:]

    # What the object should feel.
    K = stiffness(gains)
    D = damping(kinematics, held, gains, q_engaged)
    spring = np.concatenate([K[:3] * (p_d - p), np.zeros(3)])
    damper = np.concatenate([D[:3] * (desired.twist - measured.twist)[:3], np.zeros(3)])
    I_w = R @ held.inertia_kg_m2 @ R.T
    inertia = np.concatenate(
        [held.mass_kg * (a_d - GRAVITY), I_w @ alpha_d + np.cross(omega_d, I_w @ omega_d)],
    )
    w = spring + damper + inertia

    # How the hands share it, and how they squeeze.
    correction = np.clip(
        gains.force_gain * (internal_force_n - measured_internal_force_n),
        -gains.force_correction_max_n,
        gains.force_correction_max_n,
    )
    F = np.clip(internal_force_n + correction, 0.0, SQUEEZE_MAX_N)
    axis = R @ held.axis
    none = np.zeros(3)
    f_int = np.concatenate([-F * axis, none, F * axis, none])
    tcps = kinematics.tcp_poses(q)
    r = [T[:3, 3] - p for T in tcps]
    G = grasp_matrix(*r)
    G_inverse = np.linalg.pinv(G)
    f = G_inverse @ w + (np.eye(12) - G_inverse @ G) @ f_int

    # What the arms must do for it.
    J_left, J_right = kinematics.tcp_jacobians(q)
    drifts = drift(kinematics, q, v)
    qdd = np.zeros(DOF)
    external = np.zeros(DOF)
    for i, (J, arm) in enumerate(((J_left, GROUPS["left_arm"]), (J_right, GROUPS["right_arm"]))):
        J = J[:, arm]
        a_hand = np.concatenate(
            [a_d + np.cross(alpha_d, r[i]) + np.cross(omega_d, np.cross(omega_d, r[i])), alpha_d],
        )
        posture = (POSTURE_STIFFNESS_PER_S2 * (q_engaged - q) - POSTURE_DAMPING_PER_S * v)[arm]
        J_inverse = np.linalg.pinv(J)
        null = np.eye(7) - J_inverse @ J
        qdd[arm] = J_inverse @ (a_hand - drifts[6 * i : 6 * i + 6]) + null @ posture
        hand_error = pin.log3(R_d @ held.T_object_tcps[i][:3, :3] @ tcps[i][:3, :3].T)
        hand_rate = omega_d - J[3:] @ v[arm]
        half = 0.5 * (K[3:] * hand_error + D[3:] * hand_rate)
        external[arm] = J.T @ (f[6 * i : 6 * i + 6] + np.concatenate([none, half]))
    friction = JOINT_DAMPING * v
    tau = kinematics.mass_matrix(q) @ qdd + kinematics.bias(q, v) + external + friction
    return np.clip(tau, -TAU_MAX, TAU_MAX)
