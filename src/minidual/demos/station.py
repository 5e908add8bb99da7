"""Station of a person who leads: a display, and buttons beside the leader's own."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from minidual.robot.pair import Array

PAUSED = "paused"
"""State of a session whose time stands still in an episode."""


class Button(StrEnum):
    """Buttons that a person presses in a session.

    START begins an episode. SUCCESS and FAILURE end it: a success becomes a demonstration if it
    passes the task's test, a failure is kept apart. DISCARD throws the episode away and records the
    same start again. NEXT goes to another start. PAUSE stops time, and starts it again. CORRECT
    takes the arms over from a policy that drives, and hands them back.
    """

    START = "start"
    SUCCESS = "success"
    FAILURE = "failure"
    DISCARD = "discard"
    PAUSE = "pause"
    NEXT = "next"
    CORRECT = "correct"


@dataclass(frozen=True)
class Status:
    """The display of a station.

    Attributes:
        state: What the session does.
        time_left_s: Of the episode; None outside one.
        hint: What the leader shows, such as the hand that its keys move.
        held: Why the arms hold although the leader moves, or "".
        latency_s: Age of the newest reading; None if the leader does not tell.
        last: What became of the episode before, until the next one begins, or "".
    """

    state: str
    time_left_s: float | None = None
    hint: str = ""
    held: str = ""
    latency_s: float | None = None
    last: str = ""


class HandReading(NamedTuple):
    """Handles that a person drags.

    Attributes:
        Ts_world_tcp: Poses (4, 4) of the left and right handle.
        openings: Of left and right hand, 0 closed to 1 open.
        clutch: Whether the handles move without the hands.
        latency_s: Round trip to the page; None before it is measured.
    """

    Ts_world_tcp: tuple[Array, Array]
    openings: tuple[float, float]
    clutch: bool
    latency_s: float | None = None


class HandHandles:
    """Handles of both hands in a picture of the scene."""

    def place(self, Ts_world_tcp: Sequence[Array]) -> None:
        """Put the handles at the hands."""
        raise NotImplementedError

    def open(self) -> None:
        """Open both hands, and let go of the clutch."""
        raise NotImplementedError

    def read(self) -> HandReading:
        """Return where the handles are."""
        raise NotImplementedError


class Station:
    """A station without a display."""

    def show(self, status: Status) -> None:
        """Show the state of the session; called in every tick."""

    def pressed(self) -> tuple[Button, ...]:
        """Return the buttons that were pressed since the last call."""
        return ()

    def handles(self) -> HandHandles | None:
        """Return handles to drag; None where there is no picture."""
        return None


NO_STATION = Station()
