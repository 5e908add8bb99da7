"""Bodies of the commands."""

import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

from minidual import emergency
from minidual.cli.console import (
    ConsoleProgress,
    print_explanation,
    print_lowest,
    print_outcome,
    print_status,
)
from minidual.cli.session import Session
from minidual.durable import disk_errors
from minidual.errors import DataError, EnvironmentMissingError, ExitCode, UsageError
from minidual.gate.gate import StageState
from minidual.gate.lock import LOCK_FILE, held_by, lock_holders, run_lock
from minidual.gate.runner import StageOutcome
from minidual.gate.signature import sign, signature, unverified
from minidual.gate.stage import ToolContext
from minidual.gate.table import StageEntry, ToolEntry, overrides

Body = Callable[[Session, Mapping[str, Any]], ExitCode]
"""Runs a command with its own options. Its docstring is the help: a summary, then examples."""


def run_stage(entry: StageEntry, session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Run a stage, or its aside that was typed, and print the result."""
    aside = next((aside for aside in entry.asides if _was_typed(values[aside.trigger])), None)
    _refuse_loose_options(entry, aside, values)
    if aside is not None:
        entry.resolved(session.loaded.config, checked=True)
        return run_tool(aside, session, values)
    options = {o.name: values[o.key] for o in entry.options if values[o.key] is not None}
    if not values["yes"]:
        session.spare_finished([entry.name], {entry.name: options}, values["force"])
    with session.view(values) as view:
        outcome = session.runner(view).run(
            entry.name,
            options,
            force=values["force"],
            waiver=values["waive_gate"],
        )
    if view is not None and not outcome.ran:
        session.say(f"nothing to watch: {entry.name} is passing and fresh; --force runs it again")
    following = session.following()
    print_outcome(session.people, outcome, following)
    session.finish(
        {**_outcome_json(outcome), "next": following},
        [session.store.verdict_path(entry.name)],
    )
    return outcome.exit_code


def run_tool(tool: ToolEntry, session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Run a tool and print its result."""
    typed = {
        option.name: values[option.key] for option in tool.options if _was_typed(values[option.key])
    }
    config = session.loaded.with_overrides(overrides(tool.options, typed)).config
    folder = session.store.folder
    own = f"-{os.getpid()}" if tool.shared else ""
    found_by_stop = folder, session.typed.command(tool.name), f".{tool.name}{own}.lock"
    lock = run_lock(*found_by_stop) if tool.moves else nullcontext()
    with session.view(values, tool.view_default) as view, disk_errors(folder), lock:
        about: Any = {
            "config": config,
            "seed": config.seed,
            "profile": session.loaded.profile,
            "name": tool.name,
        }
        about |= {
            "options": typed,
            "view": view,
            "run_folder": folder,
            "command": session.typed.command,
        }
        context = ToolContext(
            **about,
            progress=ConsoleProgress(session.people),
            workers=config.workers if view is None else 1,
            gate=session.gate(),
            shipped=session.loaded.shipped,
        )
        context.begin()
        result = tool.load()(context)
        emergency.check()
        context.publish()
    for note in result.notes:
        session.say(note)
    lines = map(session.in_this_run, result.lines)
    session.finish({"tool": tool.name, "exit_code": int(result.exit_code), **result.data}, lines)
    return result.exit_code


def _was_typed(value: Any) -> bool:
    return value is not None and value is not False


def _refuse_loose_options(
    entry: StageEntry,
    aside: ToolEntry | None,
    values: Mapping[str, Any],
) -> None:
    chosen = aside or entry
    typed = [f"--{item.trigger}" for item in entry.asides if _was_typed(values[item.trigger])]
    if len(typed) > 1:
        raise UsageError(f"{' and '.join(typed)} exclude each other; type one of them")
    takers: dict[str, list[StageEntry | ToolEntry]] = {}
    for command in (entry, *entry.asides):
        for option in command.options:
            if _was_typed(values[option.key]):
                takers.setdefault(f"--{option.name}", []).append(command)
    if values.get("view") not in (None, "none"):
        takers["--view"] = [command for command in (entry, *entry.asides) if command.watchable]
    takers |= {
        f"--{name.replace('_', '-')}": [entry]
        for name in ("force", "waive_gate", "yes")
        if values[name]
    }
    for flag, commands in takers.items():
        if chosen not in commands:
            triggers = " or ".join(
                f"--{aside.trigger}" for aside in entry.asides if aside in commands
            )
            with_what = (
                f"{triggers} of {entry.name}" if triggers else f"the stage {entry.name} itself"
            )
            without = f", not with --{aside.trigger}" if aside else ""
            raise UsageError(f"{flag} goes with {with_what}{without}")


def _outcome_json(outcome: StageOutcome) -> dict[str, Any]:
    state = _state_json(outcome.state)
    return {
        "stage": state["name"],
        "ran": outcome.ran,
        **state,
        "verdict": outcome.verdict.to_json(),
    }


def run_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Run every stage that is not passing and fresh, in order.

    run
    run --until carry --profile smoke
    run --sign ~/.ssh/id_ed25519
    """
    until = values["until"]
    force = values["force"]
    key = values["sign"]
    if key is not None:
        signature(key, b"")  # a key that cannot sign is told before the work
    names = session.table.until(until)
    if not values["yes"]:
        session.spare_finished(names, {}, force)
    outcomes: list[StageOutcome] = []
    with session.view(values) as view:
        for outcome in session.runner(view).run_until(
            until,
            force=force,
            waiver=values["waive_gate"],
        ):
            outcomes.append(outcome)
            if outcome.ran:
                print_outcome(session.people, outcome, "")
            else:
                session.say(f"{outcome.state.name}: pass, fresh")
    code = next((o.exit_code for o in outcomes if o.exit_code != ExitCode.PASS), ExitCode.PASS)
    gate = session.gate()
    store = session.store
    print_status(session.people, gate, f"run {store.run}", session.following(gate))
    if key is not None:
        session.say(
            "not signed: a stage does not pass" if code else f"signed: {sign(gate, names, key)}",
        )
    document = {
        "run": store.run,
        "exit_code": int(code),
        "stages": [_outcome_json(o) for o in outcomes],
    }
    session.finish(document, [store.verdict_path(outcome.state.name) for outcome in outcomes])
    return code


def status_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Show which stages pass, are stale, missing or blocked, and why.

    status
    status --profile smoke --json
    status --verify ~/.ssh/id_ed25519.pub
    """
    return _show_status(session, explained=False, key=values["verify"])


def _show_status(session: Session, *, explained: bool, key: Path | None = None) -> ExitCode:
    gate = session.gate()
    store = session.store
    changed = None if key is None else unverified(gate, key)
    following = session.following(gate, explained=explained)
    lowest = gate.lowest()
    _, writer = held_by(store.folder / LOCK_FILE) or (0, None)
    if not session.typed.json:
        title = f"run {store.run} (profile {session.loaded.profile}, {store.folder})"
        print_status(session.data, gate, title, "" if explained else following)
        if explained:
            print_lowest(session.data, lowest, following, session.in_this_run)
        if writer is not None:
            session.say(f"being written by {writer}")
    for line in ["the verdicts and artefacts are as signed"] if changed == [] else changed or ():
        session.say(f"signature: {line}", "bold red" if changed else "green")
    document = {
        "run": store.run,
        "folder": store.folder,
        "profile": session.loaded.profile,
        "writer": writer,
    }
    document |= {
        "stages": [_state_json(gate.state(name)) for name in session.table],
        "lowest": lowest and lowest.name,
    }
    document |= {"because": lowest.because() if lowest else (), "next": following}
    document |= {"signature": {"key": key, "changed": changed} if key else None}
    session.finish(document, ())
    return ExitCode.ACCEPTANCE_FAILED if changed else ExitCode.PASS


def _state_json(state: StageState) -> dict[str, Any]:
    verdict = state.verdict
    return {
        **{
            name: getattr(state, name)
            for name in ("name", "state", "reasons", "warnings", "folder")
        },
        "status": verdict.status if verdict else None,
        "acceptance": verdict.acceptance if verdict else False,
        "failed": [check.to_json() for check in verdict.failed_checks()] if verdict else [],
        "weakened": verdict.weakened if verdict else (),
        "waivers": [waiver.reason for waiver in verdict.waivers] if verdict else [],
    }


def explain_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Explain one stage: checks, margins, remedies, staleness; or what to look at first.

    explain
    explain deploy
    """
    if values["stage"] is None:
        return _show_status(session, explained=True)
    entry = session.table[values["stage"]]
    gate = session.gate()
    state = gate.state(entry.name)
    upstream = {name: gate.state(name).state for name in entry.requires}
    lowest = gate.lowest()
    if not session.typed.json:
        print_explanation(session.data, entry, state, upstream, session.in_this_run)
        if state.state == "pass":
            session.say(f"to run it again: {session.typed.command(f'{entry.name} --force')}")
        else:
            print_lowest(
                session.data,
                lowest,
                session.following(gate, explained=True),
                session.in_this_run,
            )
    document = {
        **_state_json(state),
        "summary": entry.summary,
        "requires": upstream,
        "verdict": state.verdict.to_json() if state.verdict else None,
        "lowest": lowest and lowest.name,
    }
    session.finish(document, ())
    return ExitCode.PASS


def stop_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Emergency stop: the arms of running commands stop, and the commands end; without a name, in every run.

    stop
    stop standard
    """
    root = session.root
    named = values["name"]
    typed = session.typed
    run = session.store.run if typed.run is not None or typed.profile != "standard" else None
    if named == "" or (named is not None and run not in (None, named)):
        twice = (
            f"two runs are named, '{named}' and '{run}'"
            if named
            else "the name of the run is empty"
        )
        raise UsageError(twice, remedy="minidual stop RUN stops one run, minidual stop every run")
    wanted = named or run
    runs = sorted(root.glob("*/"))
    holders = (
        lock_holders(root / wanted)
        if wanted
        else {k: v for run in runs for k, v in _holders(run).items()}
    )
    for pid in holders:
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(pid, emergency.SIGNAL)
    if not holders:
        where = f"run '{wanted}' of {root}" if wanted else f"the runs in {root}"
        where += "" if root.is_dir() else ", which is no folder"
        remedy = (
            "--runs-dir DIR names another folder of runs; kill -USR1 PID stops any minidual process"
        )
        if others := ", ".join(folder.name for folder in runs if _holders(folder)):
            remedy = f"a command is working in {others}; minidual stop, without a name, stops all"
        raise UsageError(f"nothing to stop: no command is working in {where}", remedy=remedy)
    said = [f"emergency stop sent to {text}" for text in holders.values()]
    session.finish({"stopped": sorted(holders), "exit_code": int(ExitCode.PASS)}, said)
    return ExitCode.PASS


def _holders(folder: Path) -> dict[int, str]:
    """Return who works in a run; a damaged lock keeps nobody in another run from being stopped."""
    with suppress(DataError):
        return lock_holders(folder)
    return {}


def config_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Print the resolved configuration as YAML.

    config show --profile smoke
    config show --set plan.queries_n=30 --json
    """
    loaded = session.loaded
    if loaded.config != loaded.reference():  # the shipped ones are shown without slow imports
        for entry in session.table.values():
            with suppress(EnvironmentMissingError):  # the run's machine may have it
                entry.resolved(loaded.config, checked=True)
    texts = [item.text for item in loaded.overrides]
    document = {
        "profile": loaded.profile,
        "sources": loaded.sources,
        "overrides": texts,
        "config": loaded.config,
    }
    session.finish(document, loaded.to_yaml().splitlines())
    return ExitCode.PASS
