"""Messages of policy servers: arrays survive, and what is no message is refused."""

from __future__ import annotations

import sys

import msgpack
import numpy as np
import pytest

from minidual.errors import DataError, EnvironmentMissingError
from minidual.policies.messages import hello_of, pack, unpack

HELLO = {"protocol": 1, "dim": 16, "chunk_size": 25, "cameras": {"high": [96, 128]}}


def test_arrays_of_all_kinds_survive() -> None:
    message = {
        "state": np.arange(16, dtype=np.float32),
        "images": {"high": np.full((4, 5, 3), 7, np.uint8)},
        "reset": True,
        "count": np.int64(3),
    }
    back = unpack(pack(message))
    np.testing.assert_array_equal(back["state"], message["state"])
    assert back["images"]["high"].shape == (4, 5, 3)
    assert back["images"]["high"].dtype == np.uint8
    assert back["reset"] is True
    assert back["count"] == 3


def test_the_form_of_openpi_is_read() -> None:
    """Its keys are bytes."""
    array = {b"__ndarray__": True, b"data": b"\x00\x00\x80?", b"dtype": "<f4", b"shape": (1,)}
    assert unpack(msgpack.packb({"actions": array}))["actions"] == [1.0]


@pytest.mark.parametrize(
    "data",
    [
        b"\xc1",
        msgpack.packb([1, 2]),
        msgpack.packb(
            {"a": {"__ndarray__": True, "data": b"", "dtype": "|O8", "shape": [1]}},
        ),
        msgpack.packb(
            {"a": {"__ndarray__": True, "data": b"1234", "dtype": "<f4", "shape": [2]}},
        ),
        msgpack.packb(
            {"a": {"__ndarray__": True, "data": b"", "dtype": "<f4", "shape": [-1]}},
        ),
    ],
)
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(DataError, match="a message of the policy server"):
        unpack(data)


def test_objects_do_not_leave() -> None:
    with pytest.raises(TypeError, match="cannot hold a PosixPath"):
        pack({"path": __import__("pathlib").Path("/")})


def test_a_first_message_describes_a_policy() -> None:
    hello = hello_of(pack({**HELLO, "weights": "12 GB"}))
    assert hello.cameras == {"high": (96, 128)}
    assert hello.units == "rad"
    assert hello.rate_hz is None


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"protocol": 2}, "protocol"),
        ({"dim": 0}, "dim"),
        ({"units": "turns"}, "units"),
        ({"cameras": {"high": [96]}}, "cameras.high"),
    ],
)
def test_a_wrong_first_message_names_its_key(change: dict[str, object], fault: str) -> None:
    with pytest.raises(DataError, match=rf"does not describe its policy: {fault}"):
        hello_of(pack({**HELLO, **change}))


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "msgpack", None)
    with pytest.raises(EnvironmentMissingError, match=r"(?s)needs the library 'msgpack'.*server"):
        pack({})
