"""Read keys from the bytes of a terminal, however they are split or merged.

A terminal sends a key such as an arrow as several bytes that begin with Escape. A slow link splits
them, and a busy machine merges keys that were pressed apart.
"""

import re

STOP = "stop"
"""Event of the emergency key. Other events are printable characters, enter and tab."""
ESCAPE_WAIT_S = 0.06
"""Time after which an Escape that nothing follows is the key itself."""
_PASTE_IDLE_S = 1.0
"""Time without bytes after which a paste has ended, even if its end got lost."""
_SEQUENCE_BYTES_MAX = 64
_MOUSE_BYTES = 3
"""Bytes after the old report of a mouse, ESC [ M."""
_ESCAPE = 0x1B
_KEPT_CONTROLS = frozenset(b"\t\r\n")
_ESCAPE_KEY = re.compile(rb"27(;\d*)*u|27;\d+;27~")
"""The Escape key of terminals that report keys by number, after ESC [."""
_PASTE_BEGINS = b"200~"
_PASTE_ENDS = b"201~"


class KeyParser:
    """Turns bytes into events. Its state outlives each read.

    Known sequences are those of cursor and function keys, of a mouse and of pastes: CSI (ESC [
    parameters letter) and SS3 (ESC O letter). They give no event. Any other Escape gives `STOP`,
    also inside a paste. Other characters of a paste give no event.
    """

    def __init__(self) -> None:
        self._sequence = bytearray()
        """Of the sequence that has begun, with its Escape; empty outside one."""
        self._mouse_left = 0
        self._pasting = False
        self._stopped = False
        """Whether the sequence that has begun gave STOP because it took too long."""
        self._last_s = float("-inf")

    def feed(self, data: bytes, now_s: float) -> list[str]:
        """Return the events of the bytes read at a time [s], which may be none: call it often."""
        events: list[str] = []
        if data:
            self._last_s = now_s
            for byte in data:
                self._take(byte, events)
        elif self._sequence and not self._stopped and now_s - self._last_s >= ESCAPE_WAIT_S:
            # What comes late still belongs to the sequence: the letter of an arrow is no key.
            self._stopped = True
            events.append(STOP)
        elif self._pasting and now_s - self._last_s >= _PASTE_IDLE_S:
            self._pasting = False
        return events

    def _take(self, byte: int, events: list[str]) -> None:
        if self._mouse_left and byte != _ESCAPE:
            self._mouse_left -= 1
        elif byte == _ESCAPE:
            self._mouse_left = 0
            if self._sequence:
                self._stop(events)
            self._sequence.append(byte)
        elif self._sequence:
            self._sequence.append(byte)
            self._end_sequence(events)
        elif not self._pasting and (0x20 <= byte < 0x7F or byte in _KEPT_CONTROLS):
            events.append(chr(byte))

    def _end_sequence(self, events: list[str]) -> None:
        """Drop the sequence if it is complete; stop if it is none."""
        introducer = self._sequence[1]
        body = bytes(self._sequence[2:])
        if introducer not in b"[O" or len(body) > _SEQUENCE_BYTES_MAX:
            self._stop(events)
            return
        if not body:
            return
        last = body[-1]
        if 0x20 <= last < 0x40:  # parameters
            return
        if not 0x40 <= last < 0x7F:
            self._stop(events)
            return
        if introducer == ord("["):
            self._end_csi(body, events)
        self._forget_sequence()

    def _end_csi(self, body: bytes, events: list[str]) -> None:
        if _ESCAPE_KEY.fullmatch(body):
            events.append(STOP)
        elif body == b"M":
            self._mouse_left = _MOUSE_BYTES
        elif body == _PASTE_BEGINS:
            self._pasting = True
        elif body == _PASTE_ENDS:
            self._pasting = False

    def _stop(self, events: list[str]) -> None:
        if not self._stopped:
            events.append(STOP)
        self._forget_sequence()

    def _forget_sequence(self) -> None:
        self._sequence.clear()
        self._stopped = False
