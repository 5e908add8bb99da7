"""Canonical strict JSON without NaN, and hashes."""

import enum
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, cast


def canonical(value: Any, where: str = "value") -> Any:
    """Return `value` as JSON types; non-finite floats become "nan", "inf" or "-inf".

    Args:
        value: Pydantic models, mappings with string keys, sequences, sets (sorted), paths, enums,
            numpy values, and what JSON has.
        where: Name of the value in errors.

    Raises:
        TypeError: Anything else; names its place.
    """
    if isinstance(value, enum.Enum):
        value = value.value
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, Path):
        return value.as_posix()
    if hasattr(value, "model_dump"):
        return canonical(value.model_dump(mode="json"), where)
    if isinstance(value, Mapping):
        return _canonical_mapping(cast(Mapping[Any, Any], value), where)
    if isinstance(value, set | frozenset):
        return sorted(canonical(item, where) for item in cast(set[Any], value))
    if isinstance(value, list | tuple):
        items = cast(Sequence[Any], value)
        return [canonical(item, f"{where}[{index}]") for index, item in enumerate(items)]
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return canonical(value.tolist(), where)
    raise TypeError(f"{where}: {type(value).__name__} cannot be written as JSON")


def _canonical_mapping(mapping: Mapping[Any, Any], where: str) -> dict[str, Any]:
    for key in mapping:
        if not isinstance(key, str):
            raise TypeError(f"{where}: key {key!r} is not a string")
    return {key: canonical(item, f"{where}.{key}") for key, item in mapping.items()}


def digest(value: Any) -> str:
    """Return the sha256 of the canonical JSON, keys sorted."""
    text = json.dumps(canonical(value), sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def dumps(value: Any) -> str:
    """Return indented strict JSON with a final newline."""
    return json.dumps(canonical(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file, cached by inode, size, mtime and ctime."""
    stat = path.stat()
    return _sha256(path, stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)


@cache
def _sha256(path: Path, *identity: int) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
