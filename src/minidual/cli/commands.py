"""Bodies of the commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from minidual.cli.session import Session
from minidual.cli.viewing import live_view
from minidual.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from minidual.gate.gate import StageState
    from minidual.gate.runner import Outcome
    from minidual.gate.table import StageEntry, ToolEntry

Body = Callable[[Session, Mapping[str, Any]], ExitCode]
"""A command's function of session and own options."""


def stage_body(entry: StageEntry) -> Body:
    """Return the body of a stage's command."""

    def body(session: Session, values: Mapping[str, Any]) -> ExitCode:
        from minidual.cli.tables import print_outcome

        for aside in entry.asides:
            if aside.is_asked_for(values):
                return run_tool(aside, session, values, entry)
        _refuse_loose_options(entry, values)
        options = {o.name: values[o.key] for o in entry.options if values[o.key] is not None}
        with live_view(session, values) as view:
            outcome = session.runner(view).run(entry.name, options, force=values["force"], waiver=values["waive_gate"])
        if view is not None and not outcome.ran:
            session.people.print(f"nothing to watch: {entry.name} is passing and fresh; --force runs it again")
        following = session.following()
        print_outcome(session.people, outcome, following)
        if session.typed.json:
            session.print_json({**_outcome_json(outcome), "next": following})
        else:
            print(session.store.verdict_path(entry.name))
        return outcome.exit_code

    return body


def tool_body(tool: ToolEntry) -> Body:
    """Return the body of a tool's command."""
    return lambda session, values: run_tool(tool, session, values)


def run_tool(tool: ToolEntry, session: Session, values: Mapping[str, Any], stage: StageEntry | None = None) -> ExitCode:
    """Run a tool and print its result; an aside takes its stage's options too."""
    from minidual.cli.progress import progress_for
    from minidual.config.loader import Override
    from minidual.gate.disk import disk_errors
    from minidual.gate.tool import ToolContext

    known = (*tool.options, *(stage.options if stage else ()))
    typed = {option.name: values[option.key] for option in known if _was_typed(values[option.key])}
    overrides = [Override(*item) for item in stage.overrides(typed)] if stage else []
    config = session.loaded.with_overrides(overrides).config
    if values.get("view") not in (None, "none") and not tool.watchable:
        raise UsageError(f"{tool.name} shows nothing to a view", remedy="leave out --view")
    with live_view(session, values, tool.view_default) as view:
        context = ToolContext(
            config,
            config.seed,
            config.workers if view is None else 1,
            session.loaded.profile,
            session.store.folder,
            typed,
            progress_for(session.people),
            session.typed.command,
            tool.name,
            view,
        )
        context.begin()
        with disk_errors(session.store.folder):
            result = tool.load()(context)
            context.publish()
    for note in result.notes:
        session.people.print(note, markup=False, highlight=False, soft_wrap=True)
    if session.typed.json:
        session.print_json({"tool": tool.name, "exit_code": int(result.exit_code), **result.data})
    else:
        for line in result.lines:
            print(line)
    return result.exit_code


def _was_typed(value: Any) -> bool:
    """Return whether an option was given; 0 counts."""
    return not (value is None or value is False or value == ())


def _refuse_loose_options(entry: StageEntry, values: Mapping[str, Any]) -> None:
    """Refuse aside options without their trigger."""
    own = {option.name for option in entry.options}
    for aside in entry.asides:
        for option in aside.options:
            if option.name not in own and _was_typed(values[option.key]):
                owners = [a for a in entry.asides if option.name in {o.name for o in a.options}]
                triggers = " or ".join(f"--{name}" for a in owners for name in a.triggers)
                raise UsageError(f"--{option.name} goes with {triggers} of {entry.name}")
    if not entry.watchable and values.get("view") not in (None, "none"):
        triggers = " or ".join(f"--{name}" for a in entry.asides if a.watchable for name in a.triggers)
        raise UsageError(f"--view goes with {triggers} of {entry.name}")


def _outcome_json(outcome: Outcome) -> dict[str, Any]:
    state = outcome.state
    return {
        "stage": state.name,
        "state": state.state,
        "ran": outcome.ran,
        "folder": state.folder,
        "warnings": state.warnings,
        "verdict": outcome.verdict.to_json(),
    }


