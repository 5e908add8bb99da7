"""Map leader joints to follower joints."""

import numpy as np

from minidual.config.teleop import MirrorConfig
from minidual.errors import UsageError
from minidual.robot.pair import Array, Robot


class LeaderOffsetError(UsageError):
    """Leader and follower are too far apart to begin."""


class Mirror:
    """Clips leader joints to the follower's limits.

    Raises:
        UsageError: Wrong number of joints, in all methods.
    """

    def __init__(self, robot: Robot, config: MirrorConfig) -> None:
        self.robot, self.config = robot, config

    def check_start(self, q_leader: Array, q_follower: Array) -> None:
        """Raise LeaderOffsetError if a joint differs by more than the limit."""
        difference = self.target(q_leader) - q_follower
        worst, limit = int(np.argmax(np.abs(difference))), self.config.start_error_max_rad
        if abs(difference[worst]) > limit:
            raise LeaderOffsetError(
                f"the leader starts {difference[worst]:+.3f} rad away from the follower at "
                f"{self.robot.joint_names[worst]} ({int(np.sum(np.abs(difference) > limit))} of {self.robot.dof} joints "
                f"over the limit of {limit} rad)",
                remedy="bring the leader to the follower's posture; check the joint order, the signs and the offsets",
            )

    def target(self, q_leader: Array) -> Array:
        """Return the clipped target (n,) [rad].

        All zeros (lost values) and NaN pass unchanged, so that the arbiter refuses them.
        """
        q, margin = np.asarray(q_leader, dtype=float), self.config.workspace_margin_rad
        if q.shape != (self.robot.dof,):
            raise UsageError(
                f"the leader gives joints of shape {q.shape}; it must be ({self.robot.dof},), left then right"
            )
        return np.clip(q, self.robot.q_lower + margin, self.robot.q_upper - margin) if q.any() else q
