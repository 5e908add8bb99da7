"""What one command works with: its options, configuration, run folder, gate and consoles."""

from __future__ import annotations

import os
import re
from collections.abc import Generator, Iterable, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.cli.options import CommonOptions, ViewOptions
from minidual.cli.process import interrupt
from minidual.cli.terminal import ConsoleProgress, console
from minidual.config.loader import (
    LoadedConfig,
    Override,
    find_profile,
    load_config,
    parse_override,
)
from minidual.durable import expanded
from minidual.errors import (
    ConfigError,
    EnvironmentMissingError,
    UsageError,
    printable,
    unknown_name,
)
from minidual.gate.canonical import dumps
from minidual.gate.gate import Gate
from minidual.gate.memory import Memory, as_typed, memory_of, read_memory, without
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageTable, ToolEntry

if TYPE_CHECKING:
    from minidual.show.view import View


class Session:
    """Objects of one command.

    Args:
        common: Its common options.
        table: Stages.
        tools: Commands without a verdict.

    Attributes:
        people: Console on stderr.
        data: Console on stdout (`status`, `explain`).
    """

    def __init__(
        self,
        common: CommonOptions,
        table: StageTable,
        tools: Iterable[ToolEntry] = (),
    ) -> None:
        self.common = common
        self.table = table
        self.tools = {tool.name: tool for tool in tools}
        self.people = console(stderr=True)
        self.data = console(stderr=False)
        self._inherited: Memory = {}
        self._loaded: dict[str, LoadedConfig] = {}

    @property
    def remembered(self) -> Memory:
        """Settings of earlier commands in this run; not those that were typed again."""
        memory = read_memory(self.store.folder)
        if memory is None:
            memory = self._inherited
        return without(memory, [override.path for override in self._typed()])

    @property
    def loaded(self) -> LoadedConfig:
        """Resolved configuration: profile, then what the run remembers, then what was typed.

        Raises:
            ConfigError: A remembered or typed value is invalid.
        """
        run = self.store.run
        if run not in self._loaded:
            self._loaded[run] = self._load(self.remembered)
        return self._loaded[run]

    def _load(self, remembered: Memory) -> LoadedConfig:
        typed = self._typed()
        try:
            settings = [f"{path}={text}" for path, text in remembered.items()]
            return load_config(self.common.profile, [*settings, *typed])
        except ConfigError as error:
            if not remembered:
                raise
            load_config(self.common.profile, typed)  # raises if what was typed is wrong
            texts = " ".join(as_typed(remembered))
            raise ConfigError(
                f"{error.message}\nrun '{self.store.run}' remembers {texts}",
                remedy=f"minidual config forget{self.common.place}",
            ) from error

    def _typed(self) -> list[Override]:
        """Return --set, --seed and --workers as typed."""
        typed = [parse_override(text) for text in self.common.settings or ()]
        for name, value in (("seed", self.common.seed), ("workers", self.common.workers)):
            if value is not None:
                typed.append(Override(name, value, f"--{name} {value}"))
        return typed

    def reload(self) -> None:
        """Read again what the run remembers."""
        self._loaded.clear()

    def work_in(self, run: str) -> None:
        """Go on in another run; if it is new, it begins with what this one remembers."""
        self._inherited = memory_of(self.loaded.overrides)
        self.common = replace(self.common, run=run)

    def drop_remembered(self) -> None:
        """Leave out of printed commands what the run remembers by now."""
        memory = read_memory(self.store.folder) or {}
        if memory_of(self._typed()).items() <= memory.items():
            loaded = self.loaded
            self.common = replace(self.common, settings=None, seed=None)
            self._loaded[self.store.run] = loaded

    def say_remembered(self) -> None:
        """Say which settings come from earlier commands, if there are any."""
        texts = " ".join(as_typed(self.remembered))
        if texts:
            forget = f"minidual config forget{self.common.place}"
            self.say(f"run '{self.store.run}' remembers {texts} (`{forget}` forgets it)", "dim")

    @property
    def root(self) -> Path:
        """Folder of all runs."""
        if self.common.runs_dir == "":
            raise UsageError(
                "--runs-dir is empty",
                remedy="name a folder, or leave it out for ./runs",
            )
        return expanded(self.common.runs_dir or os.environ.get("MINIDUAL_RUNS") or "runs")

    @property
    def store(self) -> RunStore:
        """The run's folder."""
        name = self.common.run
        if name is None:
            name = find_profile(self.common.profile)[0]
        return RunStore(self.root, name)

    def require_folder(self) -> None:
        """Raise EnvironmentMissingError if the working directory was deleted."""
        try:
            Path.cwd()
        except FileNotFoundError:
            raise EnvironmentMissingError(
                "the working directory was deleted",
                remedy="cd to another one",
            ) from None

    def require_run(self) -> None:
        """Raise UsageError if --run names a run that does not exist."""
        name = self.common.run
        if name is not None and not self.store.folder.exists():
            raise unknown_name("run", name, (folder.name for folder in self.root.glob("[!.]*/")))

    def gate(self, options: Mapping[str, Mapping[str, Any]] | None = None) -> Gate:
        """Return a gate of this run; `options` is {stage: its options}."""
        return Gate(self.table, self.store, self.loaded, options or {})

    def gate_before(self) -> Gate:
        """Return a gate of this run without what was typed now."""
        settings = [
            f"{path}={text}" for path, text in (read_memory(self.store.folder) or {}).items()
        ]
        return Gate(self.table, self.store, load_config(self.common.profile, settings))

    def runner(self, view: View | None = None) -> Runner:
        """Return a runner with progress and `view`."""
        progress = ConsoleProgress(self.people)
        if view is not None and self.loaded.config.workers > 1:
            progress.note("the view needs the stage in this process: one worker for this run")
        return Runner(
            table=self.table,
            store=self.store,
            loaded=self.loaded,
            progress=progress,
            command=self.common.command,
            view=view,
            interrupted=lambda: interrupt.raised,
        )

    @contextmanager
    def view(self, options: ViewOptions, default: str = "none") -> Generator[View | None]:
        """Yield the selected view, or None; close it at the end.

        Raises:
            UsageError: Host or port without a web view, or a view that does not exist.
        """
        from minidual.show.view import make_view

        name = options.view or default
        overrides: list[Override] = []
        for option, path, value in (
            ("--view-host", "view.host", options.view_host),
            ("--view-port", "view.port", options.view_port),
        ):
            if value is None:
                continue
            if name != "web":
                raise UsageError(f"{option} goes with --view web, not with --view {name}")
            overrides.append(Override(path, value, f"{option} {value}"))
        view = make_view(name, self.loaded.with_overrides(overrides).config.view, say=self.say)
        if view is None:
            yield None
            return
        with closing(view):
            yield view

    def following(self, gate: Gate | None = None, *, explained: bool = False) -> str:
        """Return the line that names the next command to type.

        After a failure that is `explain`, unless it was `explained` just now.
        """
        state = (gate or self.gate()).lowest()
        if state is None:
            return "every stage passes and is fresh"
        if state.state in ("fail", "error") and not explained:
            return f"next: {self.common.command(f'explain {state.name}')}"
        attempt = self.store.attempt(state.name)
        options = f" {attempt.options}" if attempt is not None and attempt.options else ""
        return f"next: {self.common.command(state.name)}{options}"

    def in_this_run(self, remedy: str) -> str:
        """Return `remedy` with the typed options added to each command that lacks them.

        Without them a command would act on another run.
        """
        stages = "|".join(map(re.escape, self.table))
        names = f"explain (?:{stages})|run|status|explain|{stages}"
        name = rf"(?>{names})(?![\w-])"
        options = r"(?: --force| --until [\w-]+)*+"
        complete = re.escape(self.common.flags)
        return re.sub(
            rf"\bminidual ({name}{options})(?!{complete})",
            lambda match: self.common.command(match[1]),
            remedy,
        )

    def say(self, text: str, style: str = "") -> None:
        """Print a line to stderr."""
        self.people.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    def finish(self, document: Mapping[str, Any], lines: Iterable[object]) -> None:
        """Print the document (--json) or the lines to stdout."""
        if self.common.json:
            print(printable(dumps(document).rstrip("\n")))
            return
        for line in lines:
            print(printable(str(line)))
