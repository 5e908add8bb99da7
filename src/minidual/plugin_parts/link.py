"""The simulated arms of this process, which a leader of this process follows.

LeRobot makes robot and teleoperator apart, and neither knows the other. A scripted leader must know
the start that it demonstrates, and every leader where the arms stand.
"""

import weakref
from typing import Protocol

from minidual.config.root import Config
from minidual.robot.pair import Array
from minidual.tasks.task import Trial


class LedArms(Protocol):
    """Simulated arms, as a leader sees them.

    Attributes:
        config: Of the task that they do.
        rate_hz: Of their actions.
        trial: Of the present start.
        time_s: Simulated time since the start.
        q: Measured joints (n,) [rad].
        openings: Of the hands (2,).
    """

    config: Config
    rate_hz: float
    trial: Trial

    @property
    def time_s(self) -> float:
        """See the class."""
        ...

    @property
    def q(self) -> Array:
        """See the class."""
        ...

    @property
    def openings(self) -> Array:
        """See the class."""
        ...

    def next_start(self) -> None:
        """Put the scene to its next start."""
        ...


_present: list["weakref.ref[LedArms]"] = []


def announce(arms: LedArms) -> None:
    """Make these the arms of the process: the ones that leaders follow."""
    _present[:] = [weakref.ref(arms)]


def present_arms() -> LedArms | None:
    """Return the arms of the process, None if there are none."""
    return _present[0]() if _present else None


def withdraw(arms: LedArms) -> None:
    """Forget these arms, if they are those of the process."""
    if present_arms() is arms:
        _present.clear()
