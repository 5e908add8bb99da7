"""`minidual migrate`."""

from typing import Annotated

import typer

from minidual.cli.console import print_outcome
from minidual.cli.documents import outcome_document
from minidual.cli.options import GateOptions
from minidual.cli.session import Session
from minidual.cli.terminal import ConsoleProgress
from minidual.config.loader import Override
from minidual.errors import ExitCode, check_name
from minidual.gate.gate import Gate
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore


def migrate(
    *,
    step: Annotated[
        str | None,
        typer.Argument(metavar="STEP", help="One of the five steps (default: the next one)."),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="What is driven: sim, sim-position, franka://HOST,HOST or MODULE:FACTORY.",
        ),
    ] = None,
    boards: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER", help="Pictures of a checkerboard: FOLDER/high, left, right."
        ),
    ] = None,
    confirm: Annotated[
        str | None,
        typer.Option(
            metavar="ROWS",
            help="What a person has tried on hardware: estop-button,mains,cable.",
        ),
    ] = None,
    signed_by: Annotated[str | None, typer.Option(help="Who has tried it.")] = None,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """From the simulator to hardware in five gated steps, twelve rows of a checklist.

    10 % speed with one arm, 10 % with both, 30 % with both, teleoperation, full speed with
    recording. A step refuses to start before the one below has passed on the same plant.

    Examples:
        minidual migrate --plant sim
        minidual migrate both-arms-10 --plant franka://127.0.0.1,127.0.0.2
    """
    from minidual.stages.migrate.table import MIGRATION

    address = plant or session.loaded.config.plant.address
    loaded = session.loaded
    if plant is not None:  # of the whole migration: steps on another plant are stale
        loaded = loaded.with_overrides([Override("plant.address", plant, f"--plant {plant}")])
    options = {"boards": boards, "confirm": confirm, "signed-by": signed_by}
    typed = {name: value for name, value in options.items() if value is not None}
    store = RunStore(session.store.folder, "migration")
    if step is not None:
        check_name("step", step, MIGRATION)
    else:
        # On this plant; what is typed is for the next step, those that passed keep their options.
        open_step = _first_open(Gate(MIGRATION, store, loaded))
        if open_step is None and not gate_options.force:
            return _passed(session, address)
        step = open_step or next(iter(MIGRATION))
    runner = Runner(
        table=MIGRATION,
        store=store,
        loaded=loaded,
        progress=ConsoleProgress(session.people),
        command=lambda words: _command_of(session, words, address),
    )
    outcome = runner.run(step, typed, force=gate_options.force, waiver=gate_options.waive_gate)
    following = f"next: {session.common.command(f'migrate --plant {address}')}"
    print_outcome(session.people, MIGRATION[step], outcome, following)
    document = {**outcome_document(outcome), "next": following}
    session.finish(document, [store.verdict_path(step)])
    return outcome.exit_code


def _first_open(gate: Gate) -> str | None:
    """Return the first step that has not passed, None if all have."""
    lowest = gate.lowest()
    return None if lowest is None else lowest.name


def _passed(session: Session, address: str) -> ExitCode:
    """Report a migration that has passed."""
    session.finish(
        {"migration": "passed", "plant": address, "exit_code": 0},
        [f"the migration has passed on {address}"],
    )
    return ExitCode.PASS


def _command_of(session: Session, words: str, address: str) -> str:
    """Return the command that runs the step named last in `words`."""
    step = words.split()[-1]
    return session.common.command(f"migrate {step} --plant {address}")
