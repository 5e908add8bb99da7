"""Gates of a run: the state of each stage, and whether it may run; see docs/verdicts.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minidual.config.loader import LoadedConfig, Override
from minidual.errors import DataError, MinidualError, UsageError
from minidual.gate.canonical import canonical
from minidual.gate.circumstances import circumstances_now
from minidual.gate.fingerprint import Fingerprint
from minidual.gate.footing import footing
from minidual.gate.state import StageState, State
from minidual.gate.store import RunStore, StageAttempt
from minidual.gate.table import StageTable, overrides
from minidual.gate.verdict import Verdict, manifest_changes, strays


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

    def requires(self, name: str) -> tuple[str, ...]:
        """Return the stages that must pass and be fresh for a stage, under its configuration."""
        entry = self.table[name]
        if entry.needs is None:
            return entry.requires
        try:
            stored = self.store.verdict(name)
            _, loaded = self.effective(name, None if stored is None else stored[0])
        except MinidualError:  # the state of the stage says what is wrong
            return entry.requires
        return entry.required(loaded.config)

    def needed(self, name: str) -> tuple[str, ...]:
        """Return the stages that a stage requires, directly or not, in order."""
        return self.table.upstream(name, self.requires)

    def upstream(self, name: str) -> tuple[str, ...]:
        """Return the stages whose verdicts count for a stage, in order.

        A closing stage reports on all that may be required, needed or not.
        """
        if self.table[name].closing:
            return self.table.upstream(name)
        return self.needed(name)

    def until(self, last: str | None, force: bool = False) -> tuple[str, ...]:
        """Return `last` and its upstream stages, in order; without `last` every stage.

        If `last` would run again, it does so under the configuration, without options.
        """
        if last is None:
            return tuple(self.table)
        gate = self
        last = self.table[last].name  # refuses an unknown one
        if force or self.state(last).state != "pass":
            gate = Gate(self.table, self.store, self.loaded, {**self.options, last: {}})
        return (*gate.upstream(last), last)

    def verdicts(self, name: str) -> dict[str, Verdict]:
        """Return {upstream stage: verdict}, without missing ones."""
        verdicts: dict[str, Verdict] = {}
        for upstream in self.upstream(name):
            verdict = self.state(upstream).verdict
            if verdict is not None:
                verdicts[upstream] = verdict
        return verdicts

    def closed_by(self, name: str) -> list[StageState]:
        """Return the directly required stages that do not pass."""
        required = map(self.state, self.requires(name))
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
            below = any(required in running for required in self.requires(name))
            if force or not fresh or below:
                running.append(name)
        return running

    def replaced(self, names: Sequence[str], force: bool) -> dict[str, str]:
        """Return the finished stages that other options would replace.

        Changed code, profile files or upstream stages alone do not count.

        Returns:
            {stage: how it was made and what is asked for}.
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
                replaced[name] = f"made with {made_with}, asked for is {' '.join(typed)}"
        return replaced

    def typed(self, name: str) -> list[str]:
        """Return profile, settings and options of `name` as typed."""
        options, loaded = self.effective(name, None)
        extras = [f"--{key} {value}" for key, value in self.table[name].extras(options).items()]
        return [f"--profile {loaded.profile}", *(item.text for item in loaded.overrides), *extras]

    def shut(self, name: str, verdict: Verdict | None) -> list[StageState]:
        """Return the required stages that do not pass, without those that a verdict waived."""
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
        upstream = {stage: self.state(stage) for stage in self.upstream(name)}
        stands_on = footing(entry, upstream)
        return Fingerprint(
            parameters=canonical(entry.parameters(loaded.config), f"{name}.parameters"),
            options=canonical(entry.extras(options), f"{name}.options"),
            inputs=stands_on.inputs,
            upstream=stands_on.upstream,
            seed=loaded.config.seed,
            profile=loaded.profile,
            version=now.version,
            commit=now.commit,
            machine=now.machine,
            libraries=now.libraries,
            code=entry.code(None if verdict is None else verdict.fingerprint.code),
        )

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
        shut = self.shut(name, verdict)
        if self.table[name].closing and verdict.status == "pass":
            shut += self._read_unneeded(name, verdict)
        for upstream in shut:
            reasons.append(f"upstream stage {upstream.name} is {upstream.state}")
        return reasons

    def _read_unneeded(self, name: str, verdict: Verdict) -> list[StageState]:
        """Return the stages that a verdict reports on, that no gate asks for and do not pass."""
        needed = self.needed(name)
        read = [stage for stage, sha256 in verdict.fingerprint.upstream.items() if sha256]
        unneeded = [stage for stage in read if stage in self.table and stage not in needed]
        states = [self.state(stage) for stage in unneeded]
        return [state for state in states if state.state != "pass"]

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


def _begun(attempt: StageAttempt) -> str:
    text = "begun"
    if attempt.started_at:
        text += f" {attempt.started_at} by process {attempt.pid}"
    if attempt.options:
        text += f" with {attempt.options}"
    return f"{text}, {attempt.message or 'still running'}"
