"""The rows of the command line: options, stages and tools. Code loads on demand."""

from __future__ import annotations

import contextlib
import importlib.metadata
import keyword
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, cast

from minidual.errors import EnvironmentMissingError, MinidualError, UsageError
from minidual.gate.code import Code, code_of
from minidual.gate.stage import StageFunction
from minidual.gate.tool import ToolFunction
from minidual.registry import Registry, load_target

if TYPE_CHECKING:
    from minidual.config.root import Config

CommandText = Callable[[str], str]
"""Turns "plan" into the full command to type, with the profile and run flags in use."""


@dataclass(frozen=True)
class Option:
    """An option of a command, or with `argument` a word that stands by itself (`minidual replay FILE`).

    Attributes:
        name: As typed, without dashes.
        help: One line.
        kind: `int`, `float`, `str` or `bool` (a flag).
        path: Dotted configuration path that it overrides; None for one that is no configuration.
        split: Turns "a,b" into a list.
        argument: Typed without a name.
        many: An argument that may be repeated; its value is a tuple.
        required: An argument that cannot be left out.
    """

    name: str
    help: str
    kind: type[int] | type[float] | type[str] | type[bool] = str
    path: str | None = None
    split: bool = False
    argument: bool = False
    many: bool = False
    required: bool = False

    @property
    def key(self) -> str:
        """Its name in Python (`from` is a keyword, so it becomes `from_`)."""
        name = self.name.replace("-", "_")
        return f"{name}_" if keyword.iskeyword(name) else name

    def value(self, typed: Any) -> Any:
        """Return the configuration value for what was typed."""
        return [word.strip() for word in str(typed).split(",") if word.strip()] if self.split else typed


@dataclass(frozen=True)
class ToolEntry:
    """A command that writes no verdict, or with `triggers` an aside of a stage's command.

    Attributes:
        name: The command, or for an aside the name of its folder ("carry-tune").
        target: "module:function", see `minidual.gate.tool`.
        summary: One line.
        options: What may be typed.
        triggers: Options any of which asks for the aside; its other options only go with those.
        watchable: It shows moving arms, so the command takes --view.
        view_default: The view without --view.
    """

    name: str
    target: str | ToolFunction
    summary: str
    options: tuple[Option, ...] = ()
    triggers: tuple[str, ...] = ()
    watchable: bool = False
    view_default: str = "none"

    def load(self) -> ToolFunction:
        """Return the function."""
        return cast(ToolFunction, _loaded(self.name, self.target))

    def is_asked_for(self, values: Mapping[str, Any]) -> bool:
        """Return whether one of its triggers was typed."""
        keys = [option.key for option in self.options if option.name in self.triggers]
        return any(values.get(key) not in (None, False) for key in keys)


