"""Messages between the emulator's twin port and its client; not part of the vendor's protocol.

A message is a head (kind, length of the body) and a body: JSON, or float64 for a state.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

TWIN_PORT = 1339
"""On the left controller's address, beside 1337 (arm) and 1338 (hand)."""
_HEAD = struct.Struct("<BI")
_BODY_MAX = 1 << 20


class Kind(IntEnum):
    """Kinds of message.

    SCENE asks for the scene, and answers with it. STATE asks for the state of the world. PLACE puts
    objects down. REFUSED answers a request that is not carried out, with the reason.
    """

    SCENE = 1
    STATE = 2
    PLACE = 3
    REFUSED = 4


class Message(NamedTuple):
    """One message."""

    kind: Kind
    body: bytes


class MessageError(ValueError):
    """Bytes are no messages of this protocol."""


def packed(kind: Kind, body: bytes = b"") -> bytes:
    """Return a message as bytes."""
    return _HEAD.pack(kind, len(body)) + body


class MessageReader:
    """Cuts a stream of bytes into messages."""

    def __init__(self) -> None:
        self._bytes = b""

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that are complete.

        Raises:
            MessageError: An unknown kind, or a body above 1 MiB.
        """
        self._bytes += data
        messages: list[Message] = []
        while len(self._bytes) >= _HEAD.size:
            code, length = _HEAD.unpack_from(self._bytes)
            if length > _BODY_MAX:
                raise MessageError(f"a body of {length} bytes; at most {_BODY_MAX}")
            end = _HEAD.size + length
            if len(self._bytes) < end:
                break
            try:
                kind = Kind(code)
            except ValueError as error:
                raise MessageError(f"no message of kind {code}") from error
            messages.append(Message(kind, self._bytes[_HEAD.size : end]))
            self._bytes = self._bytes[end:]
        return messages
