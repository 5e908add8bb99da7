"""Run stages whose gates are open."""

import shlex
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from minidual import emergency
from minidual.config.loader import LoadedConfig
from minidual.durable import disk_errors, now_text
from minidual.errors import ExitCode, MinidualError, UsageError
from minidual.gate.canonical import canonical
from minidual.gate.closed import closed_error
from minidual.gate.fingerprint import Fingerprint
from minidual.gate.gate import Gate
from minidual.gate.memory import memory_of, write_memory
from minidual.gate.progress import Progress
from minidual.gate.stage import Folders, StageContext, StageResult, closing_checks
from minidual.gate.state import StageState
from minidual.gate.store import RunStore
from minidual.gate.table import StageEntry, StageTable
from minidual.gate.verdict import Verdict, Waiver, build_manifest, derive_status, strays

EXIT_OF_STATUS = {
    "pass": ExitCode.PASS,
    "fail": ExitCode.ACCEPTANCE_FAILED,
    "error": ExitCode.NOTHING_EVALUATED,
}
_INTERRUPTED = "interrupted at the keyboard"


class StageCrashedError(MinidualError):
    """Unforeseen exception of a stage; the traceback is in a file."""

    exit_code = ExitCode.INTERNAL


class StageOutcome(NamedTuple):
    """State of a stage after a command, and whether it ran."""

    state: StageState
    ran: bool

    @property
    def verdict(self) -> Verdict:
        """The verdict; ValueError if there is none."""
        if self.state.verdict is None:
            raise ValueError(f"stage {self.state.name} has no verdict")
        return self.state.verdict

    @property
    def exit_code(self) -> ExitCode:
        """0 for pass, 1 for fail, 5 if nothing was evaluated."""
        return EXIT_OF_STATUS[self.verdict.status]


@dataclass(frozen=True)
class _Attempt:
    """One execution of a stage, as it begins."""

    entry: StageEntry
    options: dict[str, Any]
    loaded: LoadedConfig
    """Under the options."""
    fingerprint: Fingerprint
    upstream: dict[str, Verdict]
    waivers: tuple[Waiver, ...]
    typed: tuple[str, ...]
    """Settings and options as typed."""


