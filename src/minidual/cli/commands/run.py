"""`minidual run`."""

from pathlib import Path
from typing import Annotated

import typer

from minidual.cli.console import print_outcome, print_status
from minidual.cli.documents import outcome_document
from minidual.cli.options import GateOptions, ViewOptions
from minidual.cli.own_run import say_outdated, spare_finished
from minidual.cli.session import Session
from minidual.errors import ExitCode
from minidual.gate.runner import StageOutcome
from minidual.gate.signature import sign, signature


def run(
    *,
    until: Annotated[
        str | None,
        typer.Option(metavar="STAGE", help="Last stage to run."),
    ] = None,
    key: Annotated[
        Path | None,
        typer.Option("--sign", metavar="KEY", help="Sign the verdicts with this OpenSSH key."),
    ] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Run every stage that is not passing and fresh, in order.

    Examples:
        minidual run
        minidual run --until carry --profile smoke
        minidual run --sign ~/.ssh/id_ed25519
    """
    if key is not None:
        signature(key, b"")  # refuses a key that cannot sign before the work begins
    names = session.gate().until(until, gate_options.force)
    if not gate_options.yes:
        spare_finished(session, names, {}, gate_options.force)
    else:
        say_outdated(session, names)
    session.say_remembered()
    outcomes = _outcomes(session, until, view_options, gate_options)
    code = ExitCode.PASS
    for outcome in outcomes:
        if outcome.exit_code != ExitCode.PASS:
            code = outcome.exit_code
            break
    session.drop_remembered()
    gate = session.gate()
    store = session.store
    print_status(session.people, gate, f"run {store.run}", session.following(gate))
    if key is not None and code != ExitCode.PASS:
        session.say("not signed: a stage does not pass")
    elif key is not None:
        session.say(f"signed: {sign(gate, names, key)}")
    document = {
        "run": store.run,
        "exit_code": int(code),
        "stages": [outcome_document(outcome) for outcome in outcomes],
    }
    session.finish(document, [store.verdict_path(outcome.state.name) for outcome in outcomes])
    return code


def _outcomes(
    session: Session,
    until: str | None,
    view_options: ViewOptions,
    gate_options: GateOptions,
) -> list[StageOutcome]:
    """Run the stages and print each outcome."""
    outcomes: list[StageOutcome] = []
    with session.view(view_options) as view:
        for outcome in session.runner(view).run_until(
            until,
            force=gate_options.force,
            waiver=gate_options.waive_gate,
        ):
            outcomes.append(outcome)
            if outcome.ran:
                entry = session.table[outcome.state.name]
                print_outcome(session.people, entry, outcome, "")
            else:
                session.say(f"{outcome.state.name}: pass, fresh")
    return outcomes
