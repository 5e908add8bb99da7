"""State of one command: options, run and exit."""

from __future__ import annotations

import json
import os
import shlex
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.errors import ExitCode, MinidualError

if TYPE_CHECKING:
    from rich.console import Console

    from minidual.config.loader import LoadedConfig
    from minidual.gate.gate import Gate
    from minidual.gate.runner import Runner
    from minidual.gate.store import RunStore
    from minidual.gate.table import StageTable
    from minidual.show.view import View


@dataclass(frozen=True)
class Typed:
    """Options common to all commands."""

    profile: str = "standard"
    settings: Sequence[str] = ()
    run: str | None = None
    runs_dir: Path | None = None
    seed: int | None = None
    workers: int | None = None
    json: bool = False
    debug: bool = False

    def command(self, words: str) -> str:
        """Return "minidual <words>" with the options that select run and result."""
        flags: list[str] = []
        if self.profile != "standard":
            flags += ["--profile", self.profile]
        if self.run is not None:
            flags += ["--run", self.run]
        if self.runs_dir is not None:
            flags += ["--runs-dir", str(self.runs_dir)]
        if self.seed is not None:
            flags += ["--seed", str(self.seed)]
        for setting in self.settings:
            flags += ["--set", setting]
        return " ".join(["minidual", words, *([shlex.join(flags)] if flags else [])])


class Session:
    """Lazily made objects of a command."""

    def __init__(self, typed: Typed, table: StageTable) -> None:
        self.typed = typed
        self.table = table

    @cached_property
    def people(self) -> Console:
        """Console on stderr, for people."""
        return _console(stderr=True)

    @cached_property
    def data(self) -> Console:
        """Console on stdout, for `status` and `explain`."""
        return _console(stderr=False)

    @cached_property
    def loaded(self) -> LoadedConfig:
        """Resolved configuration."""
        from minidual.config.loader import Override, load_config

        overrides: list[Override | str] = list(self.typed.settings)
        for name, value in (("seed", self.typed.seed), ("workers", self.typed.workers)):
            if value is not None:
                overrides.append(Override(name, value, f"--{name} {value}"))
        return load_config(self.typed.profile, overrides)

    @cached_property
    def store(self) -> RunStore:
        """The run's folder."""
        from minidual.config.run import locate_run
        from minidual.gate.store import RunStore

        location = locate_run(self.loaded.profile, self.typed.run, self.typed.runs_dir)
        return RunStore(location.root, location.name)

    def gate(self) -> Gate:
        """Return a gate for the present run."""
        from minidual.gate.gate import Gate

        return Gate(self.table, self.store, self.loaded)

    def runner(self, view: View | None = None) -> Runner:
        """Return a runner with progress and `view`."""
        from minidual.cli.progress import progress_for
        from minidual.gate.runner import Runner

        progress = progress_for(self.people)
        if view is not None and self.loaded.config.workers > 1:
            progress.note("what is watched runs in this process: one worker for this run")
        return Runner(self.table, self.store, self.loaded, progress, self.typed.command, view)

    def following(self, gate: Gate | None = None) -> str:
        """Return the next command to type."""
        gate = gate or self.gate()
        for name in self.table.names:
            state = gate.state(name).state
            if state in ("fail", "error"):
                return f"next: {self.typed.command(f'explain {name}')}"
            if state != "pass":
                return f"next: {self.typed.command(name)}"
        return "every stage passes and is fresh"

    def print_json(self, document: Any) -> None:
        """Print a JSON document to stdout."""
        from minidual.gate.canonical import canonical

        print(json.dumps(canonical(document), indent=2, allow_nan=False, ensure_ascii=False))

    def end(self, body: Callable[[Session], ExitCode]) -> int:
        """Run `body`; turn exceptions into a message and an exit code."""
        try:
            code = body(self)
            sys.stdout.flush()
            return int(code)
        except BrokenPipeError:
            # The reader closed the pipe (`| head`).
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return int(ExitCode.PASS)
        except KeyboardInterrupt as error:
            message = "interrupted; nothing half-written counts, the same command goes on from here"
            return self._fail(error, message, None, ExitCode.INTERRUPTED)
        except MinidualError as error:
            return self._fail(error, error.message, error.remedy, error.exit_code)
        except Exception as error:
            message = f"internal error: {type(error).__name__}: {error}; traceback in {self._write_trace(error)}"
            return self._fail(error, message, "please report it with that file", ExitCode.INTERNAL)

    def _fail(self, error: BaseException, message: str, remedy: str | None, code: ExitCode) -> int:
        if self.typed.debug:
            traceback.print_exception(error, file=sys.stderr)
        if self.typed.json:
            kind = type(error).__name__
            self.print_json({"error": {"kind": kind, "message": message, "remedy": remedy}, "exit_code": int(code)})
        print(f"minidual: {message}", file=sys.stderr)
        if remedy:
            print(f"  remedy: {remedy}", file=sys.stderr)
        return int(code)

    def _write_trace(self, error: BaseException) -> str:
        try:
            return str(self.store.write_crash("cli", error))
        except Exception:  # the crash may be in the very code that finds the run folder
            descriptor, path = tempfile.mkstemp(prefix="minidual-crash-", suffix=".txt")
            with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
                stream.write("".join(traceback.format_exception(error)))
            return path


def _console(*, stderr: bool) -> Console:
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    # Off a terminal rich assumes 80 columns and would fold log lines.
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else 160)
