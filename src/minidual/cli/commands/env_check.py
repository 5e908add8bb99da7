"""`minidual env-check`."""

from typing import Annotated

import typer

from minidual.cli.execute import Aside, run_stage
from minidual.cli.options import GateOptions, ViewOptions, flag
from minidual.cli.session import Session
from minidual.errors import ExitCode


def env_check(
    *,
    markdown: Annotated[
        bool,
        flag("--markdown", "Print a bill of versions for a bug report instead."),
    ] = False,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="What is driven: sim, sim-position, franka://HOST,HOST or MODULE:FACTORY.",
        ),
    ] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries.

    Examples:
        minidual env-check
        minidual env-check --markdown
        minidual env-check --plant franka://127.0.0.1,127.0.0.2
    """
    bill = Aside("env-check-bill", trigger="markdown", options={"markdown": markdown})
    return run_stage(session, "env-check", {"plant": plant}, gate_options, view_options, [bill])
