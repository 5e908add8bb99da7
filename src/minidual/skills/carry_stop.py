"""Stop a carry; each cause becomes one fault (skills/faults.py).

finding        halt on the spot
lost motors    halt, then no torque to those arms
reflex         the supervisor's soft stop
arbiter        other mode or refusal: brake along the path and hold
halt           by another source: halt, hands keep their command
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
"""Time within which the arbiter has braked along the path."""


class CarryStop:
    """Stops one carry.

    Attributes:
        halted: Stopped on the spot, not along the path.
        duration_s: Time until rest.
        over: Trial ended; staleness is no fault any more.
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
        """Halt on the spot if there is a finding."""
        if finding is None or self.halted:
            return
        name, detail = finding
        self.halted = True
        drives = self._stack.source == self._source
        self._stack.halt(self._source, _OPEN if FAULTS[name].opens_hands and drives else None)
        if self.fault is None:  # else the arbiter stopped it first
            self._note(name, self._stack.plant.time, detail, self._halt_s())

    def heed_motors(self) -> None:
        """Switch off lost arms."""
        if self._told is None:
            return
        finding = self._watch.motors(self._told, self._stack.plant.tau)
        if finding is not None:
            self.heed(finding)
            self._stack.switch_off(self._watch.lost_arms)

    def heed_refusal(self, refusal: Refusal) -> None:
        """Record a refusal."""
        if self.fault is None:
            why = f"{refusal.name}: {refusal.detail}"
            self._note("interrupted", self._stack.plant.time, why, _BRAKED_S)

    def step(self) -> None:
        """Step the stack; record reflexes and interruptions."""
        try:
            self._stack.step()
        except ReflexError as error:
            self._heed_reflex(error)
        else:
            self._heed_arbiter()
        self._told = self._stack.applied

    def _heed_reflex(self, error: ReflexError) -> None:
        """Record a reflex; the hands keep their command."""
        self.halted, cause = True, error.__cause__
        if self.fault is not None:
            return
        if isinstance(cause, SingularPostureError):
            self._note("singular", error.reflex.time_s, cause.message, self._halt_s())
        else:
            self._note("reflex", error.reflex.time_s, error.reflex.text, self._halt_s())

    def _heed_arbiter(self) -> None:
        stack, refused = self._stack, None
        if len(stack.refusals) > self._refusals_seen:
            news = stack.refusals[self._refusals_seen :]
            self._refusals_seen += len(news)
            refused = next((r for r in news if r.source == self._source), None)
        if self.fault is not None or self.over:
            return
        if stack.output.halted:  # first: sources see a halt as a hold request
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
        world = self._stack.plant
        return SoftStop(world.q, world.v, self._share * world.robot.a_max).duration_s

    def _flushed(self, mode: str) -> None:
        if mode != self._source:
            self._asked_for = mode
