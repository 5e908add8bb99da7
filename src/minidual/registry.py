"""One table a family: rows by name, duplicates refused, unknown names answered with what exists.

A row's value is the thing itself or a lazy target, "module:attribute", that is imported when it is first asked for.
A family may take rows from other distributions through an entry point group; those are read at the first lookup, so a
table costs nothing until it is used.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from minidual.errors import UsageError, unknown_name


class Registry[T](Mapping[str, T]):
    """A table of one kind of thing.

    Args:
        kind: What a row is, in the singular, as messages say it ("task").
        rows: {name: value or "module:attribute"}; more with `add`.
        group: Entry point group for rows of other distributions ("minidual.tasks"), or None.

    Raises:
        ValueError: `rows` is not a mapping of distinct names.
    """

    def __init__(self, kind: str, rows: Mapping[str, T | str] | None = None, *, group: str | None = None) -> None:
        self.kind, self._group = kind, group
        self._rows: dict[str, T | str | importlib.metadata.EntryPoint] = {}
        self._plugged = group is None
        for name, value in (rows or {}).items():
            self.add(name, value)

    def add(self, name: str, value: T | str) -> None:
        """Add a row.

        Raises:
            ValueError: The name is taken.
        """
        if name in self._rows:
            raise ValueError(f"{self.kind} '{name}' stands twice in the table")
        self._rows[name] = value

    def __getitem__(self, name: str) -> T:
        """Return a row, loading it at its first use.

        Raises:
            UsageError: There is no such row, or its target cannot be loaded.
        """
        rows = self._all()
        if name not in rows:
            raise unknown_name(self.kind, name, rows)
        value = rows[name]
        if isinstance(value, importlib.metadata.EntryPoint):
            value = rows[name] = self._load(name, value.value)
        elif isinstance(value, str):
            value = rows[name] = self._load(name, value)
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __contains__(self, name: object) -> bool:
        return name in self._all()

    def _all(self) -> dict[str, Any]:
        if not self._plugged:
            self._plugged = True
            for entry in importlib.metadata.entry_points(group=cast(str, self._group)):
                if entry.name in self._rows:
                    raise UsageError(
                        f"{self.kind} '{entry.name}' of the distribution '{entry.dist and entry.dist.name}' is already "
                        f"in the table",
                        remedy="rename it there, or uninstall that distribution",
                    )
                self._rows[entry.name] = entry
        return self._rows

    def names(self, text: str | Sequence[str]) -> tuple[str, ...]:
        """Return the rows named in "a,b", or in a sequence of names.

        Raises:
            UsageError: A name is unknown or repeated, or there is none.
        """
        names = [n.strip() for n in (text.split(",") if isinstance(text, str) else text) if n.strip()]
        if not names:
            raise UsageError(f"no {self.kind} named", remedy=f"name some of {', '.join(self)}")
        for name in names:
            if name not in self:
                raise unknown_name(self.kind, name, self)
            if names.count(name) > 1:
                raise UsageError(f"{self.kind} '{name}' is named twice in {', '.join(names)}")
        return tuple(names)

    def _load(self, name: str, target: str) -> T:
        try:
            return cast(T, load_target(target))
        except (ImportError, AttributeError) as error:
            raise UsageError(f"{self.kind} '{name}' cannot be loaded from {target}: {error}") from error


def load_target(target: str) -> Any:
    """Import the attribute that "module:attribute" names.

    Raises:
        ImportError: There is no such module.
        AttributeError: The module has no such attribute.
    """
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
