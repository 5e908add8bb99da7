"""What stops a carry, and how: each way ends in one named fault (skills/faults.py).

finding        the arms are halted where they are
lost motors    the same; those arms get no torque any more
reflex         the supervisor's own soft stop acts
arbiter        another mode is asked for, or a command is refused: it brakes along the path and holds
halt           by another source: the arms stop where they are, the hands keep their command
"""

from __future__ import annotations

import numpy as np

from minidual.control.commands import ArbiterState, Refusal
from minidual.control.object_impedance import SingularPostureError
from minidual.control.reflexes import ReflexError
from minidual.control.soft_stop import SoftStop
from minidual.control.stack import ControlStack
from minidual.robot.pair import Array
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.faults import FAULTS, CarryFault, Finding

_OPEN = np.ones(2)
_BRAKED_S = 0.6
"""By then the arbiter has braked any motion along its path."""


class CarryStop:
    """Stops one carry.

    Args:
        stack: Its way to the motors.
        source: As which it proposes.
        watch: Its senses.
        deceleration_share: Of a halt, as a share of the joints' limits.

    Attributes:
        fault: What stopped it, or None.
        halted: Whether a finding or a reflex stopped the arms where they are, not along their path.
        duration_s: How long the arms take to come to rest.
        over: Set when the trial has ended: what the arbiter does with silence from then on is no fault.
    """

    def __init__(self, stack: ControlStack, source: str, watch: CarryWatch, *, deceleration_share: float) -> None:
        self._stack, self._source, self._watch = stack, source, watch
        self._share = deceleration_share
        self._told: Array | None = None
        self._asked_for: str | None = None
        self._refusals_seen = 0
        self.fault: CarryFault | None = None
        self.halted = False
        self.duration_s = 0.0
        self.over = False
        stack.on_flush(self._flushed)

    def heed(self, finding: Finding) -> None:
        """Halt the arms where they are if something was found."""
        if finding is None or self.halted:
            return
        name, detail = finding
        self.halted = True
        drives = self._stack.source == self._source
        self._stack.halt(self._source, _OPEN if FAULTS[name].opens_hands and drives else None)
        if self.fault is None:  # else the arbiter has stopped it already, and this came on top
            self._note(name, self._stack.plant.time, detail, self._halt_s())

    def heed_motors(self) -> None:
        """Switch off arms whose motors are lost, whatever stopped them before."""
        if self._told is None:
            return
        finding = self._watch.motors(self._told, self._stack.plant.tau)
        if finding is not None:
            self.heed(finding)
            self._stack.switch_off(self._watch.lost_arms)

    def heed_refusal(self, refusal: Refusal) -> None:
        """Note that a command of the carry was refused."""
        if self.fault is None:
            why = f"{refusal.name}: {refusal.detail}"
            self._note("interrupted", self._stack.plant.time, why, _BRAKED_S)

    def step(self) -> None:
        """Run a step of the stack; note a reflex and what the arbiter did."""
        try:
            self._stack.step()
        except ReflexError as error:
            self._heed_reflex(error)
        else:
            self._heed_arbiter()
        self._told = self._stack.applied

    def _heed_reflex(self, error: ReflexError) -> None:
        """Note why the supervisor has stopped the arms; the hands stay as they are commanded."""
        self.halted, cause = True, error.__cause__
        if self.fault is not None:
            return
        if isinstance(cause, SingularPostureError):
            self._note("singular", error.reflex.time_s, cause.message, self._halt_s())
        else:
            self._note("reflex", error.reflex.time_s, error.reflex.text, self._halt_s())

    def _heed_arbiter(self) -> None:
        """Note that the arbiter lets the motion go no further."""
        stack, refused = self._stack, None
        if len(stack.refusals) > self._refusals_seen:
            news = stack.refusals[self._refusals_seen :]
            self._refusals_seen += len(news)
            refused = next((r for r in news if r.source == self._source), None)
        if self.fault is not None or self.over:
            return
        if stack.output.halted:  # before what was asked for: a halt is told to the sources as a hold
            self._note("interrupted", stack.plant.time, "the arms were halted", self._halt_s())
            return
        if refused is not None:
            self.heed_refusal(refused)
            return
        if self._asked_for is not None:
            why = f"'{self._asked_for}' was asked for"
        elif stack.state in (ArbiterState.STALE, ArbiterState.STOPPED):
            why = f"the arbiter is {stack.state}: it has not heard of the carry"
        else:
            return
        self._note("interrupted", stack.plant.time, why, _BRAKED_S)

    def _note(self, name: str, at_s: float, detail: str, duration_s: float) -> None:
        self.fault = CarryFault(name, at_s, detail)
        self.duration_s = duration_s

    def _halt_s(self) -> float:
        """Return how long a halt from here takes."""
        world = self._stack.plant
        return SoftStop(world.q, world.v, self._share * world.robot.a_max).duration_s

    def _flushed(self, mode: str) -> None:
        if mode != self._source:
            self._asked_for = mode