@dataclass
class Runner:
    """Runs stages of one run.

    Attributes:
        command: Turns "plan" into the full command.
        interrupted: Whether a signal ended the stage, whatever error a library made of it.
        view: For the stages; requires one worker, in this process.
    """

    table: StageTable
    store: RunStore
    loaded: LoadedConfig
    progress: Progress = field(default_factory=Progress)
    command: Callable[[str], str] = "minidual {}".format
    view: Any = None
    interrupted: Callable[[], bool] = lambda: False

    def run(
        self,
        name: str,
        options: Mapping[str, Any] | None = None,
        *,
        force: bool = False,
        waiver: str | None = None,
    ) -> StageOutcome:
        """Run one stage unless it passes and is fresh.

        Args:
            name: Stage.
            options: Its options as typed.
            force: Run it even if it passes and is fresh.
            waiver: Reason to open a closed gate.

        Raises:
            GateClosedError, UsageError: An upstream stage does not pass; another process writes
                here.
            StageCrashedError: Unforeseen exception.
        """
        with disk_errors(self.store.folder), self.store.writing(self.command(name), [name]):
            gate = self._gate({name: dict(options or {})})
            self._validate(gate, name)
            return self._run_locked(gate, name, force, waiver)

    def run_until(
        self,
        end: str | None = None,
        *,
        force: bool = False,
        waiver: str | None = None,
    ) -> Iterator[StageOutcome]:
        """Run `end` and all that it requires, or every stage; yield each outcome.

        Stops at the first stage that does not pass, unless waived. Holds the run's lock throughout.
        """
        names = self._gate().until(end, force)
        command = self.command("run" if end is None else f"run --until {end}")
        with disk_errors(self.store.folder), self.store.writing(command, names):
            for name in self._gate().rerun(names, force):
                self._validate(self._gate(), name)
            for name in names:
                # A passing, fresh stage keeps the options it was run with; one that runs again
                # follows the configuration.
                gate = self._gate()
                if gate.state(name).state != "pass" or force:
                    gate = self._gate({name: {}})
                outcome = self._run_locked(gate, name, force, waiver)
                yield outcome
                if outcome.exit_code != ExitCode.PASS and waiver is None:
                    return

    def _gate(self, options: Mapping[str, Mapping[str, Any]] | None = None) -> Gate:
        return Gate(self.table, self.store, self.loaded, options or {})

    def _validate(self, gate: Gate, name: str) -> None:
        config = gate.effective(name, None)[1].config
        self.table[name].resolved(config, checked=True)

    def _run_locked(self, gate: Gate, name: str, force: bool, waiver: str | None) -> StageOutcome:
        if waiver is not None and not waiver.strip():
            raise UsageError(
                "--waive-gate needs a reason, which the verdict keeps",
                remedy='type --waive-gate "WHY"',
            )
        state = gate.state(name)
        is_fresh = state.state == "pass" and not force
        closed = [] if is_fresh else gate.closed_by(name)
        if closed and waiver is None:
            raise closed_error(gate, name, self.command)
        write_memory(self.store.folder, memory_of(self.loaded.overrides))
        if is_fresh:
            return StageOutcome(state, ran=False)
        self._execute(gate, name, self._waivers(gate, name, closed, waiver))
        return StageOutcome(self._gate(gate.options).state(name), ran=True)

    def _waivers(
        self,
        gate: Gate,
        name: str,
        closed: list[StageState],
        reason: str | None,
    ) -> tuple[Waiver, ...]:
        """Return the waivers of the upstream stages and the one that opens this gate."""
        waivers: list[Waiver] = []
        for verdict in gate.verdicts(name).values():
            waivers += [waiver for waiver in verdict.waivers if waiver not in waivers]
        if closed and reason is not None:
            blocking: dict[str, str] = {state.name: state.state for state in closed}
            waivers.append(Waiver(name, reason, blocking, now_text()))
        elif reason is not None:
            self.progress.note(f"the gate of {name} is open, the waiver is not used")
        return tuple(waivers)

    def _execute(self, gate: Gate, name: str, waivers: tuple[Waiver, ...]) -> None:
        entry = self.table[name]
        run = entry.load()
        options, loaded = gate.effective(name, None)
        attempt = _Attempt(
            entry=entry,
            options=options,
            loaded=loaded,
            fingerprint=gate.fingerprint(name),
            upstream=gate.verdicts(name),
            waivers=waivers,
            typed=tuple(gate.typed(name)[1:]),
        )
        context = self._begin(gate, attempt)
        started_at = now_text()
        started = time.monotonic()
        try:
            with disk_errors(self.store.folder):
                result = run(context)
                emergency.check()
                verdict = self._verdict(attempt, context, result, started_at, started)
                self._publish(gate, attempt, verdict)
        except KeyboardInterrupt as stop:
            self.store.abandon(name, "interrupted", str(stop) or _INTERRUPTED)
            raise
        except Exception as error:
            if self.interrupted():
                self.store.abandon(name, "interrupted", _INTERRUPTED)
            elif isinstance(error, MinidualError):
                self.store.abandon(name, "error", error.message)
            else:
                raise self._crashed(name, error) from error
            raise

    def _begin(self, gate: Gate, attempt: _Attempt) -> StageContext:
        """Make the temporary folder and the context of a stage."""
        entry = attempt.entry
        loaded = attempt.loaded
        config_text = loaded.to_yaml()
        folder = self.store.begin(entry.name, config_text, entry.keeps, self._own_options(attempt))
        # A stage whose row names its inputs gets nothing else: it does not stand on the rest.
        read = attempt.upstream if entry.inputs is None else entry.inputs
        verdicts = attempt.upstream if entry.inputs is None else {}
        upstream = {
            name: self.store.stage_folder(name) for name in attempt.upstream if name in read
        }
        states: dict[str, str] = {}
        if entry.closing:
            states = {name: gate.state(name).state for name in gate.upstream(entry.name)}
        return StageContext(
            config=entry.resolved(loaded.config),
            seed=loaded.config.seed,
            profile=loaded.profile,
            progress=self.progress,
            options=attempt.options,
            workers=loaded.config.workers if self.view is None else 1,
            view=self.view,
            folder=folder,
            upstream=Folders(upstream),
            verdicts=verdicts,
            states=states,
            summaries={up: self.table[up].summary for up in self.table.upstream(entry.name)},
            code_changes=gate.code_changes(entry.name) if entry.closing else {},
            waivers=attempt.waivers,
        )

    def _own_options(self, attempt: _Attempt) -> str:
        """Return the options of the stage itself as typed, quoted for a shell."""
        of_run = {"", *(override.text for override in self.loaded.overrides)}
        own = [text for text in attempt.typed if text not in of_run]
        return " ".join(shlex.join(text.split(" ", 1)) for text in own)

    def _verdict(
        self,
        attempt: _Attempt,
        context: StageContext,
        result: StageResult,
        started_at: str,
        started: float,
    ) -> Verdict:
        """Return the verdict of a result; `started` is the monotonic time of its begin [s]."""
        finished_at = now_text()
        entry = attempt.entry
        checks = [*result.checks]
        if entry.closing and derive_status(checks) != "error":
            checks += closing_checks(attempt.waivers, context.code_changes)
        return Verdict(
            stage=entry.name,
            run=self.store.run,
            fingerprint=attempt.fingerprint,
            checks=tuple(checks),
            artefacts=build_manifest(context.folder),
            acceptance_profile=attempt.loaded.config.acceptance,
            started_at=started_at,
            finished_at=finished_at,
            duration_s=round(time.monotonic() - started, 3),
            options=canonical(attempt.options, f"{entry.name}.options"),
            overrides=attempt.typed,
            waivers=attempt.waivers,
            weakened=_weakened(attempt),
            data=canonical(result.data, f"{entry.name}.data"),
            notes=tuple(result.notes),
        )

    def _publish(self, gate: Gate, attempt: _Attempt, verdict: Verdict) -> None:
        """Publish a result; keep an earlier one that holds recordings or files of others."""
        name = attempt.entry.name
        previous = gate.state(name).verdict
        artefacts = {} if previous is None else previous.artefacts
        others = strays(self.store.stage_folder(name), artefacts)
        keep_old = bool(attempt.entry.keeps or others)
        kept = self.store.publish(name, verdict, keep_old=keep_old)
        if kept is not None:
            self.progress.note(f"the earlier {name} is kept in {kept}")

    def _crashed(self, name: str, error: Exception) -> StageCrashedError:
        text = f"{name} crashed: {type(error).__name__}: {error}"
        try:
            text += f"; traceback in {self.store.write_crash(name, error)}"
        except OSError as write_error:
            text += f"; its traceback could not be written ({write_error})"
        self.store.abandon(name, "error", text)
        return StageCrashedError(
            text,
            remedy="this is a defect in minidual, please report it with that file",
        )


def _weakened(attempt: _Attempt) -> tuple[str, ...]:
    """Return where upstream stages and this one demand less than the shipped profile."""
    loaded = attempt.loaded
    if not loaded.config.acceptance:
        return ()
    lines: list[str] = []
    for verdict in attempt.upstream.values():
        lines += verdict.weakened
    for line in attempt.entry.weaker(loaded.config, loaded.reference()):
        lines.append(f"{attempt.entry.name}: {line}")
    return tuple(dict.fromkeys(lines))
