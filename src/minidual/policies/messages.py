"""Messages between minidual and a policy server: msgpack, with arrays (docs/lerobot.md).

An array is a map of `__ndarray__` (true), `data` (bytes in C order), `dtype` (such as "<f4" or "|u1")
and `shape`. Source of this form: the package openpi-client, whose servers use it too.
"""

from collections.abc import Mapping
from types import ModuleType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from minidual.errors import DataError, EnvironmentMissingError

VERSION = 1
_MARK = "__ndarray__"
_KINDS = "buif"
_ELEMENTS_MAX = 2**26
_Size = Annotated[int, Field(ge=1, le=4096)]


class Hello(BaseModel):
    """Description of its policy that a server sends on connection. Further keys are ignored.

    Attributes:
        protocol: Version of the messages.
        name: Of the policy, for tables and messages.
        cameras: {camera: (height, width)} of the pictures that it reads.
        dim: Numbers of a state and of an action: joints, then openings.
        inputs: {signal: entries} that the state is to hold behind them.
        chunk_size: Actions of an answer.
        names: Of these numbers; null: not told.
        rate_hz: Of its actions; null: not told.
        units: Of its joints.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    protocol: Literal[1] = VERSION
    name: str = Field(default="policy server", max_length=200)
    cameras: dict[str, tuple[_Size, _Size]] = Field(default={}, max_length=16)
    dim: _Size
    inputs: dict[str, _Size] = Field(default={}, max_length=16)
    chunk_size: Annotated[int, Field(ge=1, le=10_000)]
    names: tuple[str, ...] | None = Field(default=None, max_length=4096)
    rate_hz: Annotated[float | None, Field(gt=0.0, le=1e4)] = None
    units: Literal["rad", "deg"] = "rad"


def msgpack_module() -> ModuleType:
    """Return the library msgpack.

    Raises:
        EnvironmentMissingError: It is not installed.
    """
    try:
        import msgpack
    except ModuleNotFoundError as error:
        raise EnvironmentMissingError(
            "a policy server needs the library 'msgpack', which is not installed",
            remedy="pip install 'minidual[server]'",
        ) from error
    return msgpack


def pack(message: Mapping[str, Any]) -> bytes:
    """Return a message as bytes; arrays may be anywhere in it."""
    return msgpack_module().packb(dict(message), default=_plain)


def unpack(data: bytes) -> dict[str, Any]:
    """Return a message.

    Raises:
        DataError: It is no map, or an array in it is damaged.
    """
    try:
        message = msgpack_module().unpackb(data, object_hook=_array, strict_map_key=False)
    except EnvironmentMissingError:
        raise
    except Exception as error:  # the library and NumPy raise various types
        raise DataError(f"a message of the policy server cannot be read: {error}") from error
    if not isinstance(message, dict):
        raise DataError(
            f"a message of the policy server is a {type(message).__name__}; it must be a map",
        )
    return message


def hello_of(data: bytes) -> Hello:
    """Return a server's description of its policy.

    Raises:
        DataError: A key is missing or wrong.
    """
    try:
        return Hello.model_validate(unpack(data))
    except ValidationError as error:
        faults = "; ".join(
            f"{'.'.join(map(str, fault['loc'])) or 'message'}: {fault['msg']}"
            for fault in error.errors()
        )
        raise DataError(
            f"the first message of the policy server does not describe its policy: {faults}",
            remedy="docs/lerobot.md has the keys; examples/policy_server.py is a server",
        ) from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
        return {
            _MARK: True,
            "data": np.ascontiguousarray(value).tobytes(),
            "dtype": value.dtype.str,
            "shape": list(value.shape),
        }
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a message cannot hold a {type(value).__name__}")


def _array(mapping: dict[Any, Any]) -> Any:
    """Return the array that a map stands for, or the map; openpi's keys are bytes."""
    named = {
        key.decode("utf-8", "replace") if isinstance(key, bytes) else key: value
        for key, value in mapping.items()
    }
    if _MARK not in named:
        return mapping
    text = named["dtype"]
    dtype = np.dtype(text.decode() if isinstance(text, bytes) else text)
    if dtype.kind not in _KINDS:
        raise ValueError(f"an array of {dtype} is refused")
    shape = tuple(int(size) for size in named["shape"])
    if any(size < 0 for size in shape) or int(np.prod(shape, dtype=float)) > _ELEMENTS_MAX:
        raise ValueError(f"an array of shape {shape} is refused")
    return np.frombuffer(named["data"], dtype=dtype).reshape(shape).copy()
