"""`minidual report`."""

from minidual.cli.execute import run_stage
from minidual.cli.options import GateOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def report(*, gate_options: GateOptions, session: Session) -> ExitCode:
    """Build the report from the verdicts: one offline HTML and report.json.

    Examples:
        minidual report
        minidual report --run standard --json
    """
    return run_stage(session, "report", {}, gate_options)
