"""What stands between the controllers' torques and the motors: who guards them, and which arms are told nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from minidual.control.soft_stop import TorqueRate
from minidual.robot.pair import Array, Robot


class Guard(Protocol):
    """A supervisor: the last look at the torques before the motors."""

    def guard(self, time_s: float, q: Array, v: Array, tau: Array, a_ref: Array | None = None) -> Array:
        """Return the torques (n,) [Nm] to apply; raise a named error, once, to stop the arms."""
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
        tau: Torques (n,) [Nm] that act now.
        dt_s: Control step.
        robot: The two arms.
    """

    def __init__(self, arms: Sequence[int], tau: Array, dt_s: float, robot: Robot) -> None:
        self._joints = np.repeat([arm in arms for arm in (0, 1)], robot.dof_per_arm)
        self._rate, self._zero = TorqueRate(tau, dt_s, robot.arm.tau_rate_max), np.zeros_like(tau)

    def step(self) -> None:
        """Advance by one control step."""
        self._rate.limit(self._zero)

    def apply(self, tau: Array) -> Array:
        """Return the torques (n,) with those of the arms that are off in their place."""
        return np.where(self._joints, self._rate.tau, tau)
