"""Run one stage or tool for a command, and print its result."""

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from minidual import emergency
from minidual.cli.console import print_outcome
from minidual.cli.documents import outcome_document
from minidual.cli.options import GateOptions, ViewOptions
from minidual.cli.own_run import say_outdated, spare_finished
from minidual.cli.session import Session
from minidual.cli.terminal import ConsoleProgress
from minidual.durable import disk_errors
from minidual.errors import ExitCode, UsageError
from minidual.gate.lock import run_lock
from minidual.gate.stage import ToolContext
from minidual.gate.table import StageEntry, ToolEntry, overrides

NO_VIEW = ViewOptions()
Values = Mapping[str, Any]
"""{option without dashes: typed value, or None or False}."""


@dataclass(frozen=True)
class Aside:
    """Other work of a stage's command, which runs instead if its trigger was typed.

    Attributes:
        name: Row among the stage's `asides`.
        trigger: Option that asks for it.
        options: Options that it takes, with the trigger.
    """

    name: str
    trigger: str
    options: Values

    @property
    def asked_for(self) -> bool:
        """Whether its trigger was typed."""
        return was_typed(self.options[self.trigger])


def was_typed(value: Any) -> bool:
    """Return whether an option was typed; a flag that was not is False."""
    return value is not None and value is not False


def run_stage(
    session: Session,
    name: str,
    options: Values,
    gate_options: GateOptions,
    view_options: ViewOptions = NO_VIEW,
    asides: Sequence[Aside] = (),
) -> ExitCode:
    """Run a stage, or the aside that was asked for, and print the result.

    Args:
        session: The command's.
        name: Stage.
        options: Options of the stage itself.
        gate_options: Shared options.
        view_options: Shared options.
        asides: What its command can do instead.

    Raises:
        UsageError: An option goes with another aside, or two asides were asked for.
    """
    entry = session.table[name]
    aside = next((aside for aside in asides if aside.asked_for), None)
    _refuse_loose_options(entry, options, gate_options, view_options, asides)
    if aside is not None:
        entry.resolved(session.loaded.config, checked=True)
        tool = next(tool for tool in entry.asides if tool.name == aside.name)
        return run_tool(session, tool, aside.options, view_options)
    typed = {option: value for option, value in options.items() if value is not None}
    if not gate_options.yes:
        spare_finished(session, [name], {name: typed}, gate_options.force)
    else:
        say_outdated(session, [name])
    session.say_remembered()
    with session.view(view_options) as view:
        outcome = session.runner(view).run(
            name,
            typed,
            force=gate_options.force,
            waiver=gate_options.waive_gate,
        )
    if view is not None and not outcome.ran:
        session.say(f"nothing to watch: {name} is passing and fresh; --force runs it again")
    session.drop_remembered()
    following = session.following()
    print_outcome(session.people, entry, outcome, following)
    document = {**outcome_document(outcome), "next": following}
    session.finish(document, [session.store.verdict_path(name)])
    return outcome.exit_code


def run_tool(
    session: Session,
    tool: ToolEntry,
    options: Values,
    view_options: ViewOptions = NO_VIEW,
) -> ExitCode:
    """Run a tool and print its result."""
    typed = {option: value for option, value in options.items() if was_typed(value)}
    config = session.loaded.with_overrides(overrides(tool.settings, typed)).config
    session.say_remembered()
    folder = session.store.folder
    lock = nullcontext()
    if tool.moves:
        # `minidual stop` finds the process by its lock.
        own = f"-{os.getpid()}" if tool.shared else ""
        lock = run_lock(folder, session.common.command(tool.name), f".{tool.name}{own}.lock")
    with session.view(view_options, tool.view_default) as view, disk_errors(folder), lock:
        context = ToolContext(
            config=config,
            seed=config.seed,
            profile=session.loaded.profile,
            progress=ConsoleProgress(session.people),
            options=typed,
            workers=config.workers if view is None else 1,
            view=view,
            run_folder=folder,
            name=tool.name,
            gate=session.gate(),
            shipped=session.loaded.shipped,
            command=session.common.command,
        )
        context.begin()
        result = tool.load()(context)
        emergency.check()
        context.publish()
    for note in result.notes:
        session.say(note)
    document = {"tool": tool.name, "exit_code": int(result.exit_code), **result.data}
    session.finish(document, map(session.in_this_run, result.lines))
    return result.exit_code


def _refuse_loose_options(
    entry: StageEntry,
    options: Values,
    gate_options: GateOptions,
    view_options: ViewOptions,
    asides: Sequence[Aside],
) -> None:
    """Raise UsageError for an option that the stage, or the aside asked for, does not take."""
    requested = [aside for aside in asides if aside.asked_for]
    if len(requested) > 1:
        triggers = " and ".join(f"--{aside.trigger}" for aside in requested)
        raise UsageError(f"{triggers} exclude each other; type one of them")
    aside = requested[0] if requested else None
    for flag, takers in _takers(entry, options, gate_options, view_options, asides).items():
        if (entry.name if aside is None else aside.name) in takers:
            continue
        triggers = " or ".join(f"--{other.trigger}" for other in asides if other.name in takers)
        place = f"{triggers} of {entry.name}" if triggers else f"the stage {entry.name} itself"
        instead = "" if aside is None else f", not with --{aside.trigger}"
        raise UsageError(f"{flag} goes with {place}{instead}")


def _takers(
    entry: StageEntry,
    options: Values,
    gate_options: GateOptions,
    view_options: ViewOptions,
    asides: Sequence[Aside],
) -> dict[str, list[str]]:
    """Return {typed option: names of the stage and asides that take it}."""
    takers: dict[str, list[str]] = {}
    by_name = {entry.name: options, **{aside.name: aside.options for aside in asides}}
    for name, values in by_name.items():
        for option, value in values.items():
            if was_typed(value):
                takers.setdefault(f"--{option}", []).append(name)
    if view_options.view not in (None, "none"):
        rows = (entry, *entry.asides)
        takers["--view"] = [row.name for row in rows if row.watchable]
    for flag, value in (
        ("--force", gate_options.force),
        ("--waive-gate", gate_options.waive_gate),
        ("--yes", gate_options.yes),
    ):
        if value:
            takers[flag] = [entry.name]
    return takers
