"""`minidual doctor`."""

from minidual.cli.execute import run_tool
from minidual.cli.session import Session
from minidual.errors import ExitCode


def doctor(*, session: Session) -> ExitCode:
    """Look for every known fault of this machine and of what the run holds, each with its remedy.

    Examples:
        minidual doctor
        minidual doctor --run standard --json
    """
    return run_tool(session, session.tools["doctor"], {})
