"""Integral action of a hold along gravity: learns what a hand holds.

    F <- sat_[0, F_max](F + k e_z dt),  tau = J_z^T F

e_z is how far a hand is below its reference. Forces between two hands are horizontal, so they cannot build up.
"""

from collections.abc import Sequence

import numpy as np

from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array

LOAD_MAX_N = 30.0
"""The Panda's payload."""
_GAIN_N_PER_M_S = 2000.0  # slow beside the joints' stiffness, about 1.2 kN/m at a hand
_NEAR_M = 2e-4
_LEAVE_N_PER_S = 100.0


class Payload:
    """The load of each hand, for all controllers of a stack."""

    def __init__(self, kinematics: Kinematics, dt_s: float) -> None:
        self._kinematics, self._hands, self._dt = kinematics, Hands(kinematics), dt_s
        self.reset()

    def reset(self) -> None:
        """Start without loads."""
        self.force_n, self._leaving, self._gripper = [0.0, 0.0], [False, False], [1.0, 1.0]

    def follow(self, gripper: Array) -> None:
        """Take commanded openings (2,): a hand that opens lets go of its load."""
        for arm, opening in enumerate(gripper.tolist()):
            if opening > self._gripper[arm]:
                self._leaving[arm] = True
            self._gripper[arm] = opening

    def torque(self, q: Array, q_ref: Array, arms: Sequence[int], *, learn: bool) -> Array | None:
        """Return the torques (n,) [Nm] that bear these arms' loads, or None; `learn` if they hold still."""
        if not (learn or any(self.force_n)):
            return None
        self._hands.update(q)
        J, tau = self._hands.J, np.zeros_like(q)
        for arm in arms:
            joints, (x, y, _) = self._kinematics.robot.joints_of(arm), self._hands.p[arm]
            rise = J[2, joints] + y * J[3, joints] - x * J[4, joints]
            below_m = float(rise @ (q_ref - q)[joints])
            if self._leaving[arm]:
                self.force_n[arm] = max(0.0, self.force_n[arm] - _LEAVE_N_PER_S * self._dt)
                self._leaving[arm] = self.force_n[arm] > 0.0
            elif learn and abs(below_m) > _NEAR_M:  # false for NaN
                self.force_n[arm] += _GAIN_N_PER_M_S * self._dt * below_m
                self.force_n[arm] = min(LOAD_MAX_N, max(0.0, self.force_n[arm]))
            tau[joints] = self.force_n[arm] * rise
        return tau if any(self.force_n) else None
