"""Decide whether the arms may go where a leader's joints are."""

import numpy as np

from minidual.config.leading import MirrorConfig
from minidual.robot.pair import Array, Robot

_TURN_RAD = 2.0 * np.pi


def nearest_turn(q: Array, q_reference: Array) -> Array:
    """Return joints (n,) [rad] changed by whole turns to be as near to the reference as possible.

    Encoders count from another turn after a restart, and wrap in motion.
    """
    return q - _TURN_RAD * np.round((q - q_reference) / _TURN_RAD)


def off_text(robot: Robot, difference: Array, tolerance_rad: float) -> str:
    """Return where a leader's joints differ (n,) [rad] from the arms' by more than a tolerance."""
    worst = int(np.argmax(np.abs(difference)))
    over_n = int(np.sum(np.abs(difference) > tolerance_rad))
    return (
        f"{robot.joint_names[worst]} is {difference[worst]:+.2f} rad from the arms "
        f"({over_n} of {robot.dof} joints are further than {tolerance_rad:g} rad)"
    )


class AlignmentGate:
    """Passes a leader's joints once they agree with the arms', and while they change steadily.

    The gate opens when each joint is within the tolerance of where the arms are, or when a clutch is
    released: then the arms follow from where they are. It closes when a reading jumps. Closed, the
    arms keep their last target.

    Attributes:
        is_open: Whether the arms follow.
        held: Why they do not, or "".
    """

    def __init__(self, robot: Robot, config: MirrorConfig) -> None:
        self._robot = robot
        self._tolerance_rad = config.start_error_max_rad
        self._jump_max_rad = config.jump_max_rad
        self.begin(robot.home)

    def begin(self, q_follower: Array) -> None:
        """Close; the arms stand at (n,) [rad]."""
        self.is_open = False
        self.held = "no reading has come"
        self.target = np.array(q_follower, dtype=float)
        self._offset = np.zeros(self._robot.dof)
        self._q_last = self.target
        self._is_clutched = False
        self._jump = ""

    def check(self, q_leader: Array, *, clutch: bool = False) -> None:
        """Open or close by where a reading (n,) [rad] is; the target stays."""
        q = nearest_turn(q_leader, self.target - self._offset)
        self._q_last = q
        if clutch:
            self._is_clutched = True
            self.is_open = False
            self.held = "the clutch is held"
            return
        if self._is_clutched:
            self._is_clutched = False
            self._offset = self.target - q
        difference = q + self._offset - self.target
        self.is_open = bool(np.abs(difference).max() <= self._tolerance_rad)
        if self.is_open:
            self._jump = ""
            self.held = ""
        else:
            self.held = self._jump + off_text(self._robot, difference, self._tolerance_rad)

    def admit(self, q_leader: Array, *, clutch: bool = False) -> Array:
        """Return the target (n,) [rad] for a reading (n,), which must be finite."""
        if self.is_open and not clutch:
            self._go_on(q_leader)
        if clutch or not self.is_open:
            self.check(q_leader, clutch=clutch)
        if self.is_open:
            q = self._q_last + self._offset
            self.target = np.clip(q, self._robot.q_lower, self._robot.q_upper)
        return self.target

    def _go_on(self, q_leader: Array) -> None:
        """Take a reading without its whole turns; close if the rest is a jump."""
        q = nearest_turn(q_leader, self._q_last)
        jump = q - self._q_last
        worst = int(np.argmax(np.abs(jump)))
        if abs(jump[worst]) <= self._jump_max_rad:
            self._q_last = q
            return
        self.is_open = False
        name = self._robot.joint_names[worst]
        self._jump = f"the reading of {name} jumped by {jump[worst]:+.2f} rad; "
