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
from minidual.gate.gate import Gate, StageState
from minidual.gate.stage import Folders, Progress, StageContext, closing_checks
from minidual.gate.store import RunStore
from minidual.gate.table import StageEntry, StageTable
from minidual.gate.verdict import Verdict, Waiver, build_manifest, derive_status, strays

EXIT_OF_STATUS = {
    "pass": ExitCode.PASS,
    "fail": ExitCode.ACCEPTANCE_FAILED,
    "error": ExitCode.NOTHING_EVALUATED,
}


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
        """Run one stage unless it passes and is fresh; `force` runs it anyway. `waiver`: reason to open a closed gate.

        Raises:
            GateClosedError, UsageError: An upstream stage does not pass; another process writes here.
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
        names = self.table.until(end)
        command = "run" if end is None else f"run --until {end}"
        with disk_errors(self.store.folder), self.store.writing(self.command(command), names):
            for name in self._gate().rerun(names, force):
                self._validate(self._gate(), name)
            for name in names:
                # A passing, fresh stage keeps the options it was run with; one that runs again follows the
                # configuration.
                fresh = self._gate().state(name).state == "pass" and not force
                outcome = self._run_locked(
                    self._gate(None if fresh else {name: {}}),
                    name,
                    force,
                    waiver,
                )
                yield outcome
                if outcome.exit_code != ExitCode.PASS and waiver is None:
                    return

    def _gate(self, options: Mapping[str, Mapping[str, Any]] | None = None) -> Gate:
        return Gate(self.table, self.store, self.loaded, options or {})

    def _validate(self, gate: Gate, name: str) -> None:
        self.table[name].resolved(gate.effective(name, None)[1].config, checked=True)

    def _run_locked(self, gate: Gate, name: str, force: bool, waiver: str | None) -> StageOutcome:
        if waiver is not None and not waiver.strip():
            raise UsageError(
                "--waive-gate needs a reason, which the verdict keeps",
                remedy='type --waive-gate "WHY"',
            )
        state = gate.state(name)
        if state.state == "pass" and not force:
            return StageOutcome(state, ran=False)
        closed = gate.closed_by(name)
        if closed and waiver is None:
            raise gate.closed_error(name, self.command)
        self._execute(gate, name, self._waivers(gate, name, closed, waiver))
        return StageOutcome(self._gate(gate.options).state(name), ran=True)

    def _waivers(
        self,
        gate: Gate,
        name: str,
        closed: list[StageState],
        reason: str | None,
    ) -> tuple[Waiver, ...]:
        waivers: list[Waiver] = []
        for verdict in gate.verdicts(name).values():
            waivers += [item for item in verdict.waivers if item not in waivers]
        if closed and reason is not None:
            waivers.append(
                Waiver(name, reason, {item.name: item.state for item in closed}, now_text()),
            )
        elif reason is not None:
            self.progress.note(f"the gate of {name} is open, the waiver is not used")
        return tuple(waivers)

    def _weakened(self, gate: Gate, entry: StageEntry, loaded: LoadedConfig) -> tuple[str, ...]:
        if not loaded.config.acceptance:
            return ()
        own = [f"{entry.name}: {line}" for line in entry.weaker(loaded.config, loaded.reference())]
        above = [
            line for verdict in gate.verdicts(entry.name).values() for line in verdict.weakened
        ]
        return tuple(dict.fromkeys([*above, *own]))

    def _execute(self, gate: Gate, name: str, waivers: tuple[Waiver, ...]) -> None:
        entry = self.table[name]
        run = entry.load()
        options, loaded = gate.effective(name, None)
        fingerprint = gate.fingerprint(name)
        verdicts = gate.verdicts(name)
        of_run = {"", *(override.text for override in self.loaded.overrides)}
        typed = " ".join(
            shlex.join(text.split(" ", 1)) for text in gate.typed(name)[1:] if text not in of_run
        )
        folder = self.store.begin(name, loaded.to_yaml(), entry.keeps, typed)
        about: Any = {
            "config": entry.resolved(loaded.config),
            "seed": loaded.config.seed,
            "profile": loaded.profile,
        }
        about |= {"verdicts": verdicts, "waivers": waivers, "options": options}
        context = StageContext(
            **about,
            folder=folder,
            upstream=Folders({up: self.store.stage_folder(up) for up in verdicts}),
            summaries={up: self.table[up].summary for up in self.table.upstream(name)},
            code_changes=gate.code_changes(name) if entry.closing else {},
            progress=self.progress,
            workers=loaded.config.workers if self.view is None else 1,
            view=self.view,
        )
        started_at = now_text()
        started = time.monotonic()
        try:
            with disk_errors(self.store.folder):
                result = run(context)
                emergency.check()
                judged = entry.closing and derive_status(result.checks) != "error"
                closing = closing_checks(waivers, context.code_changes) if judged else ()
                known: Any = {
                    "stage": name,
                    "run": self.store.run,
                    "fingerprint": fingerprint,
                    "waivers": waivers,
                }
                known |= {"started_at": started_at, "finished_at": now_text()}
                verdict = Verdict(
                    **known,
                    checks=(*result.checks, *closing),
                    artefacts=build_manifest(folder),
                    acceptance_profile=loaded.config.acceptance,
                    duration_s=round(time.monotonic() - started, 3),
                    options=canonical(options, f"{name}.options"),
                    overrides=tuple(gate.typed(name)[1:]),
                    weakened=self._weakened(gate, entry, loaded),
                    data=canonical(result.data, f"{name}.data"),
                    notes=tuple(result.notes),
                )
                previous = gate.state(name)
                made = previous.verdict.artefacts if previous.verdict else {}
                keep_old = bool(entry.keeps or strays(self.store.stage_folder(name), made))
                if (kept := self.store.publish(name, verdict, keep_old=keep_old)) is not None:
                    self.progress.note(f"the earlier {name} is kept in {kept}")
        except KeyboardInterrupt as stop:
            self.store.abandon(name, "interrupted", str(stop) or "interrupted at the keyboard")
            raise
        except Exception as error:
            if self.interrupted():
                self.store.abandon(name, "interrupted", "interrupted at the keyboard")
            elif isinstance(error, MinidualError):
                self.store.abandon(name, "error", error.message)
            else:
                raise self._crashed(name, error) from error
            raise

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
