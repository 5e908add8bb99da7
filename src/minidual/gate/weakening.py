"""Configured counts and limits that ask for less than a shipped profile."""

from collections.abc import Sequence
from typing import Any, Literal, cast

from minidual.config.base import limits
from minidual.config.root import Config


def weaker_values(paths: Sequence[str], config: Config, reference: Config) -> tuple[str, ...]:
    """Return a line per count or limit under `paths` that is weaker than in `reference`."""
    required = {path: value for path, _, value in limits(reference)}
    lines: list[str] = []
    for path, mark, value in limits(config):
        if not _is_under(path, paths) or _as_strict(value, required[path], mark):
            continue
        lines.append(f"{path} is {_text(value)}, the profile asks for {_text(required[path])}")
    return tuple(lines)


def _is_under(path: str, sections: Sequence[str]) -> bool:
    return any(path == section or path.startswith(f"{section}.") for section in sections)


def _as_strict(value: Any, required: Any, mark: Literal["at least", "at most"]) -> bool:
    """Return whether a value is at least as strict as the required one.

    Both are numbers, mappings of numbers or tuples of names. A tuple must contain the required
    names, or "all".
    """
    if required is None:
        return True
    if value is None:
        return False
    if isinstance(required, dict):
        limits_by_name = cast(dict[str, Any], required)
        return all(
            _as_strict(value.get(name), limit, mark) for name, limit in limits_by_name.items()
        )
    if isinstance(required, tuple):
        names = set(cast(tuple[str, ...], required))
        return "all" in value or names <= set(value)
    if mark == "at least":
        return value >= required
    return value <= required


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(cast(tuple[str, ...], value))
    return str(value)
