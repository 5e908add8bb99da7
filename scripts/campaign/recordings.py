"""Recordings for `replay`, with every array and header field changed, and their bytes broken."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from minidual.errors import ExitCode
from scripts.campaign.case import Case, Place, Result, command, has_escapes, judge
from scripts.campaign.tampering import BYTE_CHANGES, Change
from scripts.campaign.values import Where, dotted, replace

REFUSED = (ExitCode.USAGE, ExitCode.ENVIRONMENT, ExitCode.NOTHING_EVALUATED)
_RECORDING = "carry/worst.npz"
_LIMIT_S = 25.0
_WORDS = ("--to-s", "0.2", "--json")
"""One check point lies in this stretch; a whole replay would take seconds."""
_HEADER_DEPTH = 3

ArrayChange = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def _one(value: float) -> ArrayChange:
    """Return a change that replaces one random element."""

    def change(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        stays_integer = array.dtype == np.int64 and np.isfinite(value)
        changed = np.array(array, dtype=None if stays_integer else float)
        if changed.size:
            index = int(rng.integers(changed.size))
            with np.errstate(all="ignore"):
                if changed.dtype == float:
                    changed.flat[index] = value
                else:
                    changed.flat[index] = int(np.clip(value, -9e18, 9e18))
        return changed

    return change


def _one_more(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    first = array.flat[0] if array.size else -1
    return _one(first + 1)(array, rng)


def _empty(array: np.ndarray, _rng: np.random.Generator) -> np.ndarray:
    return array[:0] if array.ndim else np.empty(0)


def _half(array: np.ndarray, _rng: np.random.Generator) -> np.ndarray:
    return array[: len(array) // 2] if array.ndim else array


def _big_endian(array: np.ndarray, _rng: np.random.Generator) -> np.ndarray:
    swapped = array.astype(array.dtype.newbyteorder(">"))
    return swapped + np.ones((), array.dtype)


ARRAY_CHANGES: dict[str, ArrayChange] = {
    "NaN": _one(np.nan),
    "inf": _one(np.inf),
    "huge": _one(1e300),
    "tiny": _one(1e-300),
    "negative": _one(-7),
    "zero": _one(0),
    "nine": _one(9),
    "one more": _one_more,
    "all NaN": lambda array, _rng: np.full(array.shape, np.nan),
    "empty": _empty,
    "half": _half,
    "transposed": lambda array, _rng: array.T,
    "deeper": lambda array, _rng: array[None],
    "scalar": lambda _array, _rng: np.array(1.0),
    "text": lambda _array, _rng: np.array("text"),
    "complex": lambda array, _rng: array.astype(complex),
    "bool": lambda array, _rng: array.astype(bool),
    "integer": lambda array, _rng: np.nan_to_num(array).astype(np.int64),
    "big-endian": _big_endian,
}
HEADER_CHANGES: dict[str, Any] = {
    "null": None,
    "number": -1e300,
    "text": "\x1b]0;owned\x07\x1b[2J\u202e",
    "list": [1],
    "object": {"a": {}},
    "true": True,
    "long": "x" * 100_000,
}
_FILES = ("pickle", "bomb", "sparse", "empty zip", "wrong suffix")


def warm(place: Place) -> None:
    """Load what a replay needs."""
    _replay(place, place.source / _RECORDING, Result())


def recording_cases(source: Path) -> Iterator[Case]:
    """Every array and header field of a recording in every strange form, and its bytes broken."""
    arrays = _arrays(source)
    for name in arrays:
        changes = ARRAY_CHANGES if name != "header" else ()
        for change in changes:
            yield Case(f"{name} {change}", partial(_array, name, change), _LIMIT_S)
        yield Case(f"{name} missing", partial(_array, name, ""), _LIMIT_S)
    for where in _header_places(_header_of(arrays)):
        for change in HEADER_CHANGES:
            body = partial(_header, where, change)
            yield Case(f"header {dotted(where)} {change}", body, _LIMIT_S)
    for change in BYTE_CHANGES:
        for number in range(6):
            yield Case(f"bytes {change.__name__} {number}", partial(_bytes, change), _LIMIT_S)
    for name in _FILES:
        yield Case(f"file {name}", partial(_file, name), _LIMIT_S)


def _arrays(source: Path) -> dict[str, Any]:
    with np.load(source / _RECORDING, allow_pickle=False) as stored:
        return dict(stored)


def _header_of(arrays: dict[str, Any]) -> Any:
    return json.loads(arrays["header"].tobytes())


def _header_places(value: Any, where: Where = ()) -> Iterator[Where]:
    """Yield the places of values in nested mappings, down to three levels."""
    if where:
        yield where
    if isinstance(value, dict) and len(where) < _HEADER_DEPTH:
        for key, inner in value.items():
            yield from _header_places(inner, (*where, key))


def _replay(place: Place, path: Path, result: Result, *, changes_physics: bool = False) -> None:
    ran = command(place, "replay", str(path), *_WORDS, "--runs-dir", str(place.no_runs))
    judge(result, "replay", ran, [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED, *REFUSED])
    if ran.code == ExitCode.PASS and changes_physics:
        result.forbidden.append("a silent pass: changed physics is replayed as if it were recorded")
    if has_escapes(ran.err):
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if ran.code == ExitCode.PASS:
        result.saw("passes")
    elif ran.code == ExitCode.ACCEPTANCE_FAILED:
        result.saw("does not repeat")
    else:
        result.saw("refused")


def _array(name: str, change: str, place: Place, result: Result) -> None:
    """Replay with an array changed, or without it."""
    arrays = _arrays(place.source)
    original = arrays.pop(name)
    is_same = False
    if change:
        changed = ARRAY_CHANGES[change](original, place.rng)
        arrays[name] = changed
        is_same = (
            changed.shape == original.shape
            and changed.dtype.kind in "fi"
            and np.array_equal(changed, original)
        )
    path = place.folder / "case.npz"
    np.savez(path, **arrays)
    # What lies behind the replayed stretch is not looked at; the model and the first state are.
    _replay(place, path, result, changes_physics=name.startswith("model.") and not is_same)


def _header(where: Where, change: str, place: Place, result: Result) -> None:
    """Replay with a field of the header changed."""
    arrays = _arrays(place.source)
    header = _header_of(arrays)
    replace(header, where, HEADER_CHANGES[change])
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    path = place.folder / "case.npz"
    np.savez(path, **arrays)
    _replay(place, path, result)
    as_text = ("replay", str(path), "--to-s", "0.05", "--runs-dir", str(place.no_runs))
    ran = command(place, *as_text)
    if has_escapes(ran.out + ran.err):
        result.forbidden.append("an escape sequence of the file reaches the terminal")


def _bytes(change: Change, place: Place, result: Result) -> None:
    path = place.folder / "case.npz"
    shutil.copy(place.source / _RECORDING, path)
    change(path, place.rng)
    _replay(place, path, result)


def _file(name: str, place: Place, result: Result) -> None:
    """Replay a file that is no recording."""
    path = place.folder / "case.npz"
    match name:
        case "pickle":
            arrays = _arrays(place.source)
            arrays["controls"] = np.array([{"a": 1}], dtype=object)
            np.savez(path, **arrays)
        case "bomb":
            _write_bomb(path)
        case "sparse":
            with path.open("wb") as stream:
                stream.truncate(1 << 40)
        case "empty zip":
            zipfile.ZipFile(path, "w").close()
        case _:
            path.write_text("hello")
    _replay(place, path, result)


def _write_bomb(path: Path) -> None:
    """Write an archive whose array claims 2^40 rows."""
    header = {"descr": "<f8", "fortran_order": False, "shape": (1 << 40, 16)}
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("controls.npy", "w") as stream,
    ):
        np.lib.format.write_array_header_1_0(stream, header)
        stream.write(bytes(1 << 20))
