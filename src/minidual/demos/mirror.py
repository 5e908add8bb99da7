"""From the leader's joints to the follower's: alignment at the start, offsets, limits."""

from __future__ import annotations

import numpy as np

from minidual.config.teleop import MirrorConfig
from minidual.errors import UsageError
from minidual.robot.constants import DOF, JOINT_NAMES, Q_LOWER, Q_UPPER, Array


class LeaderOffsetError(UsageError):
    """Leader and follower do not stand alike; the follower would lurch when it begins to follow."""


class Mirror:
    """Maps the leader's joint angles to targets of the follower: q_target = q_leader + offset, inside limits.

    Args:
        config: Bounds.
        offset_rad: (14,) what the follower reads more than the leader in the same posture; zero by default.
    """

    def __init__(self, config: MirrorConfig | None = None, *, offset_rad: Array | None = None) -> None:
        self.config = MirrorConfig() if config is None else config
        self.offset_rad = np.zeros(DOF) if offset_rad is None else _joints(offset_rad, "offset")
        self._lower = Q_LOWER + self.config.workspace_margin_rad
        self._upper = Q_UPPER - self.config.workspace_margin_rad

    def calibrate(self, q_leader: Array, q_follower: Array) -> Array:
        """Take the present difference as the offset, when both stand in the same posture; return it (14,).

        Raises:
            LeaderOffsetError: The difference is no mounting error: larger than `calibration_max_rad`.
        """
        offset = _joints(q_follower, "follower") - _joints(q_leader, "leader")
        worst = int(np.argmax(np.abs(offset)))
        if abs(offset[worst]) > self.config.calibration_max_rad:
            raise LeaderOffsetError(
                f"{JOINT_NAMES[worst]}: leader and follower differ by {offset[worst]:+.3f} rad; an offset is at most "
                f"{self.config.calibration_max_rad} rad",
                remedy="put both into the same posture before calibrating; check the joint order and the signs",
            )
        self.offset_rad = offset
        return offset

    def check_start(self, q_leader: Array, q_follower: Array) -> None:
        """Refuse to begin while leader and follower stand apart.

        Raises:
            LeaderOffsetError: Naming the joint that differs most.
        """
        difference = self.target(q_leader) - _joints(q_follower, "follower")
        worst = int(np.argmax(np.abs(difference)))
        limit = self.config.start_error_max_rad
        if abs(difference[worst]) > limit:
            count = int(np.sum(np.abs(difference) > limit))
            raise LeaderOffsetError(
                f"the leader starts {difference[worst]:+.3f} rad away from the follower at {JOINT_NAMES[worst]} "
                f"({count} of {DOF} joints over the limit of {limit} rad)",
                remedy="bring the leader to the follower's posture, or calibrate the offset in one common posture",
            )

    def target(self, q_leader: Array) -> Array:
        """Return the follower's target (14,) [rad], kept inside its limits.

        A reading that is no posture (NaN, or zero on every joint, as a device gives that has lost its values)
        passes on as it is, for the arbiter to refuse: shifted and clipped it would look like one.

        Raises:
            UsageError: The leader's reading is not 14 angles.
        """
        q = _joints(q_leader, "leader")
        return np.clip(q + self.offset_rad, self._lower, self._upper) if q.any() else q


def _joints(q: Array, who: str) -> Array:
    q = np.asarray(q, dtype=float)
    if q.shape != (DOF,):
        raise UsageError(f"the {who} gives joints of shape {q.shape}; it must be ({DOF},), left then right")
    return q
