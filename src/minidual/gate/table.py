"""Rows of the command line: options, stages, tools. Code is imported on demand."""

import contextlib
import importlib.metadata
import keyword
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, cast

from minidual.config.base import limits
from minidual.config.loader import Override
from minidual.config.root import Config
from minidual.errors import EnvironmentMissingError, MinidualError, UsageError
from minidual.gate.fingerprint import Code, code_of
from minidual.gate.stage import StageFunction, ToolFunction
from minidual.registry import Registry, load_target


class Option(NamedTuple):
    """Option of a command.

    Attributes:
        kind: Type; `bool` is a flag, `tuple` is typed "a,b".
        path: Configuration path that it overrides, or None.
        argument: Positional (`minidual replay FILE`); required unless `optional`.
    """

    name: str
    help: str
    kind: type[int | float | str | bool | Path | tuple[str, ...]] = str
    path: str | None = None
    argument: bool = False
    optional: bool = False
    metavar: str | None = None

    @property
    def key(self) -> str:
        """Python name; keywords get a trailing underscore."""
        name = self.name.replace("-", "_")
        return f"{name}_" if keyword.iskeyword(name) else name


_KINDS = {kind.__name__: kind for kind in (bool, int, float, str, tuple, Path)}


def options_of(rows: Mapping[str, Mapping[str, Any]]) -> tuple[Option, ...]:
    """Return the options of {name: fields}; `kind` by name."""
    fields: dict[str, dict[str, Any]] = {
        k: {**row, "kind": _KINDS[row.get("kind", "str")]} for k, row in rows.items()
    }
    return tuple(Option(name, **row) for name, row in fields.items())


def overrides(options: Sequence[Option], values: Mapping[str, Any]) -> list[Override]:
    """Return the configuration overrides of options with a path."""
    found: list[Override] = []
    for option in options:
        value = typed = values.get(option.name)
        if option.path is not None and typed is not None:
            if option.kind is tuple:
                value = [word.strip() for word in str(typed).split(",") if word.strip()]
            found.append(Override(option.path, value, f"--{option.name} {typed}"))
    return found


@dataclass(frozen=True)
class _Entry[F: Callable[..., Any]]:
    """A command.

    Attributes:
        name: Command, or an aside's output folder.
        target: "module:function", see `minidual.gate.stage`.
        examples: For --help, such as "carry --trials 50".
    """

    name: str
    target: str | F
    _: KW_ONLY
    options: tuple[Option, ...] = ()
    watchable: bool = False
    examples: tuple[str, ...] = ()

    def load(self) -> F:
        """Return the function; EnvironmentMissingError names a missing library."""
        return cast(F, _loaded(self.name, self.target))


@dataclass(frozen=True)
class ToolEntry(_Entry[ToolFunction]):
    """A command without verdict. As an aside of a stage it runs instead when its first option, `trigger`, is typed."""

    summary: str = ""
    moves: bool = False
    shared: bool = False
    """Whether several may work in one run at a time: they write nothing there."""
    view_default: str = "none"

    @property
    def trigger(self) -> str:
        """Option that selects an aside, one word."""
        return self.options[0].name


