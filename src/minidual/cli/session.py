"""Options, run and exit of one command."""

from __future__ import annotations

import os
import re
import shlex
import sys
import traceback
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minidual.cli.console import ConsoleProgress, console
from minidual.cli.process import interrupt
from minidual.config.loader import LoadedConfig, Override, load_config
from minidual.durable import expanded
from minidual.errors import (
    EnvironmentMissingError,
    ExitCode,
    MinidualError,
    UsageError,
    printable,
    unknown_name,
)
from minidual.gate.canonical import digest, dumps
from minidual.gate.gate import Gate
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageTable, options_of, overrides
from minidual.registry import rows_beside

if TYPE_CHECKING:
    from minidual.show.view import View

_every = partial(typer.Option, rich_help_panel="Every command")

OPTIONS = {
    command: options_of(rows) for command, rows in rows_beside(__file__, "options.yaml").items()
}


@dataclass(frozen=True)
class Typed:
    """Options of every command."""

    profile: Annotated[
        str,
        _every(help="smoke, standard, gpu, or a profile file ending in .yaml."),
    ] = "standard"
    settings: Annotated[
        list[str] | None,
        _every(
            "--set",
            metavar="KEY=VALUE",
            help="Override a configuration value, e.g. plan.queries_n=30.",
        ),
    ] = None
    run: Annotated[str | None, _every(help="Name of the run (default: the profile's name).")] = None
    runs_dir: Annotated[
        str | None,
        _every(metavar="DIR", help="Folder of all runs (default: $MINIDUAL_RUNS or ./runs)."),
    ] = None
    seed: Annotated[int | None, _every(help="The one seed of the run.")] = None
    workers: Annotated[
        int | None,
        _every(help="Processes to use; results do not depend on it."),
    ] = None
    json: Annotated[
        bool,
        _every("--json", metavar=" ", help="Print one JSON document to stdout."),
    ] = False
    debug: Annotated[bool, _every("--debug", metavar=" ", help="Show tracebacks.")] = False

    def command(self, words: str) -> str:
        """Return "minidual <words>" with `flags`."""
        return f"minidual {words}{self.flags}"

    @property
    def flags(self) -> str:
        """Typed options that select run and result, after a space, or empty."""
        profile = None if self.profile == "standard" else self.profile
        given = [
            ("--profile", profile),
            ("--run", self.run),
            ("--runs-dir", self.runs_dir),
            ("--seed", self.seed),
        ]
        given += [("--set", setting) for setting in self.settings or ()]
        return "".join(
            f" {flag} {shlex.quote(str(value))}" for flag, value in given if value is not None
        )


