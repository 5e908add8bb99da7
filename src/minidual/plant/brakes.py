"""The brakes of simulated joints."""

import mujoco
import numpy as np

from minidual.robot.pair import SIDES, Array, Indices, Robot

_DAMPING_NM_S_PER_RAD = 50.0
"""Of a braked joint, beside exact gravity compensation, inside the motors' limits."""


class JointBrakes:
    """Dampers on the true motion, in place of the commanded torques; see `Plant.brake`.

    Args:
        data: Of the simulation.
        dofs: Addresses of the joints (n,) among its velocities.
        robot: The arms.

    Attributes:
        engaged: Whether any arm is braked.
    """

    def __init__(self, data: mujoco.MjData, dofs: Indices, robot: Robot) -> None:
        self._data = data
        self._dofs = dofs
        self._robot = robot
        self.engage(())

    def engage(self, arms: tuple[int, ...]) -> None:
        """Brake these arms and release the others."""
        self.engaged = bool(arms)
        braked = [arm in arms for arm in range(len(SIDES))]
        self._braked = self._robot.per_joint(braked)

    def applied(self, tau: Array) -> Array:
        """Return torques (n,) [Nm] with those of the brakes where a joint is braked."""
        bias = self._data.qfrc_bias[self._dofs]
        brake_tau = bias - _DAMPING_NM_S_PER_RAD * self._data.qvel[self._dofs]
        tau_max = self._robot.tau_max
        return np.where(self._braked, np.clip(brake_tau, -tau_max, tau_max), tau)
