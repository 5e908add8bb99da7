"""Rows of stages and tools. Their code is imported on demand."""

import contextlib
import importlib.metadata
import keyword
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from fnmatch import fnmatchcase
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, cast

from minidual.config.loader import Override
from minidual.config.root import Config
from minidual.errors import EnvironmentMissingError, MinidualError, UsageError
from minidual.gate.code import Code, code_of
from minidual.gate.stage import StageFunction, ToolFunction
from minidual.gate.weakening import weaker_values
from minidual.registry import Deferred, Registry, load_target

_DEFAULTS = Config()


class Option(NamedTuple):
    """An option of a command that has no function in `minidual.cli.commands`.

    Attributes:
        name: As typed, without the dashes.
        help: Sentence for --help.
        kind: Type; `bool` is a flag, `tuple` is text such as "a,b".
    """

    name: str
    help: str
    kind: type[int | float | str | bool | Path | tuple[str, ...]] = str

    @property
    def key(self) -> str:
        """Python name; keywords get a trailing underscore."""
        name = self.name.replace("-", "_")
        return f"{name}_" if keyword.iskeyword(name) else name


def overrides(settings: Mapping[str, str], values: Mapping[str, Any]) -> list[Override]:
    """Return the configuration overrides that were typed as options.

    Args:
        settings: {option: configuration path}.
        values: {option: typed value, or None}. For a tuple in the configuration, "a,b" is typed; for
            a mapping, "key=value", once or more.

    Raises:
        UsageError: What was typed for a mapping has no "=".
    """
    changes: list[Override] = []
    for option, path in settings.items():
        typed = values.get(option)
        if typed is None or typed == []:
            continue
        if isinstance(_default(path), dict):
            changes += [_entry_override(path, option, word) for word in typed]
            continue
        value = _words(str(typed)) if isinstance(_default(path), tuple) else typed
        changes.append(Override(path, value, f"--{option} {typed}"))
    return changes


def _words(text: str) -> list[str]:
    words = [word.strip() for word in text.split(",")]
    return [word for word in words if word]


def _entry_override(path: str, option: str, typed: str) -> Override:
    """Return the override of one entry of a mapping, typed as "key=value"."""
    key, equals, value = typed.partition("=")
    if not key or not equals:
        raise UsageError(f"--{option} {typed}: type --{option} NAME=PATH")
    return Override(f"{path}.{key}", value, f"--{option} {typed}")


def _default(path: str) -> Any:
    value: Any = _DEFAULTS
    for name in path.split("."):
        value = getattr(value, name, None)
    return value


@dataclass(frozen=True)
class _Entry[F: Callable[..., Any]]:
    """A command.

    Attributes:
        name: Command, or an aside's output folder.
        target: The function, deferred, or "module:function"; see `minidual.gate.stage`.
        settings: {option: configuration path that it overrides}; other options reach the function
            as `context.options`.
        options: Options of a command without a function in `minidual.cli.commands`.
        watchable: Whether it shows moving arms to `context.view`.
        examples: For --help, such as "carry --trials 50"; like `options`.
    """

    name: str
    target: str | Deferred[F] | F
    _: KW_ONLY
    settings: Mapping[str, str] = field(default_factory=dict[str, str])
    options: tuple[Option, ...] = ()
    watchable: bool = False
    examples: tuple[str, ...] = ()

    def load(self) -> F:
        """Return the function; EnvironmentMissingError names a missing library."""
        return cast(F, _loaded(self.name, self.target))


@dataclass(frozen=True)
class ToolEntry(_Entry[ToolFunction]):
    """A command without verdict. As an aside of a stage it runs instead when its trigger is typed.

    Attributes:
        summary: For --help; like `options`.
        moves: Whether arms move: `minidual stop` finds it, and it runs alone in its run.
        shared: Whether several may work in one run at a time: they write nothing there.
        view_default: View without --view.
    """

    summary: str = ""
    moves: bool = False
    shared: bool = False
    view_default: str = "none"

    @property
    def trigger(self) -> str:
        """The first of `options`, which selects an aside."""
        return self.options[0].name


