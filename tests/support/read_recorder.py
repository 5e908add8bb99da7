"""A configuration that records which of its values are read."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, cast

from pydantic import BaseModel

from minidual.config.root import Config


def recorded(config: Config) -> tuple[Config, set[str]]:
    """Return a copy of a configuration, and the dotted paths of the values read of it so far."""
    reads: set[str] = set()
    return cast(Config, _recording(config, "", reads)), reads


def unlisted(reads: Collection[str], listed: Collection[str]) -> list[str]:
    """Return the paths that were read and that no listed path is, or leads to."""
    return sorted(
        path
        for path in reads
        if not any(path == name or path.startswith(f"{name}.") for name in listed)
    )


def _recording(model: BaseModel, prefix: str, reads: set[str]) -> BaseModel:
    kind: Any = type(model)
    names = set(kind.model_fields)

    class Recording(kind):
        def __getattribute__(self, name: str) -> Any:
            value = super().__getattribute__(name)
            if name in names and not isinstance(value, BaseModel):
                reads.add(f"{prefix}{name}")
            return value

    values: dict[str, Any] = {}
    for name in names:
        value = getattr(model, name)
        is_section = isinstance(value, BaseModel)
        values[name] = _recording(value, f"{prefix}{name}.", reads) if is_section else value
    # With all fields set, copies with other values keep the sections that record.
    return Recording.model_construct(_fields_set=names, **values)