class Session:
    """Objects of a command; console `people` is on stderr, `data` on stdout (`status`, `explain`)."""

    def __init__(self, typed: Typed, table: StageTable) -> None:
        self.typed = typed
        self.table = table
        self.people = console(stderr=True)
        self.data = console(stderr=False)

    @cached_property
    def loaded(self) -> LoadedConfig:
        """Resolved configuration."""
        numbers = [("seed", self.typed.seed), ("workers", self.typed.workers)]
        typed = [
            Override(name, value, f"--{name} {value}")
            for name, value in numbers
            if value is not None
        ]
        return load_config(self.typed.profile, [*(self.typed.settings or ()), *typed])

    @property
    def root(self) -> Path:
        """Folder of all runs."""
        if self.typed.runs_dir == "":
            raise UsageError(
                "--runs-dir is empty",
                remedy="name a folder, or leave it out for ./runs",
            )
        return expanded(self.typed.runs_dir or os.environ.get("MINIDUAL_RUNS") or "runs")

    @property
    def store(self) -> RunStore:
        """The run's folder."""
        return RunStore(
            self.root,
            self.loaded.profile if self.typed.run is None else self.typed.run,
        )

    def begin(self, reads: bool) -> Session:
        """Return itself.

        Raises:
            EnvironmentMissingError, UsageError: The working directory was deleted; what `reads` a run that was named
                finds none.
        """
        try:
            Path.cwd()
        except FileNotFoundError:
            raise EnvironmentMissingError(
                "the working directory was deleted",
                remedy="cd to another one",
            ) from None
        if reads and self.typed.run is not None and not self.store.folder.exists():
            raise unknown_name(
                "run",
                self.typed.run,
                (folder.name for folder in self.root.glob("[!.]*/")),
            )
        return self

    def gate(self, options: Mapping[str, Mapping[str, Any]] | None = None) -> Gate:
        """Return a gate of this run."""
        return Gate(self.table, self.store, self.loaded, options or {})

    def runner(self, view: View | None = None) -> Runner:
        """Return a runner with progress and `view`."""
        progress = ConsoleProgress(self.people)
        if view is not None and self.loaded.config.workers > 1:
            progress.note("what is watched runs in this process: one worker for this run")
        return Runner(
            self.table,
            self.store,
            self.loaded,
            progress,
            self.typed.command,
            view,
            lambda: interrupt.raised,
        )

    @contextmanager
    def view(self, values: Mapping[str, Any], default: str = "none") -> Generator[View | None]:
        """Yield the selected view or None; close it at the end.

        Raises:
            UsageError: Host or port without a web view, or raised by make_view.
        """
        from minidual.show.view import make_view

        name = values.get("view") or default
        watching = OPTIONS["watching"]
        typed = overrides(watching, {option.name: values.get(option.key) for option in watching})
        if typed and name != "web":
            raise UsageError(
                f"{typed[0].text.split()[0]} goes with --view web, not with --view {name}",
            )
        view = make_view(name, self.loaded.with_overrides(typed).config.view, say=self.say)
        with nullcontext() if view is None else closing(view):
            yield view

    def spare_finished(
        self,
        names: Sequence[str],
        options: Mapping[str, Mapping[str, Any]],
        force: bool,
    ) -> None:
        """Switch to another run if the command would replace stages finished with other options.

        Stages that stay the same are hard-linked.
        """
        for name in self.gate(options).rerun(
            names,
            force,
        ):  # before another run is begun for what is misspelt
            self.table[name].resolved(
                self.gate(options).effective(name, None)[1].config,
                checked=True,
            )
        while replaced := (gate := self.gate(options)).replaced(names, force):
            base = self.store
            first = next(iter(replaced))
            self.typed = replace(self.typed, run=self._own_run(base.run, *options.values()))
            more = f" (and of {', '.join(list(replaced)[1:])})" if len(replaced) > 1 else ""
            self.say(f"run '{base.run}' keeps its finished {first}{more}: {replaced[first]}")
            self.say(
                f"working in run '{self.store.run}' instead; --yes would replace it in '{base.run}'",
            )
            kept = {up for name in names for up in (*self.table.upstream(name), name)} - {
                *gate.rerun(names, force),
            }
            for name in self.table:
                if name in kept and gate.state(name).state in (
                    "pass",
                    "fail",
                ):  # a waiver works on a failed one
                    self.store.link(name, base)

    def _own_run(self, run: str, *options: Mapping[str, Any]) -> str:
        typed = self.typed
        words = (
            [] if typed.profile == "standard" or typed.run is None else [Path(typed.profile).stem]
        )
        for name, value in (pair for given in options for pair in given.items()):
            words.append(value if isinstance(value, str) else f"{name}-{value}")
        words += [setting.replace("=", "-") for setting in typed.settings or ()]
        words += [] if typed.seed is None else [f"seed-{typed.seed}"]
        name = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join([run, *(words or ["defaults"])])).strip("-")
        return name if len(name) <= 80 else f"{name[:71]}-{digest([run, *words])[:8]}"

    def following(self, gate: Gate | None = None, *, explained: bool = False) -> str:
        """Return the next command to type; `explain` first after a failure."""
        if (state := (gate or self.gate()).lowest()) is None:
            return "every stage passes and is fresh"
        explain = state.state in ("fail", "error") and not explained
        attempt = None if explain else self.store.attempt(state.name)
        options = f" {attempt.options}" if attempt is not None and attempt.options else ""
        return f"next: {self.typed.command(f'explain {state.name}' if explain else state.name)}{options}"

    def say(self, text: str, style: str = "") -> None:
        """Print a line to stderr."""
        self.people.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    def finish(self, document: Mapping[str, Any], lines: Iterable[object]) -> None:
        """Print the document (--json) or the lines to stdout."""
        for text in [dumps(document).rstrip("\n")] if self.typed.json else map(str, lines):
            print(printable(text))

    def end(self, body: Callable[[Session], int]) -> int:
        """Run `body`; return its exit code or that of its error."""
        try:
            return int(body(self))
        except KeyboardInterrupt as error:
            return self._interrupted(error, str(error))
        except Exception as error:
            if interrupt.raised:
                return self._interrupted(error)
            if isinstance(error, MinidualError):
                return self._fail(error, error.message, error.remedy, error.exit_code)
            message = f"internal error: {type(error).__name__}: {error}"
            try:
                message += f"; traceback in {self.store.write_crash('cli', error)}"
            except Exception:  # the crash may be in the very code that finds the run folder
                _print_error("".join(traceback.format_exception(error)))
            return self._fail(
                error,
                message,
                "please report it with the traceback",
                ExitCode.INTERNAL,
            )

    def _interrupted(self, error: BaseException, what: str = "") -> int:
        message = f"{what or 'interrupted'}; nothing half-written counts, the same command goes on from here"
        return self._fail(error, message, None, ExitCode.INTERRUPTED)

    def _fail(self, error: BaseException, message: str, remedy: str | None, code: ExitCode) -> int:
        if self.typed.debug:
            _print_error("".join(traceback.format_exception(error)))
        remedy = remedy and self.in_this_run(remedy)
        kind = {"kind": type(error).__name__, "message": message, "remedy": remedy}
        self.finish({"error": kind, "exit_code": int(code)}, ())
        _print_error(f"minidual: {message}" + (f"\n  remedy: {remedy}" if remedy else ""))
        return int(code)

    def in_this_run(self, remedy: str) -> str:
        """Return `remedy` with the typed options in each command that lacks them: it would act on another run."""
        stages = "|".join(map(re.escape, self.table))
        names = f"explain (?:{stages})|run|status|explain|{stages}"
        words = rf"\bminidual ((?>{names})(?![\w-])(?: --force| --until [\w-]+)*+)(?!{re.escape(self.typed.flags)})"
        return re.sub(words, lambda found: self.typed.command(found[1]), remedy)


def _print_error(text: str) -> None:
    print(printable(text), file=sys.stderr)
