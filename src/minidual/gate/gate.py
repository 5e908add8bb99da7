"""Gates of a run: the state of each stage, and whether it may run; see docs/verdicts.md."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minidual.config.loader import LoadedConfig, Override
from minidual.errors import DataError, GateClosedError, UsageError
from minidual.gate.canonical import canonical
from minidual.gate.circumstances import circumstances_now
from minidual.gate.fingerprint import Fingerprint
from minidual.gate.state import StageState, State
from minidual.gate.store import RunStore, StageAttempt
from minidual.gate.table import StageTable, overrides
from minidual.gate.verdict import CONFIG_FILE, Verdict, manifest_changes, strays


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
    _states: dict[str, StageState] = field(default_factory=dict[str, StageState])

    def state(self, name: str) -> StageState:
        """Return the state of a stage (cached)."""
        if name not in self._states:
            self._states[name] = self._judge(name)
        return self._states[name]

    def verdicts(self, name: str) -> dict[str, Verdict]:
        """Return {upstream stage: verdict}, without missing ones."""
        verdicts: dict[str, Verdict] = {}
        for upstream in self.table.upstream(name):
            verdict = self.state(upstream).verdict
            if verdict is not None:
                verdicts[upstream] = verdict
        return verdicts

    def closed_by(self, name: str) -> list[StageState]:
        """Return the directly required stages that do not pass."""
        required = map(self.state, self.table[name].requires)
        return [state for state in required if state.state != "pass"]

    def lowest(self) -> StageState | None:
        """Return the first stage that does not pass, or None."""
        for name in self.table:
            state = self.state(name)
            if state.state != "pass":
                return state
        return None

    def rerun(self, names: Sequence[str], force: bool) -> list[str]:
        """Return those of `names` (in table order) that would run.

        A stage runs if it is not passing and fresh, or downstream of one that runs.
        """
        running: list[str] = []
        for name in names:
            fresh = self.state(name).state == "pass"
            below = any(required in running for required in self.table[name].requires)
            if force or not fresh or below:
                running.append(name)
        return running

    def replaced(self, names: Sequence[str], force: bool) -> dict[str, str]:
        """Return the finished stages that other options would replace.

        Changed code, profile files or upstream stages alone do not count.

        Returns:
            {stage: how it was made and what was typed}.
        """
        options = {name: self.options.get(name, {}) for name in names}
        gate = Gate(self.table, self.store, self.loaded, options, self._states)
        replaced: dict[str, str] = {}
        for name in self.rerun(names, force):
            verdict = self.state(name).verdict
            if verdict is None:
                continue
            made = {f"--profile {verdict.fingerprint.profile}", *verdict.overrides}
            typed = gate.typed(name)
            if made == {*typed}:
                continue
            if verdict.fingerprint.choices(gate.fingerprint(name, verdict)):
                made_with = " ".join(sorted(made))
                replaced[name] = f"made with {made_with}, typed was {' '.join(typed)}"
        return replaced

    def typed(self, name: str) -> list[str]:
        """Return profile, settings and options of `name` as typed."""
        options, loaded = self.effective(name, None)
        extras = [f"--{key} {value}" for key, value in self.table[name].extras(options).items()]
        return [f"--profile {loaded.profile}", *(item.text for item in loaded.overrides), *extras]

    def closed_error(self, name: str, command: Callable[[str], str]) -> GateClosedError:
        """Return the error with cause, failed check and command to type.

        Args:
            name: Stage whose gate is closed.
            command: Turns "plan" into the full command.
        """
        unfinished = self._unfinished(name)
        cause = unfinished[0]
        message = f"the gate of {name} is closed: {cause.name} {_ended(cause)}"
        if cause.state not in ("missing", "blocked") and cause.why():
            message += f": {cause.why()}"
        if len(unfinished) == 1:
            remedy = command(cause.name)
        else:
            remedy = command(f"run --until {unfinished[-1].name}")
        if cause.state == "fail" and cause.verdict is not None:
            first = cause.verdict.failed_checks()[0]
            if first.remedy:
                remedy = f"{first.remedy.rstrip('.')}, then: {remedy}"
        return GateClosedError(message, remedy=f"{remedy}; then this command again")

    def _unfinished(self, name: str) -> list[StageState]:
        """Return the upstream stages, in order, that keep the gate of `name` closed."""
        upstream = self.table.upstream(name)
        shut = {state.name for state in self.closed_by(name)}
        for stage in upstream:
            shut |= {state.name for state in self._shut(stage, self.state(stage).verdict)}
        return [self.state(stage) for stage in upstream if stage in shut]

    def _shut(self, name: str, verdict: Verdict | None) -> list[StageState]:
        """Return the required stages that do not pass, without those that the verdict waived."""
        waived: dict[str, str] = {}
        for waiver in () if verdict is None else verdict.waivers:
            if waiver.stage == name:
                waived |= waiver.blocking
        return [state for state in self.closed_by(name) if waived.get(state.name) != state.state]

    def code_changes(self, name: str) -> dict[str, list[str]]:
        """Return {upstream stage: modules changed since its verdict}."""
        changes: dict[str, list[str]] = {}
        for upstream, verdict in self.verdicts(name).items():
            code = verdict.fingerprint.code
            modules = code.changes(self.table[upstream].code(code))
            if modules:
                changes[upstream] = modules
        return changes

    def effective(self, name: str, verdict: Verdict | None) -> tuple[dict[str, Any], LoadedConfig]:
        """Return (options, configuration) that `name` is judged or run with."""
        entry = self.table[name]
        recorded = {} if verdict is None else verdict.options
        options = dict(self.options.get(name, recorded))
        values: list[Override] = []
        if entry.closing:  # it reports on what its upstream stages were asked for
            for upstream in entry.requires:
                upstream_verdict = self.state(upstream).verdict
                if upstream_verdict is not None:
                    settings = self.table[upstream].settings
                    values += overrides(settings, upstream_verdict.options)
        values += overrides(entry.settings, options)
        return options, self.loaded.with_overrides(values)

    def fingerprint(self, name: str, verdict: Verdict | None = None) -> Fingerprint:
        """Return the fingerprint of a new verdict, under the options of an old one if given."""
        entry = self.table[name]
        options, loaded = self.effective(name, verdict)
        now = circumstances_now(self.table.libraries)
        return Fingerprint(
            parameters=canonical(entry.parameters(loaded.config), f"{name}.parameters"),
            options=canonical(entry.extras(options), f"{name}.options"),
            inputs=self._inputs(name),
            upstream={up: self.state(up).verdict_sha256 for up in self.table.upstream(name)},
            seed=loaded.config.seed,
            profile=loaded.profile,
            version=now.version,
            commit=now.commit,
            machine=now.machine,
            libraries=now.libraries,
            code=entry.code(None if verdict is None else verdict.fingerprint.code),
        )

    def _inputs(self, name: str) -> dict[str, str]:
        """Return {"stage/path": sha256} of the artefacts of the required stages."""
        inputs: dict[str, str] = {}
        for required in self.table[name].requires:
            verdict = self.state(required).verdict
            if verdict is None:
                continue
            for path, artefact in verdict.artefacts.items():
                if path != CONFIG_FILE:  # already part of its verdict
                    inputs[f"{required}/{path}"] = artefact.sha256
        return inputs

    def _judge(self, name: str) -> StageState:
        folder = self.store.stage_folder(name)
        try:
            stored = self.store.verdict(name)
        except DataError as error:
            return StageState(name, "error", (error.message,), folder=folder)
        if stored is None:
            return self._judge_unfinished(name)
        verdict, sha256 = stored
        try:
            now = self.fingerprint(name, verdict)
        except UsageError as error:
            reason = f"it was made with an option that is not valid now: {error.message}"
            return StageState(name, "stale", (reason,), (), verdict, sha256, folder)
        others = strays(folder, verdict.artefacts)
        reasons = self._stale_reasons(name, verdict, now, folder, others)
        state: State = "stale" if reasons else verdict.status
        if state == "error":
            reasons = ["nothing was evaluated: no check with a limit"]
        warnings = verdict.fingerprint.circumstances(now)
        warnings += [f"{path} is not one of its artefacts" for path in others if "/" not in path]
        attempt = self.store.attempt(name)
        if attempt is not None:
            end = f"{attempt.state} ({attempt.message or 'under way'})"
            warnings.append(f"a later attempt ended as {end}")
        return StageState(name, state, tuple(reasons), tuple(warnings), verdict, sha256, folder)

    def _stale_reasons(
        self,
        name: str,
        verdict: Verdict,
        now: Fingerprint,
        folder: Path,
        others: Sequence[str],
    ) -> list[str]:
        """Return why a verdict is stale; `others` are files in its folder that it does not list."""
        reasons = manifest_changes(folder, verdict.artefacts)
        # Later stages read whole subfolders (episodes, data sets, checkpoints).
        for path in others:
            if "/" in path:
                reasons.append(f"{path} is not one of its artefacts; move it away")
        reasons += verdict.fingerprint.differences(now)
        made_for = verdict.acceptance_profile
        if made_for != self.loaded.config.acceptance:
            reasons.append(f"acceptance of the profile was {made_for}, is not now")
        for upstream in self._shut(name, verdict):
            reasons.append(f"upstream stage {upstream.name} is {upstream.state}")
        return reasons

    def _judge_unfinished(self, name: str) -> StageState:
        attempt = self.store.attempt(name)
        if attempt is not None and attempt.state == "error":
            return StageState(name, "error", (attempt.message,))
        if attempt is not None:
            return StageState(name, "incomplete", (_begun(attempt),))
        blocking = tuple(f"{item.name} is {item.state}" for item in self.closed_by(name))
        if blocking:
            return StageState(name, "blocked", blocking)
        return StageState(name, "missing", ("it has not run",))


def _ended(cause: StageState) -> str:
    words = {
        "pass": "passed",
        "fail": "failed",
        "missing": "has not run",
        "error": "ended in error",
    }
    return words.get(cause.state, f"is {cause.state}")


def _begun(attempt: StageAttempt) -> str:
    text = "begun"
    if attempt.started_at:
        text += f" {attempt.started_at} by process {attempt.pid}"
    if attempt.options:
        text += f" with {attempt.options}"
    return f"{text}, {attempt.message or 'still running'}"
