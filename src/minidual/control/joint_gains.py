"""Gains of every joint, from the inertia that it moves.

For error e = q_ref - q computed torque gives e'' + 2 zeta wn e' + wn^2 e = 0 for every joint, because it multiplies by
M(q). Read as a PD controller at a posture, joint j has

    kp_j = M_jj wn^2        kd_j = 2 zeta wn M_jj

so gains follow from the inertia M_jj seen at the joint and from one number for all, wn. Two bounds hold wn:

    wn <= sqrt(a_max / e)      an error e must not ask for more than the joint's acceleration limit
    wn <= 0.1 / dt             the loop samples ten times a radian of its own oscillation

`python -m minidual.control.joint_gains` prints the table that docs/force-control.md shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.robot.constants import A_MAX, DOF_PER_ARM, HOME, JOINT_ARMATURE, Array
from minidual.robot.kinematics import Kinematics

NATURAL_FREQUENCY_RAD_S = 20.0
DAMPING_RATIO = 1.0


@dataclass(frozen=True)
class JointGains:
    """Inertia and gains of the joints at a posture, each (14,).

    Attributes:
        inertia: M_jj [kg m^2], rotor included: what joint j moves while the others hold still.
        alone: 1 / (M^-1)_jj [kg m^2]: what it moves while the others are free.
        stiffness: kp [Nm/rad].
        damping: kd [Nms/rad].
    """

    inertia: Array
    alone: Array
    stiffness: Array
    damping: Array


def joint_gains(
    kinematics: Kinematics,
    q: Array = HOME,
    *,
    natural_frequency_rad_s: float = NATURAL_FREQUENCY_RAD_S,
    damping_ratio: float = DAMPING_RATIO,
) -> JointGains:
    """Return what the joints see at posture q (14,), and the gains that follow."""
    M = kinematics.mass_matrix(q)
    inertia = np.diag(M).copy()
    return JointGains(
        inertia,
        1.0 / np.diag(np.linalg.inv(M)),
        natural_frequency_rad_s**2 * inertia,
        2.0 * damping_ratio * natural_frequency_rad_s * inertia,
    )


def table() -> list[str]:
    """Return the table of one arm at home, in Markdown."""
    gains = joint_gains(Kinematics())
    lines = [
        "| joint | M_jj [kg m^2] | of it rotor | others free [kg m^2] | kp [Nm/rad] | kd [Nms/rad] | a_max / wn^2 [rad] |",
        "|---|---|---|---|---|---|---|",
    ]
    for j in range(DOF_PER_ARM):
        lines.append(
            f"| {j + 1} | {gains.inertia[j]:.3f} | {JOINT_ARMATURE / gains.inertia[j]:.0%} | {gains.alone[j]:.3f} "
            f"| {gains.stiffness[j]:.1f} | {gains.damping[j]:.2f} | {A_MAX[j] / NATURAL_FREQUENCY_RAD_S**2:.3f} |"
        )
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
