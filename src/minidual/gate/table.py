"""The table of stages: names in order, what each requires, and where its code is. Code loads on demand."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from minidual.errors import EnvironmentMissingError, unknown_name
from minidual.gate.stage import Stage
from minidual.gate.tool import ToolEntry


@dataclass(frozen=True)
class StageOption:
    """A command-line option of one stage that stands for a configuration value.

    name: as typed, without dashes ("episodes").
    path: dotted configuration path that it overrides ("teleop.episodes_n"); None for an extra that is no
        configuration and enters the fingerprint as it is.
    kind: `int`, `float` or `str`; `split` turns "a,b" into a list.
    """

    name: str
    path: str | None
    help: str
    kind: type[int] | type[float] | type[str] = int
    split: bool = False

    def value(self, typed: Any) -> Any:
        """Return the configuration value for what was typed."""
        return [word.strip() for word in str(typed).split(",") if word.strip()] if self.split else typed


@dataclass(frozen=True)
class StageEntry:
    """One row of the table.

    target: "module:ATTRIBUTE" that holds the stage, or the stage itself.
    closing: the stage that ends the pipeline; a waiver anywhere above it is a failed check in it.
    asides: what the command does instead of running the stage when one of their options is typed.
    watchable: it moves the arms and shows them to `context.view`: the command takes --view.
    """

    name: str
    target: str | Stage
    requires: tuple[str, ...]
    summary: str
    options: tuple[StageOption, ...] = ()
    closing: bool = False
    asides: tuple[ToolEntry, ...] = ()
    watchable: bool = False

    def load(self) -> Stage:
        """Return the stage; EnvironmentMissingError names a library that it needs and that is not there."""
        if not isinstance(self.target, str):
            return self.target
        module_name, _, attribute = self.target.partition(":")
        try:
            stage = cast(Stage, getattr(importlib.import_module(module_name), attribute))
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("minidual"):
                raise
            raise EnvironmentMissingError(
                f"stage {self.name} needs the library '{error.name}', which is not installed",
                remedy="install minidual with its dependencies again (`make setup` in a checkout)",
            ) from error
        if (stage.name, tuple(stage.requires)) != (self.name, self.requires):
            raise ValueError(
                f"{self.target} is stage {stage.name} requiring {stage.requires}; the table says "
                f"{self.name} requiring {self.requires}"
            )
        return stage

    def overrides(self, options: Mapping[str, Any]) -> list[tuple[str, Any, str]]:
        """Return (dotted path, value, text as typed) for those `options` that stand for configuration."""
        known = {option.name: option for option in self.options}
        return [
            (path, known[name].value(value), f"--{name} {value}")
            for name, value in options.items()
            if name in known and (path := known[name].path) is not None
        ]

    def extras(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return those `options` that are no configuration."""
        paths = {option.name: option.path for option in self.options}
        return {name: value for name, value in options.items() if paths.get(name) is None}


class StageTable:
    """Stages in the order in which they run.

    Args:
        entries: rows; names unique, and each requires only stages above it (ValueError otherwise).
        libraries: distributions whose versions are written into every verdict.
    """

    def __init__(self, entries: Sequence[StageEntry], libraries: Sequence[str] = ()) -> None:
        self._entries: dict[str, StageEntry] = {}
        self.libraries = tuple(libraries)
        for entry in entries:
            if entry.name in self._entries:
                raise ValueError(f"stage '{entry.name}' stands twice in the table")
            for name in entry.requires:
                if name not in self._entries:
                    raise ValueError(f"stage '{entry.name}' requires '{name}', which does not stand above it")
            self._entries[entry.name] = entry

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(self._entries)

    def __iter__(self) -> Iterator[StageEntry]:
        return iter(self._entries.values())

    def __getitem__(self, name: str) -> StageEntry:
        if name not in self._entries:
            raise unknown_name("stage", name, self._entries)
        return self._entries[name]

    def upstream(self, name: str) -> tuple[str, ...]:
        """Return every stage that `name` requires, directly or not, in order."""
        needed: set[str] = set()

        def visit(stage: str) -> None:
            for required in self[stage].requires:
                if required not in needed:
                    needed.add(required)
                    visit(required)

        visit(name)
        return tuple(stage for stage in self._entries if stage in needed)

    def after(self, name: str) -> str | None:
        """Return the stage that follows `name` in the table, if any."""
        names = self.names
        place = names.index(name) + 1
        return names[place] if place < len(names) else None


CommandText = Callable[[str], str]
"""Turns "plan" into the full command to type, with the profile and run flags in use."""
