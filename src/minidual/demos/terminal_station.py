"""Stations in a terminal: lines that tell, and keys that are buttons."""

import time
from collections.abc import Callable, Sequence

from minidual.demos.leaders.terminal import BUTTON_KEYS, Terminal
from minidual.demos.station import Button, HandHandles, Station, Status

_WARN_S = (60, 30, 10, 5)
"""Remaining times that are announced."""
_HOLD_S = 0.5
"""Least time between two lines about the same episode."""


class LineStation(Station):
    """Prints a line for each change."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._told: tuple[str, str, str] | None = None
        self._told_at_s = float("-inf")
        self._warned: set[int] = set()

    def show(self, status: Status) -> None:
        """Say a new state, hint or reason to hold, and how much time is left."""
        self._warn(status.time_left_s)
        now_s = time.monotonic()
        news = (status.state, status.hint, status.held)
        state_changed = self._told is None or self._told[0] != status.state
        if news == self._told or (now_s - self._told_at_s < _HOLD_S and not state_changed):
            return
        self._told = news
        self._told_at_s = now_s
        parts = [status.state]
        if status.hint:
            parts.append(status.hint)
        if status.held and status.time_left_s is not None:
            parts.append(f"the arms hold: {status.held}")
        self._say("; ".join(parts))

    def _warn(self, time_left_s: float | None) -> None:
        if time_left_s is None:
            self._warned.clear()
            return
        for limit_s in _WARN_S:
            if limit_s - 1.0 < time_left_s <= limit_s and limit_s not in self._warned:
                self._warned.add(limit_s)
                self._say(f"{limit_s} s left")


class KeyStation(Station):
    """The buttons of leaders without buttons: keys of the terminal."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def pressed(self) -> tuple[Button, ...]:
        """Return the buttons that keys are; others do nothing."""
        pressed: list[Button] = []
        for key in self._terminal.read_keys():
            pressed += BUTTON_KEYS.get(key.lower(), ())
        return tuple(pressed)

    def close(self) -> None:
        """Give the terminal back."""
        self._terminal.close()


class Stations(Station):
    """Several stations at once."""

    def __init__(self, stations: Sequence[Station]) -> None:
        self._stations = tuple(stations)

    def show(self, status: Status) -> None:
        """Show it at each."""
        for station in self._stations:
            station.show(status)

    def pressed(self) -> tuple[Button, ...]:
        """Return the buttons of all."""
        pressed: list[Button] = []
        for station in self._stations:
            pressed += station.pressed()
        return tuple(pressed)

    def handles(self) -> HandHandles | None:
        """Return the first handles."""
        for station in self._stations:
            handles = station.handles()
            if handles is not None:
                return handles
        return None