@dataclass(frozen=True)
class StageEntry(_Entry[StageFunction]):
    """One stage.

    Attributes:
        reads: Configuration paths that the result depends on.
        resolve: "module:function" from Config to Config; must import quickly.
        check: "module:function" that raises UsageError before a run.
        asides: Tools that run instead when triggered.
        keeps: Names in its folder that an attempt takes over from an interrupted one. If any, a replaced result is set
            aside.
        closing: Also checks waivers and code changes.
    """

    requires: tuple[str, ...]
    summary: str
    reads: tuple[str, ...] = ()
    resolve: str | None = None
    check: str | None = None
    asides: tuple[ToolEntry, ...] = ()
    keeps: tuple[str, ...] = ()
    closing: bool = False

    def code(self, known: Code | None = None) -> Code:
        """Return the code that the stage reaches; see `code_of`."""
        return code_of(
            [target for target in (self.target, self.resolve) if isinstance(target, str)],
            known,
        )

    def resolved(self, config: Config, *, checked: bool = False) -> Config:
        """Return the resolved configuration; `checked` runs `check` first.

        Raises:
            UsageError: A name or value is wrong.
        """
        if self.check is not None and checked:
            _loaded(self.name, self.check)(config)
        return (
            config
            if self.resolve is None
            else cast(Config, _loaded(self.name, self.resolve)(config))
        )

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return {path: value} of `reads`."""
        with contextlib.suppress(
            MinidualError,
        ):  # refused before the stage runs; until then, what was typed
            config = self.resolved(config)
        return {path: attrgetter(path)(config) for path in self.reads}

    def weaker(self, config: Config, reference: Config) -> tuple[str, ...]:
        """Return a line per count or limit in `reads` that is weaker than in `reference`."""
        asked = {path: value for path, _, value in limits(reference)}
        return tuple(
            f"{path} is {_short(value)}, the profile asks for {_short(asked[path])}"
            for path, mark, value in limits(config)
            if any(path == read or path.startswith(f"{read}.") for read in self.reads)
            and not _as_strict(value, asked[path], mark)
        )

    def extras(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return `options` outside the configuration."""
        paths = {option.name: option.path for option in self.options}
        return {name: value for name, value in options.items() if paths.get(name) is None}


def _as_strict(value: Any, asked: Any, mark: str) -> bool:
    """Return whether a number, mapping of numbers or tuple of names is at least as strict as asked."""
    if asked is None:
        return True
    if value is None:
        return False
    if isinstance(asked, dict):
        return all(
            _as_strict(value.get(name), item, mark)
            for name, item in cast(dict[str, Any], asked).items()
        )
    if isinstance(asked, tuple):
        return "all" in value or set(cast(tuple[str, ...], asked)) <= set(value)
    return value >= asked if mark == "at least" else value <= asked


def _short(value: Any) -> str:
    return ", ".join(cast(tuple[str, ...], value)) if isinstance(value, tuple) else str(value)


def _loaded(name: str, target: str | Callable[..., Any]) -> Callable[..., Any]:
    try:
        return load_target(target) if isinstance(target, str) else target
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("minidual"):
            raise
        remedy = "install minidual with its dependencies again (`make setup` in a checkout)"
        what = f"{name} needs the library '{error.name}', which is not installed"
        raise EnvironmentMissingError(what, remedy=remedy) from error


class StageTable(Registry[StageEntry]):
    """Stages in run order.

    Args:
        entries: Unique names; each requires only earlier ones (else ValueError).
        libraries: Distributions whose versions verdicts record.
    """

    def __init__(self, entries: Sequence[StageEntry], libraries: Sequence[str] = ()) -> None:
        super().__init__("stage")
        self.libraries = tuple(libraries)
        for entry in entries:
            self.append(entry)

    def append(self, entry: StageEntry) -> None:
        """Append a row."""
        for name in entry.requires:
            if name not in self:
                raise ValueError(
                    f"stage '{entry.name}' requires '{name}', which does not stand above it",
                )
        self.add(entry.name, entry)

    def plug_in(self, group: str) -> None:
        """Add rows from entry points.

        Raises:
            UsageError: A row cannot be imported or added, or is no StageEntry.
        """
        for point in importlib.metadata.entry_points(group=group):
            try:
                entry = point.load()
                if not isinstance(entry, StageEntry):
                    raise TypeError(f"{point.value} is a {type(entry).__name__}, not a StageEntry")
                self.append(entry)
            except (ImportError, AttributeError, TypeError, ValueError) as error:
                what = f"stage '{point.name}' of another distribution cannot be used: {error}"
                raise UsageError(what, remedy="mend or uninstall that distribution") from error

    def until(self, last: str | None) -> tuple[str, ...]:
        """Return `last` and its upstream stages, or all, in order."""
        return tuple(self) if last is None else (*self.upstream(last), last)

    def upstream(self, name: str) -> tuple[str, ...]:
        """Return the stages that `name` requires, directly or not, in order."""
        needed: set[str] = set()
        wanted = list(self[name].requires)
        while wanted:
            needed.add(stage := wanted.pop())
            wanted += self[stage].requires
        return tuple(stage for stage in self if stage in needed)
