"""The keys of a terminal, one of which is the emergency stop."""

import os
import select
import termios
import time
import tty

from minidual import emergency
from minidual.demos.leaders.keys import STOP, KeyParser
from minidual.demos.station import Button
from minidual.errors import EnvironmentMissingError

BUTTON_KEYS = {
    "\n": (Button.START, Button.SUCCESS),
    "\r": (Button.START, Button.SUCCESS),
    "b": (Button.FAILURE,),
    "u": (Button.DISCARD,),
    "n": (Button.NEXT,),
    "p": (Button.PAUSE,),
    "o": (Button.CORRECT,),
}
"""Enter starts an episode that waits, and ends one that runs."""
BUTTON_KEYS_USAGE = (
    "keys: enter starts, and ends with success  b failure  u again from the start  n next  "
    "p pause  o take over from a policy, hand back  x or escape EMERGENCY STOP"
)
_STOP_KEY = "x"
_BYTES_MAX = 4096


class Terminal:
    """Reads keys without waiting for enter, until it is closed.

    Args:
        descriptor: Of the terminal.
        who: Subject of the error without one.

    Raises:
        EnvironmentMissingError: The descriptor is not a terminal.
    """

    def __init__(self, descriptor: int, who: str) -> None:
        if not os.isatty(descriptor):
            raise EnvironmentMissingError(
                f"{who} needs a terminal, and standard input is not one",
                remedy="run it in a terminal, or let the scripted operator lead: "
                "--set teleop.leader=scripted",
            )
        self._descriptor = descriptor
        self._saved = termios.tcgetattr(descriptor)
        self._parser = KeyParser()
        self.is_gone = False
        tty.setcbreak(descriptor)

    def read_keys(self) -> list[str]:
        """Return the keys pressed since the last call; the emergency keys stop the arms."""
        events = self._parser.feed(self._bytes(), time.monotonic())
        if any(event == STOP or event.lower() == _STOP_KEY for event in events):
            emergency.press("key of the keyboard")
            return []
        return events

    def _bytes(self) -> bytes:
        if self.is_gone:
            return b""
        readable, _, _ = select.select([self._descriptor], [], [], 0.0)
        if not readable:
            return b""
        try:
            data = os.read(self._descriptor, _BYTES_MAX)
        except OSError:
            data = b""
        self.is_gone = not data
        return data

    def close(self) -> None:
        """Give the terminal back as it was."""
        if not self.is_gone:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._saved)
