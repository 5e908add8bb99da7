"""Loads on the arms of N worlds, and how near they come to the bounds of a supervisor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from minidual.environments.kernels import (
    CLOSED,
    LATE_STEPS,
    STRAIN_N,
    TORQUE_SHARE,
    Addresses,
    Driven,
    State,
    feel,
    wrenches,
)
from minidual.environments.laws import hand_force_bounds, supervised_bounds
from minidual.robot.pair import Array, Indices, Robot

if TYPE_CHECKING:
    from minidual.config.control import SupervisorConfig

_HANDS_EVERY_S = 0.01
"""Period in which the hands' wrenches are estimated."""


class Loads:
    """External torques, the hands' wrenches and the strain of N worlds; `update` after each step.

    Attributes:
        external: Torques (N, n) [Nm] that contacts ask of the joints, filtered as the supervisor does.
        hand_wrench: (N, 2, 6), [force; moment] of the surroundings on each hand, estimated from them.
        strain: (N,), the largest share of a supervisor's bound since `relax`; above 1 it would stop.

    Args:
        frames: (2, n / 2 + 1, 4, 4), see `ArmIK.frames`.
        dt_s: Period of the physics.
    """

    def __init__(
        self,
        robot: Robot,
        frames: Array,
        supervisor: SupervisorConfig,
        worlds_n: int,
        dt_s: float,
    ) -> None:
        self._frames = frames
        self._bounds = supervised_bounds(robot, supervisor, dt_s)
        self._force_max_n = hand_force_bounds(supervisor)
        self._late_steps = supervisor.deviation_s / dt_s
        self._hands_every = max(1, round(_HANDS_EVERY_S / dt_s))
        self._steps = 0
        self.external = np.zeros((worlds_n, robot.dof))
        self.hand_wrench = np.zeros((worlds_n, 2, 6))
        self._strains = np.zeros((worlds_n, STRAIN_N))
        self._hand_share = np.zeros(worlds_n)
        self._late = np.zeros(worlds_n, dtype=bool)

    @property
    def strain(self) -> Array:
        """See the class."""
        largest = np.maximum(self._strains[:, TORQUE_SHARE], self._hand_share)
        return np.where(self._late, np.inf, largest)

    def relax(self) -> None:
        """Measure `strain` anew."""
        self._strains[:, TORQUE_SHARE] = 0.0
        self._hand_share[:] = 0.0
        self._late[:] = False

    def reset(self, worlds: Indices) -> None:
        """Forget the loads of some worlds."""
        self.external[worlds] = 0.0
        self.hand_wrench[worlds] = 0.0
        self._strains[worlds] = 0.0
        self._hand_share[worlds] = 0.0
        self._late[worlds] = False

    def update(self, state: State, at: Addresses, driven: Driven) -> None:
        """Estimate the loads after a physics step."""
        feel(state, at, driven, self._bounds, self.external, self._strains)
        self._steps += 1
        if self._steps % self._hands_every == 0:
            self._update_hands(state.qpos[:, at.q])

    def _update_hands(self, q: Array) -> None:
        wrenches(self._frames, q, self.external, self.hand_wrench)
        force_n = np.linalg.norm(self.hand_wrench[:, :, :3], axis=2).max(axis=1)
        mode = self._strains[:, CLOSED].astype(int)
        np.maximum(self._hand_share, force_n / self._force_max_n[mode], out=self._hand_share)
        self._late |= self._strains[:, LATE_STEPS] > self._late_steps
