"""Tables of named things.

A value is the thing or its target "module:attribute", imported at first use. Entry points are read
at the first lookup.
"""

import dis
import importlib
import importlib.metadata
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml

from minidual.errors import UsageError, check_name


class Registry[T](Mapping[str, T]):
    """Table of one kind of thing.

    Args:
        kind: Singular noun for messages ("task").
        rows: {name: value or "module:attribute"}.
        group: Entry point group of further rows ("minidual.tasks"), or None.
    """

    def __init__(
        self,
        kind: str,
        rows: Mapping[str, T | str] | None = None,
        *,
        group: str | None = None,
    ) -> None:
        self.kind = kind
        self._group = group
        self._rows: dict[str, T | str] = dict(rows or {})
        self._plugged = group is None

    def add(self, name: str, value: T | str) -> None:
        """Add a row.

        Raises:
            ValueError: The name is taken.
        """
        if name in self._rows:
            raise ValueError(f"{self.kind} '{name}' is in the table already")
        self._rows[name] = value

    def __getitem__(self, name: str) -> T:
        """Return a value, imported at first use.

        Raises:
            UsageError: Unknown name, or it cannot be imported.
        """
        rows = self._all()
        check_name(self.kind, name, rows)
        value = rows[name]
        if isinstance(value, str):
            try:
                value = rows[name] = load_target(value)
            except Exception as error:  # another distribution's module raises anything
                reason = f"{type(error).__name__}: {error}"
                raise UsageError(
                    f"{self.kind} '{name}' cannot be loaded from {value}: {reason}",
                ) from error
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
                    distribution = None if entry.dist is None else entry.dist.name
                    raise UsageError(
                        f"{self.kind} '{entry.name}' of the distribution '{distribution}' "
                        "is already in the table",
                        remedy="rename it there, or uninstall that distribution",
                    )
                self._rows[entry.name] = entry.value
        return self._rows

    def names(self, text: str | Sequence[str]) -> tuple[str, ...]:
        """Return the names in "a,b" or a sequence.

        Raises:
            UsageError: Unknown, repeated or no name.
        """
        words = text.split(",") if isinstance(text, str) else text
        names = [word.strip() for word in words if word.strip()]
        if not names:
            raise UsageError(f"no {self.kind} named", remedy=f"name some of {', '.join(self)}")
        for name in names:
            check_name(self.kind, name, self)
            if names.count(name) > 1:
                raise UsageError(f"{self.kind} '{name}' is named twice in {', '.join(names)}")
        return tuple(names)


@dataclass(frozen=True)
class Deferred[T]:
    """Something that is imported when it is first used.

    A decorator of the function that imports it, so that type checkers and searches see what is used.

    Attributes:
        load: Imports the thing and returns it.
    """

    load: Callable[[], T]

    @property
    def modules(self) -> tuple[str, ...]:
        """Names of the modules that `load` imports from; nothing is imported to find out."""
        return tuple(
            instruction.argval
            for instruction in dis.get_instructions(self.load)
            if instruction.opname == "IMPORT_NAME"
        )


def load_target(target: str) -> Any:
    """Import the attribute named by "module:attribute".

    Raises:
        ImportError, AttributeError: There is none.
    """
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)


def rows_beside(module_file: str, name: str = "") -> Any:
    """Return the YAML beside a module, by default of its name."""
    path = Path(module_file)
    text = (path.parent / (name or f"{path.stem}.yaml")).read_text(encoding="utf-8")
    # The compiled loader is ten times faster.
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
