"""Map leader joints to follower joints."""

from __future__ import annotations

import numpy as np

from minidual.config.teleop import MirrorConfig
from minidual.errors import UsageError
from minidual.robot.pair import Array, Robot


class LeaderOffsetError(UsageError):
    """The postures differ; the follower would jump."""


class Mirror:
    """Maps q_target = q_leader + offset, clipped to the follower's limits."""

    def __init__(self, robot: Robot, config: MirrorConfig | None = None) -> None:
        self.robot, self.config = robot, MirrorConfig() if config is None else config
        self.offset_rad: Array = np.zeros(robot.dof)

    def calibrate(self, q_leader: Array, q_follower: Array) -> Array:
        """Set the offset from a common posture.

        Raises:
            LeaderOffsetError: It exceeds `calibration_max_rad`.
        """
        offset = self._joints(q_follower, "follower") - self._joints(q_leader, "leader")
        worst = int(np.argmax(np.abs(offset)))
        if abs(offset[worst]) > self.config.calibration_max_rad:
            raise LeaderOffsetError(
                f"{self.robot.joint_names[worst]}: leader and follower differ by {offset[worst]:+.3f} rad; an offset "
                f"is at most {self.config.calibration_max_rad} rad",
                remedy="put both into the same posture before calibrating; check the joint order and the signs",
            )
        self.offset_rad = offset
        return offset

    def check_start(self, q_leader: Array, q_follower: Array) -> None:
        """Raise LeaderOffsetError if too far apart."""
        difference = self.target(q_leader) - self._joints(q_follower, "follower")
        worst, limit = int(np.argmax(np.abs(difference))), self.config.start_error_max_rad
        if abs(difference[worst]) > limit:
            raise LeaderOffsetError(
                f"the leader starts {difference[worst]:+.3f} rad away from the follower at "
                f"{self.robot.joint_names[worst]} ({int(np.sum(np.abs(difference) > limit))} of {self.robot.dof} joints "
                f"over the limit of {limit} rad)",
                remedy="bring the leader to the follower's posture, or calibrate the offset in one common posture",
            )

    def target(self, q_leader: Array) -> Array:
        """Return the clipped target (n,) [rad].

        All zeros (lost values) pass unchanged and NaN stays NaN, so the arbiter can refuse them.
        Shifted zeros would look valid.

        Raises:
            UsageError: Wrong number of joints.
        """
        q, margin = self._joints(q_leader, "leader"), self.config.workspace_margin_rad
        if not q.any():
            return q
        return np.clip(q + self.offset_rad, self.robot.q_lower + margin, self.robot.q_upper - margin)

    def _joints(self, q: Array, who: str) -> Array:
        q = np.asarray(q, dtype=float)
        if q.shape != (self.robot.dof,):
            raise UsageError(
                f"the {who} gives joints of shape {q.shape}; it must be ({self.robot.dof},), left then right"
            )
        return q
