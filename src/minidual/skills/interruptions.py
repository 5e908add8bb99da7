"""Interruptions of a carry by the arbiter: halts, other modes, refusals, silence."""

from minidual.control.commands import ArbiterState
from minidual.control.stack import ControlStack
from minidual.plant.protocol import Plant
from minidual.skills.faults import CLOSED, Fault
from minidual.skills.pipeline.drive import SOURCE


class Interruptions:
    """Reads the arbiter after each control step.

    Args:
        stack: Its arbiter drives the arms.
    """

    def __init__(self, stack: ControlStack[Plant]) -> None:
        self._stack = stack
        self._refusals_n = 0
        self._last_output = stack.output
        self._other_mode: str | None = None
        stack.on_flush(self._note_mode)

    def _note_mode(self, mode: str) -> None:
        if mode != SOURCE:
            self._other_mode = mode

    def new_fault(self) -> Fault | None:
        """Return why the arms no longer follow the carry, or None."""
        stack = self._stack
        nothing_new = stack.output is self._last_output and stack.refused_n == self._refusals_n
        if nothing_new:
            return None
        self._last_output = stack.output
        refusals = stack.refused_since(self._refusals_n)
        self._refusals_n = stack.refused_n
        own = [refusal for refusal in refusals if refusal.source == SOURCE]
        if stack.output.halted:  # first: sources see a halt as a request to hold
            return Fault("interrupted", "the arms were halted")
        if own and own[0].name in CLOSED:
            return Fault(own[0].name, own[0].detail)
        if own:
            return Fault("interrupted", f"{own[0].name}: {own[0].detail}")
        if self._other_mode is not None:
            return Fault("interrupted", f"'{self._other_mode}' was asked for")
        if stack.state in (ArbiterState.STALE, ArbiterState.STOPPED):
            return Fault(
                "interrupted",
                f"the arbiter is {stack.state}: it has not heard of the carry",
            )
        return None