@dataclass(frozen=True)
class StageEntry:
    """One stage: its name, requirements and summary stand here and nowhere else.

    Attributes:
        name: The command.
        target: "module:function", see `minidual.gate.stage`.
        requires: Stages whose passing, fresh verdicts open its gate.
        summary: One line.
        reads: Dotted configuration paths that the result depends on. A change there makes the verdict stale, so
            `workers` and cosmetic switches are left out. Seed and profile always count.
        resolve: "module:function" from Config to Config: fills in what names in the configuration stand for. It is
            called for `status` too, so its module must import quickly.
        check: "module:function" that takes the Config and raises UsageError for a name or value that the models cannot
            know to be wrong. It is called for every stage of a run before the first one begins.
        at_least, at_most: Dotted paths of counts and limits. A value that asks for less than the shipped profile is no
            acceptance.
        question: What the stage answers on the debug ladder.
        options: What may be typed.
        asides: What the command does instead of running the stage when one of their triggers is typed.
        watchable: It shows moving arms, so the command takes --view.
        closing: It ends the pipeline; a waiver anywhere above it is a failed check in it.
    """

    name: str
    target: str | StageFunction
    requires: tuple[str, ...]
    summary: str
    reads: tuple[str, ...] = ()
    resolve: str | None = None
    check: str | None = None
    at_least: tuple[str, ...] = ()
    at_most: tuple[str, ...] = ()
    question: str = ""
    options: tuple[Option, ...] = ()
    asides: tuple[ToolEntry, ...] = ()
    watchable: bool = False
    closing: bool = False

    def load(self) -> StageFunction:
        """Return the function; EnvironmentMissingError names a library that it needs and that is not there."""
        return cast(StageFunction, _loaded(self.name, self.target))

    def code(self, known: Code | None = None) -> Code:
        """Return the code that the stage reaches; `known` is what it was once, see `code_of`."""
        return code_of([target for target in (self.target, self.resolve) if isinstance(target, str)], known)

    def resolved(self, config: Config) -> Config:
        """Return the configuration that the stage runs under.

        Raises:
            UsageError: A name or value is wrong.
        """
        return config if self.resolve is None else cast("Config", _loaded(self.name, self.resolve)(config))

    def checked(self, config: Config) -> Config:
        """Return `resolved`, after asking `check`.

        Raises:
            UsageError: A name or value is wrong.
        """
        if self.check is not None:
            _loaded(self.name, self.check)(config)
        return self.resolved(config)

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return what the result depends on, nested as in the configuration."""
        with contextlib.suppress(MinidualError):  # refused before the stage runs; until then, what was typed
            config = self.resolved(config)
        found: dict[str, Any] = {}
        for path in self.reads:
            value: Any = config
            *sections, last = path.split(".")
            place = found
            for section in sections:
                value, place = getattr(value, section), place.setdefault(section, {})
            place[last] = getattr(value, last)
        return found

    def weaker(self, config: Config, reference: Config) -> tuple[str, ...]:
        """Return one line for each count or limit in `config` that asks for less than `reference`."""
        lines: list[str] = []
        for path in (*self.at_least, *self.at_most):
            value, asked = (attrgetter(path)(source) for source in (config, reference))
            if not _as_strict(value, asked, least=path in self.at_least):
                lines.append(f"{path} is {_short(value)}, the profile asks for {_short(asked)}")
        return tuple(lines)

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


def _as_strict(value: Any, asked: Any, *, least: bool) -> bool:
    """Return whether a value asks for as much as the profile's: a number, numbers by name, or names that must be there."""
    if asked is None:
        return True
    if value is None:
        return False
    if hasattr(asked, "model_dump"):
        value, asked = value.model_dump(), asked.model_dump()
    if isinstance(asked, Mapping):
        numbers = cast(Mapping[str, Any], value)
        return all(
            _as_strict(numbers.get(name), item, least=least) for name, item in cast(Mapping[str, Any], asked).items()
        )
    if isinstance(asked, tuple):
        return "all" in value or set(cast(tuple[str, ...], asked)) <= set(value)
    return value >= asked if least else value <= asked


def _short(value: Any) -> str:
    if hasattr(value, "model_dump"):
        value = value.model_dump()
    return ", ".join(cast(tuple[str, ...], value)) if isinstance(value, tuple) else str(value)


def _loaded(name: str, target: str | Callable[..., Any]) -> Callable[..., Any]:
    try:
        return load_target(target) if isinstance(target, str) else target
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("minidual"):
            raise
        raise EnvironmentMissingError(
            f"stage {name} needs the library '{error.name}', which is not installed",
            remedy="install minidual with its dependencies again (`make setup` in a checkout)",
        ) from error


class StageTable:
    """Stages in the order in which they run.

    Args:
        entries: Rows; names unique, and each requires only stages above it (ValueError otherwise).
        libraries: Distributions whose versions are written into every verdict.
    """

    def __init__(self, entries: Sequence[StageEntry], libraries: Sequence[str] = ()) -> None:
        self._entries: Registry[StageEntry] = Registry("stage")
        self.libraries = tuple(libraries)
        for entry in entries:
            self.add(entry)

    def add(self, entry: StageEntry) -> None:
        """Add a row at the end."""
        for name in entry.requires:
            if name not in self._entries:
                raise ValueError(f"stage '{entry.name}' requires '{name}', which does not stand above it")
        self._entries.add(entry.name, entry)

    def plug_in(self, group: str) -> None:
        """Add the rows that other distributions declare as entry points of `group`.

        Raises:
            UsageError: A row cannot be loaded, is not a StageEntry, or does not fit the table.
        """
        for point in importlib.metadata.entry_points(group=group):
            try:
                entry = point.load()
                if not isinstance(entry, StageEntry):
                    raise TypeError(f"{point.value} is a {type(entry).__name__}, not a StageEntry")
                self.add(entry)
            except (ImportError, AttributeError, TypeError, ValueError) as error:
                raise UsageError(
                    f"stage '{point.name}' of another distribution cannot be used: {error}",
                    remedy="mend or uninstall that distribution",
                ) from error

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(self._entries)

    def __iter__(self) -> Iterator[StageEntry]:
        return iter(self._entries.values())

    def __getitem__(self, name: str) -> StageEntry:
        return self._entries[name]

    def upstream(self, name: str) -> tuple[str, ...]:
        """Return every stage that `name` requires, directly or not, in order."""
        needed: set[str] = set()
        wanted = list(self[name].requires)
        while wanted:
            needed.add(stage := wanted.pop())
            wanted += self[stage].requires
        return tuple(stage for stage in self._entries if stage in needed)
