"""Which parameter names and types the programs of ROS 2 read; the table is ros2_names.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

TABLE: dict[str, Any] = yaml.safe_load(
    Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"),
)
_KINDS = {
    "bool": lambda value: isinstance(value, bool),
    "int": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "double": lambda value: isinstance(value, float),
    "string": lambda value: isinstance(value, str),
    "string_array": lambda value: (
        isinstance(value, list) and all(isinstance(word, str) for word in value)
    ),
    "any": lambda value: isinstance(value, (bool, int, float, str)),
}
"""A parameter of type double refuses an integer."""


def leaves(document: dict[str, Any], path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """Return {path: value} of a document; a list is a value."""
    found: dict[tuple[str, ...], Any] = {}
    for key, value in document.items():
        if isinstance(value, dict):
            found |= leaves(value, (*path, key))
        else:
            found[(*path, key)] = value
    return found


def wrong_names(document: dict[str, Any], names: dict[str, str]) -> list[str]:
    """Return the parameters that nobody reads, or that have the wrong type."""
    wrong = []
    for path, value in leaves(document).items():
        kinds = [
            kind
            for pattern, kind in names.items()
            if len(pattern.split(".")) == len(path)
            and all(a in ("*", b) for a, b in zip(pattern.split("."), path, strict=True))
        ]
        if not any(_KINDS[kind](value) for kind in kinds):
            wrong.append(f"{'.'.join(path)} = {value!r}")
    return wrong


def plugin_names(document: Any) -> set[str]:
    """Return every word of a document that looks like package/Class."""
    if isinstance(document, dict):
        return set().union(*map(plugin_names, document.values()), set())
    if isinstance(document, list):
        return set().union(*map(plugin_names, document), set())
    if not isinstance(document, str):
        return set()
    words = document.split()
    return {
        word for word in words if word.count("/") == 1 and word.rpartition("/")[2][:1].isupper()
    }
