"""The error of a closed gate, with the reason and the command that opens it."""

from collections.abc import Callable

from minidual.errors import GateClosedError
from minidual.gate.gate import Gate
from minidual.gate.state import StageState


def closed_error(gate: Gate, name: str, command: Callable[[str], str]) -> GateClosedError:
    """Return the error with cause, failed check and command to type.

    Args:
        gate: Of the run.
        name: Stage whose gate is closed.
        command: Turns "plan" into the full command.
    """
    unfinished = _unfinished(gate, name)
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


def _unfinished(gate: Gate, name: str) -> list[StageState]:
    """Return the upstream stages, in order, that keep the gate of `name` closed."""
    needed = gate.needed(name)
    shut = {state.name for state in gate.closed_by(name)}
    for stage in needed:
        shut |= {state.name for state in gate.shut(stage, gate.state(stage).verdict)}
    return [gate.state(stage) for stage in needed if stage in shut]


def _ended(cause: StageState) -> str:
    words = {
        "pass": "passed",
        "fail": "failed",
        "missing": "has not run",
        "error": "ended in error",
    }
    return words.get(cause.state, f"is {cause.state}")