@dataclass(frozen=True)
class StageEntry(_Entry[StageFunction]):
    """One stage.

    Attributes:
        requires: Stages that must pass and be fresh; at most, if there is `needs`.
        summary: Help without the full stop.
        reads: Configuration paths that the result depends on.
        resolve: From Config to Config; like `target`, and must import quickly.
        check: Raises UsageError before a run; like `target`.
        needs: From Config to those of `requires` that it needs; like `resolve`. None: all.
        inputs: {upstream stage: patterns of the artefacts that it reads}. None: it may read all of
            them, and the verdicts.
        asides: Tools that run instead when their trigger is typed.
        keeps: Names in its folder that an attempt takes over from an interrupted one. If there are
            any, a replaced result is set aside.
        closing: Also checks waivers and code changes.
        compares: Configuration path in `reads` of the names that its checks compare; tables show
            them side by side.
    """

    requires: tuple[str, ...]
    summary: str
    reads: tuple[str, ...] = ()
    resolve: str | Deferred[Callable[[Config], Config]] | None = None
    check: str | Deferred[Callable[[Config], None]] | None = None
    needs: str | Deferred[Callable[[Config], Sequence[str]]] | None = None
    inputs: Mapping[str, Sequence[str]] | None = None
    asides: tuple[ToolEntry, ...] = ()
    keeps: tuple[str, ...] = ()
    closing: bool = False
    compares: str = ""

    def code(self, recorded: Code | None = None) -> Code:
        """Return the code that the stage reaches; see `code_of`."""
        targets: list[str] = []
        for target in (self.target, self.resolve):
            if isinstance(target, str):
                targets.append(target)
            elif isinstance(target, Deferred):
                targets += target.modules
        return code_of(targets, recorded)

    def resolved(self, config: Config, *, checked: bool = False) -> Config:
        """Return the resolved configuration; `checked` runs `check` first.

        Raises:
            UsageError: A name or value is wrong.
        """
        if self.check is not None and checked:
            _loaded(self.name, self.check)(config)
        if self.resolve is None:
            return config
        return cast(Config, _loaded(self.name, self.resolve)(config))

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return {path: value} of `reads`, resolved if the configuration can be."""
        with contextlib.suppress(MinidualError):  # what cannot is refused before the stage runs
            config = self.resolved(config)
        return {path: attrgetter(path)(config) for path in self.reads}

    def required(self, config: Config) -> tuple[str, ...]:
        """Return those of `requires` that a configuration needs; all if it is invalid."""
        if self.needs is None:
            return self.requires
        try:
            needed = _loaded(self.name, self.needs)(config)
        except MinidualError:  # it is refused before the stage runs
            return self.requires
        return tuple(name for name in self.requires if name in needed)

    def reads_artefact(self, stage: str, path: str) -> bool:
        """Return whether it reads an artefact of an upstream stage."""
        if self.inputs is None:
            return stage in self.requires
        return any(fnmatchcase(path, pattern) for pattern in self.inputs.get(stage, ()))

    def compared(self, parameters: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the names that its checks compare, from the parameters of its verdict."""
        section, _, rest = self.compares.partition(".")
        value: Any = parameters.get(section)
        for name in rest.split("."):
            value = cast(dict[str, Any], value).get(name) if isinstance(value, dict) else None
        return tuple(map(str, cast(list[Any], value))) if isinstance(value, list) else ()

    def weaker(self, config: Config, reference: Config) -> tuple[str, ...]:
        """Return a line per count or limit in `reads` that is weaker than in `reference`."""
        return weaker_values(self.reads, config, reference)

    def extras(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return `options` outside the configuration."""
        return {name: value for name, value in options.items() if name not in self.settings}


type _Function = Callable[..., Any]


def _loaded(name: str, target: str | Deferred[_Function] | _Function) -> _Function:
    try:
        if isinstance(target, str):
            return load_target(target)
        if isinstance(target, Deferred):
            return cast(_Function, target.load())
        return target
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("minidual"):
            raise
        raise EnvironmentMissingError(
            f"{name} needs the library '{error.name}', which is not installed",
            remedy="install minidual with its dependencies again (`make setup` in a checkout)",
        ) from error


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
                raise UsageError(
                    f"stage '{point.name}' of another distribution cannot be used: {error}",
                    remedy="mend or uninstall that distribution",
                ) from error

    def until(self, last: str) -> tuple[str, ...]:
        """Return `last` and its upstream stages, in order."""
        return (*self.upstream(last), last)

    def upstream(
        self,
        name: str,
        requires: Callable[[str], Sequence[str]] | None = None,
    ) -> tuple[str, ...]:
        """Return the stages that `name` requires, directly or not, in order.

        Args:
            name: Stage.
            requires: What a stage requires; by default what it requires at most.
        """
        if requires is None:
            requires = self._requires_at_most
        needed: set[str] = set()
        queue = list(requires(name))
        while queue:
            stage = queue.pop()
            needed.add(stage)
            queue += requires(stage)
        return tuple(stage for stage in self if stage in needed)

    def _requires_at_most(self, name: str) -> tuple[str, ...]:
        return self[name].requires
