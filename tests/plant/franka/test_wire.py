"""The wire format: sizes of the structures, and how streams of bytes are cut into requests."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.plant.franka import wire


@pytest.mark.parametrize(
    ("layout", "size"),
    [
        (wire.ARM_HEADER, 12),
        (wire.HAND_HEADER, 10),
        (wire.CONNECT, 4),
        (wire.MOVE, 56),
        (wire.COLLISION_BEHAVIOR, 416),
        (wire.LOAD, 104),
        (wire.ARM_COMMAND, 371),
        (wire.HAND_GRASP, 40),
        (wire.HAND_STATE, 23),
    ],
)
def test_structures_have_no_padding(layout: np.dtype, size: int) -> None:
    assert layout.itemsize == size


def test_a_state_is_as_long_as_the_client_expects() -> None:
    """The client refuses a state of another length; test_client.py shows that it takes this one."""
    floats = sum(
        int(np.prod(wire.ARM_STATE[name].shape))
        for name in wire.ARM_STATE.names
        if wire.ARM_STATE[name].base == np.dtype("<f4")
    )
    assert wire.ARM_STATE.itemsize == 8 + 4 * floats + 2 + 41 + 41 + 1


def test_requests_may_come_in_pieces_and_together() -> None:
    one = wire.answer(wire.ARM_HEADER, wire.ArmCommand.STOP_MOVE, 7, b"")
    two = wire.answer(wire.ARM_HEADER, wire.ArmCommand.MOVE, 8, b"abc")
    reader = wire.RequestReader(wire.ARM_HEADER)
    assert reader.feed(one[:5]) == []
    assert reader.feed(one[5:] + two) == [
        wire.Request(wire.ArmCommand.STOP_MOVE, 7, b""),
        wire.Request(wire.ArmCommand.MOVE, 8, b"abc"),
    ]


@pytest.mark.parametrize("size", [3, 1 << 24])
def test_a_message_of_an_impossible_size_is_refused(size: int) -> None:
    head = np.zeros((), wire.ARM_HEADER)
    head["size"] = size
    with pytest.raises(wire.WireError, match=f"{size} bytes"):
        wire.RequestReader(wire.ARM_HEADER).feed(head.tobytes())


def test_a_payload_that_is_too_short_is_refused() -> None:
    with pytest.raises(wire.WireError, match="3 bytes where 4 are needed"):
        wire.parse(b"abc", wire.CONNECT)
