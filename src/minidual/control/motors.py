"""What stands between the controllers' torques and the motors: who guards them, and which arms are told nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from minidual.control.soft_stop import TorqueRate
from minidual.robot.constants import DOF, DOF_PER_ARM, Array


class Guard(Protocol):
    """A supervisor: the last look at the torques before the motors."""

    def guard(self, time_s: float, q: Array, v: Array, tau: Array, a_ref: Array | None = None) -> Array:
        """Return the torques (14,) [Nm] to apply; raise a named error, once, to stop the arms."""
        ...

    def fail(self, time_s: float, q: Array, v: Array, why: str) -> Array:
        """Stop the arms, as `guard` does, in a tick in which the controllers give no torque."""
        ...

    def heard(self, time_s: float) -> None:
        """Note that the arbiter is alive."""
        ...

    def reset(self) -> None:
        """Forget everything."""
        ...


class SwitchedOff:
    """Arms whose motors are told no torque: it falls to zero at the drives' rate and stays there.

    Args:
        arms: Indices of the arms.
        tau: Torques (14,) [Nm] that act now.
        dt_s: Control step.
    """

    def __init__(self, arms: Sequence[int], tau: Array, dt_s: float) -> None:
        self._joints = np.repeat([arm in arms for arm in range(DOF // DOF_PER_ARM)], DOF_PER_ARM)
        self._rate, self._zero = TorqueRate(tau, dt_s), np.zeros(DOF)

    def step(self) -> None:
        """Advance by one control step."""
        self._rate.limit(self._zero)

    def apply(self, tau: Array) -> Array:
        """Return the torques (14,) with those of the arms that are off in their place."""
        return np.where(self._joints, self._rate.tau, tau)