def run_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Run all stages up to `until` that are not fresh."""
    from minidual.cli.tables import print_outcome, print_status

    until = values["until"]
    if until is not None:
        session.table[until]  # an unknown stage is refused before anything runs
    outcomes: list[Outcome] = []
    with live_view(session, values) as view:
        runner = session.runner(view)
        for outcome in runner.run_until(until, force=values["force"], waiver=values["waive_gate"]):
            outcomes.append(outcome)
            if outcome.ran:
                print_outcome(session.people, outcome, "")
            else:
                session.people.print(f"{outcome.state.name}: pass, fresh")
    code = next((o.exit_code for o in outcomes if o.exit_code != ExitCode.PASS), ExitCode.PASS)
    gate = session.gate()
    states = [gate.state(name) for name in session.table.names]
    print_status(session.people, states, f"run {session.store.run}", session.following(gate))
    if session.typed.json:
        session.print_json(
            {"run": session.store.run, "exit_code": int(code), "stages": [_outcome_json(o) for o in outcomes]}
        )
    else:
        for outcome in outcomes:
            print(session.store.verdict_path(outcome.state.name))
    return code


def status_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Show the state of every stage."""
    from minidual.cli.tables import print_status

    gate = session.gate()
    states = [gate.state(name) for name in session.table.names]
    writer = session.store.writer()
    if session.typed.json:
        session.print_json(
            {
                "run": session.store.run,
                "folder": session.store.folder,
                "profile": session.loaded.profile,
                "writer": writer,
                "stages": [_state_json(state) for state in states],
                "next": session.following(gate),
            }
        )
    else:
        title = f"run {session.store.run} (profile {session.loaded.profile}, {session.store.folder})"
        print_status(session.data, states, title, session.following(gate))
        if writer is not None:
            session.people.print(f"being written by {writer}")
    return ExitCode.PASS


def _state_json(state: StageState) -> dict[str, Any]:
    verdict = state.verdict
    return {
        "name": state.name,
        "state": state.state,
        "reasons": state.reasons,
        "warnings": state.warnings,
        "status": verdict.status if verdict else None,
        "acceptance": verdict.acceptance if verdict else False,
        "failed": [check.to_json() for check in verdict.failed_checks()] if verdict else [],
        "weakened": verdict.weakened if verdict else (),
        "waivers": [waiver.reason for waiver in verdict.waivers] if verdict else [],
    }


def explain_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Explain one stage, or the debug ladder."""
    from minidual.cli.ladder import explain_ladder, ladder_json, print_lowest
    from minidual.cli.tables import print_explanation

    if values["stage"] is None:
        return explain_ladder(session)
    entry = session.table[values["stage"]]
    gate = session.gate()
    state = gate.state(entry.name)
    upstream = [gate.state(name) for name in entry.requires]
    if session.typed.json:
        session.print_json(
            {
                **_state_json(state),
                "summary": entry.summary,
                "requires": {item.name: item.state for item in upstream},
                "folder": state.folder,
                "verdict": state.verdict.to_json() if state.verdict else None,
                "ladder": ladder_json(session, gate),
            }
        )
        return ExitCode.PASS
    if gate.closed_by(entry.name):
        error = gate.closed_error(entry.name, session.typed.command)
        following = f"{error.message}\nnext: {error.remedy}"
    elif state.state == "pass":
        following = f"to run it again: {session.typed.command(f'{entry.name} --force')}"
    else:
        following = f"next: {session.typed.command(entry.name)}"
    print_explanation(session.data, entry, state, upstream, following)
    if state.state != "pass":
        print_lowest(session, gate)
    return ExitCode.PASS


def config_body(session: Session, values: Mapping[str, Any]) -> ExitCode:
    """Print the resolved configuration."""
    loaded = session.loaded
    if session.typed.json:
        session.print_json(
            {
                "profile": loaded.profile,
                "sources": list(loaded.sources),
                "overrides": [item.text for item in loaded.overrides],
                "config": loaded.config,
            }
        )
    else:
        print(loaded.to_yaml(), end="")
    return ExitCode.PASS
