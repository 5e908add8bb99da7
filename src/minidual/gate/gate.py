"""State of each stage and of its gate; see docs/verdicts.md."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

from minidual.config.loader import LoadedConfig, Override
from minidual.errors import DataError, GateClosedError, UsageError, shortened
from minidual.gate.canonical import canonical
from minidual.gate.fingerprint import Fingerprint, circumstances_now
from minidual.gate.store import RunStore
from minidual.gate.table import StageTable, overrides
from minidual.gate.verdict import CONFIG_FILE, Verdict, manifest_changes, strays

State = Literal["pass", "fail", "error", "stale", "missing", "incomplete", "blocked"]


class StageState(NamedTuple):
    """State of a stage.

    Attributes:
        reasons: Why it is not pass or fail.
        warnings: Changes that do not make it stale.
    """

    name: str
    state: State
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    verdict: Verdict | None = None
    verdict_sha256: str | None = None
    folder: Path | None = None

    def because(self) -> list[str]:
        """Return failed checks with why and remedy, or the reasons."""
        if self.state != "fail" or self.verdict is None:
            return [f"{self.name} is {self.state}", *(f"  {reason}" for reason in self.reasons)]
        lines: list[str] = []
        for check in self.verdict.failed_checks():
            lines.append(f"{self.name}: {check.sentence()}")
            lines += [
                f"  {label}: {text}"
                for label, text in (("why", check.why), ("remedy", check.remedy))
                if text
            ]
        return lines

    def why(self) -> str:
        """Return the first failed check, or the first two reasons."""
        if self.state == "fail" and self.verdict is not None:
            return shortened([check.sentence() for check in self.verdict.failed_checks()], 1)
        return shortened(self.reasons, 2, "; ")


@dataclass
class Gate:
    """Determines the states of a run's stages under a configuration.

    Attributes:
        options: {stage: command-line options}; default: those of its verdict.
    """

    table: StageTable
    store: RunStore
    loaded: LoadedConfig
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict[str, Mapping[str, Any]])
    _known: dict[str, StageState] = field(default_factory=dict[str, StageState])

    def state(self, name: str) -> StageState:
        """Return the state of a stage (cached)."""
        if name not in self._known:
            self._known[name] = self._judge(name)
        return self._known[name]

    def verdicts(self, name: str) -> dict[str, Verdict]:
        """Return {upstream stage: verdict}, without missing ones."""
        return {
            up: verdict
            for up in self.table.upstream(name)
            if (verdict := self.state(up).verdict) is not None
        }

    def closed_by(self, name: str) -> list[StageState]:
        """Return the directly required stages that do not pass."""
        return [
            state
            for required in self.table[name].requires
            if (state := self.state(required)).state != "pass"
        ]

    def _shut(self, name: str, verdict: Verdict | None) -> list[StageState]:
        given = verdict.waivers if verdict else ()
        waived = {
            up: state
            for waiver in given
            if waiver.stage == name
            for up, state in waiver.blocking.items()
        }
        return [state for state in self.closed_by(name) if waived.get(state.name) != state.state]

    def lowest(self) -> StageState | None:
        """Return the first stage that does not pass, or None."""
        return next((state for state in map(self.state, self.table) if state.state != "pass"), None)

    def rerun(self, names: Sequence[str], force: bool) -> list[str]:
        """Return those of `names` (in table order) that would run: not passing and fresh, or downstream of one that runs."""
        found: list[str] = []
        for name in names:
            if force or self.state(name).state != "pass" or {*found} & {*self.table[name].requires}:
                found.append(name)
        return found

    def replaced(self, names: Sequence[str], force: bool) -> dict[str, str]:
        """Return {finished stage: how it was made and what was typed} where other options would replace it.

        Changed code, profile files or upstream stages alone do not count.
        """
        options = {name: self.options.get(name, {}) for name in names}
        gate = Gate(self.table, self.store, self.loaded, options, self._known)
        found: dict[str, str] = {}
        for name in self.rerun(names, force):
            if (verdict := self.state(name).verdict) is None:
                continue
            made = {f"--profile {verdict.fingerprint.profile}", *verdict.overrides}
            typed = gate.typed(name)
            if made != {*typed} and verdict.fingerprint.choices(gate.fingerprint(name, verdict)):
                found[name] = f"made with {' '.join(sorted(made))}, typed was {' '.join(typed)}"
        return found

    def typed(self, name: str) -> list[str]:
        """Return profile, settings and options of `name` as typed."""
        options, loaded = self.effective(name, None)
        extras = [f"--{key} {value}" for key, value in self.table[name].extras(options).items()]
        return [f"--profile {loaded.profile}", *(item.text for item in loaded.overrides), *extras]

    def closed_error(self, name: str, command: Callable[[str], str]) -> GateClosedError:
        """Return the error with cause, failed check and command to type."""
        chain = self.table.upstream(name)
        shut = {state.name for up in chain for state in self._shut(up, self.state(up).verdict)}
        shut |= {state.name for state in self.closed_by(name)}
        unfinished = [self.state(up) for up in chain if up in shut]
        cause = unfinished[0]
        mend = command(cause.name if len(unfinished) == 1 else f"run --until {unfinished[-1].name}")
        article = "ended in error" if cause.state == "error" else f"is {cause.state}"
        words = {"pass": "passed", "fail": "failed", "missing": "has not run"}.get(
            cause.state,
            article,
        )
        text = f"the gate of {name} is closed: {cause.name} {words}"
        if cause.state not in ("missing", "blocked") and cause.why():
            text += f": {cause.why()}"
        failed = cause.verdict.failed_checks() if cause.state == "fail" and cause.verdict else []
        advice = f"{failed[0].remedy.rstrip('.')}, then: " if failed and failed[0].remedy else ""
        return GateClosedError(text, remedy=f"{advice}{mend}; then this command again")

    def code_changes(self, name: str) -> dict[str, list[str]]:
        """Return {upstream stage: modules changed since its verdict}."""
        made_by = {
            upstream: verdict.fingerprint.code for upstream, verdict in self.verdicts(name).items()
        }
        found = {
            upstream: code.changes(self.table[upstream].code(code))
            for upstream, code in made_by.items()
        }
        return {upstream: changed for upstream, changed in found.items() if changed}

    def effective(self, name: str, verdict: Verdict | None) -> tuple[dict[str, Any], LoadedConfig]:
        """Return (options, configuration) that `name` is judged or run with."""
        entry = self.table[name]
        recorded = {} if verdict is None else verdict.options
        options = dict(self.options.get(name, recorded))
        values: list[Override] = []
        if entry.closing:  # it reports on what its upstream stages were asked for
            for upstream in entry.requires:
                made = self.state(upstream).verdict
                if made is not None:
                    values += overrides(self.table[upstream].settings, made.options)
        values += overrides(entry.settings, options)
        return options, self.loaded.with_overrides(values)

    def fingerprint(self, name: str, verdict: Verdict | None = None) -> Fingerprint:
        """Return the fingerprint of a new verdict."""
        entry = self.table[name]
        options, loaded = self.effective(name, verdict)
        inputs = {
            f"{required}/{path}": artefact.sha256
            for required in entry.requires
            if (upstream := self.state(required).verdict) is not None
            for path, artefact in upstream.artefacts.items()
            if path != CONFIG_FILE  # the upstream's configuration is already part of its verdict
        }
        return Fingerprint(
            parameters=canonical(entry.parameters(loaded.config), f"{name}.parameters"),
            options=canonical(entry.extras(options), f"{name}.options"),
            inputs=inputs,
            upstream={up: self.state(up).verdict_sha256 for up in self.table.upstream(name)},
            seed=loaded.config.seed,
            profile=loaded.profile,
            **circumstances_now(self.table.libraries),
            code=entry.code(verdict.fingerprint.code if verdict else None),
        )

    def _judge(self, name: str) -> StageState:
        folder = self.store.stage_folder(name)
        try:
            found = self.store.verdict(name)
        except DataError as error:
            return StageState(name, "error", (error.message,), folder=folder)
        if found is None:
            return self._judge_unfinished(name)
        verdict, sha256 = found
        try:
            now = self.fingerprint(name, verdict)
        except UsageError as error:
            reason = f"it was made with an option that is not valid now: {error.message}"
            return StageState(name, "stale", (reason,), (), verdict, sha256, folder)
        reasons = manifest_changes(folder, verdict.artefacts)
        extra = strays(folder, verdict.artefacts)
        # Later stages read whole subfolders (episodes, data sets, checkpoints).
        reasons += [
            f"{path} is not one of its artefacts; move it away" for path in extra if "/" in path
        ]
        reasons += verdict.fingerprint.differences(now)
        if verdict.acceptance_profile != self.loaded.config.acceptance:
            reasons.append(
                f"acceptance of the profile was {verdict.acceptance_profile}, is not now",
            )
        reasons += [
            f"upstream stage {upstream.name} is {upstream.state}"
            for upstream in self._shut(name, verdict)
        ]
        state: State = "stale" if reasons else verdict.status
        if state == "error":
            reasons = ["nothing was evaluated: no check with a limit"]
        warnings = verdict.fingerprint.circumstances(now)
        warnings += [f"{path} is not one of its artefacts" for path in extra if "/" not in path]
        if (attempt := self.store.attempt(name)) is not None:
            warnings.append(
                f"a later attempt ended as {attempt.state} ({attempt.message or 'under way'})",
            )
        return StageState(name, state, tuple(reasons), tuple(warnings), verdict, sha256, folder)

    def _judge_unfinished(self, name: str) -> StageState:
        attempt = self.store.attempt(name)
        if attempt is not None and attempt.state == "error":
            return StageState(name, "error", (attempt.message,))
        if attempt is not None:
            by = (
                f"begun {attempt.started_at} by process {attempt.pid}"
                if attempt.started_at
                else "begun"
            )
            began = f"{by} with {attempt.options}" if attempt.options else by
            return StageState(
                name,
                "incomplete",
                (f"{began}, {attempt.message or 'still running'}",),
            )
        if closed := self.closed_by(name):
            return StageState(
                name,
                "blocked",
                tuple(f"{item.name} is {item.state}" for item in closed),
            )
        return StageState(name, "missing", ("it has not run",))
