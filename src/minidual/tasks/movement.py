"""Conditions of success on how an object moves: high over the table, slowly, and by which hands.

The numbers are choices of this project; docs/success.md gives their reasons.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from minidual.robot.pair import SIDES
from minidual.tasks.success import AtEnd, OfObject
from minidual.tasks.truth import TOUCH_N, Truth

HIGH_SHARE = 0.5
"""Share of a task's clear height over which an object counts as carried."""
SHIFT_M = 0.03
"""Hands that close on an object, or put it down, may shift it by this much."""
SETTLE_M = 0.005
"""A released object may settle by this much."""
SET_DOWN_M = 0.001
"""An object may be released this high over the table."""
SPEED_M_PER_S = 1.7
"""Largest speed of the arms' hands."""
ALONE_M = 0.1
"""Each hand of an exchange carries the object this far alone."""
BOTH_S = 0.1
"""Both hands of an exchange hold the object for this long."""
FREE_S = 0.05
"""Fingers that leave an object for a shorter time have not released it."""


@dataclass
class Carried(OfObject):
    """The object travels high over the table: lower, it moves sideways by `limit_m` at most.

    The limit holds for each stay below `height_m`. The way of the object's ends counts too.
    """

    name = "carried"
    height_m: float
    limit_m: float = SHIFT_M
    _came_down_at: tuple[float, float, float] | None = None
    _largest_m: float = 0.0

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if item.clearance_m >= self.height_m:
            self._came_down_at = None
            return ""
        if self._came_down_at is None:
            self._came_down_at = item.place
        moved_m = item.moved_m(self._came_down_at)
        if moved_m > self._largest_m:
            self._largest_m = moved_m
        if moved_m <= self.limit_m:
            return ""
        low = f"less than {1e3 * self.height_m:.0f} mm over the table"
        way = f"moved {1e3 * moved_m:.0f} mm {low}, limit {1e3 * self.limit_m:.0f}"
        return f"object dragged, or carried too low ({way})"

    def disturbed(self) -> None:
        self._came_down_at = None

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"low_way_m": self._largest_m}


@dataclass
class Slow(OfObject):
    """The object's centre is never faster than hands may be."""

    name = "slow"
    limit_m_per_s: float = SPEED_M_PER_S
    _last_s: float = 0.0
    _last_xyz: tuple[float, float, float] | None = None

    def observe(self, truth: Truth) -> str:
        xyz = truth[self.object].xyz
        last_xyz = self._last_xyz
        step_s = truth.time - self._last_s
        self._last_xyz = xyz
        self._last_s = truth.time
        if last_xyz is None or math.dist(xyz, last_xyz) <= self.limit_m_per_s * step_s:
            return ""
        way_m = math.dist(xyz, last_xyz)
        speed = way_m / step_s if step_s > 0.0 else math.inf
        return f"object too fast ({speed:.1f} m/s, limit {self.limit_m_per_s})"

    def disturbed(self) -> None:
        self._last_xyz = None


@dataclass
class Settled(OfObject):
    """Hands release the object on the table, and it stays there unless they lift it again."""

    name = "settled"
    height_m: float
    limit_m: float = SETTLE_M
    over_m: float = SET_DOWN_M
    _lifted: bool = False
    _free_since_s: float | None = None
    _free_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _free_over_m: float = 0.0
    _let_go: bool = False

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if item.clearance_m >= self.height_m:
            self._lifted = True
            self._let_go = False
            self._free_since_s = None
            return ""
        if not self._lifted:
            return ""
        if not self._let_go:
            return self._wait(truth)
        moved_m = item.moved_m(self._free_at)
        if moved_m <= self.limit_m:
            return ""
        limit = f"limit {1e3 * self.limit_m:.0f}"
        return f"object moved after its release ({1e3 * moved_m:.0f} mm, {limit})"

    def _wait(self, truth: Truth) -> str:
        """Wait until the fingers have left the object; return the violation, or ""."""
        item = truth[self.object]
        if item.in_fingers:
            self._free_since_s = None
            return ""
        if self._free_since_s is None:
            self._free_since_s = truth.time
            self._free_at = item.place
            self._free_over_m = item.clearance_m
        if truth.time - self._free_since_s < FREE_S - 1e-9:
            return ""
        self._let_go = True
        if self._free_over_m <= self.over_m:
            return ""
        height = f"{1e3 * self._free_over_m:.1f} mm over the table"
        return f"object let go in the air ({height}, limit {1e3 * self.over_m:.0f})"

    def disturbed(self) -> None:
        self._let_go = False
        self._free_since_s = None


@dataclass
class Exchanged(AtEnd):
    """One hand carries the object alone, both hold it in the air, then the other carries it alone.

    Attributes:
        limit_n: Pinch of a hand that holds it.
        alone_m: Distance that each carries it alone.
        both_s: Time for which both hold it at once.
    """

    name = "exchanged"
    stage = True
    limit_n: float
    alone_m: float = ALONE_M
    both_s: float = BOTH_S
    _holder: int | None = None
    _took_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _both_since_s: float | None = None
    _giver: int | None = None
    _shared: bool = False
    _taken: bool = False

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if not item.airborne:
            self._holder = None
            self._both_since_s = None
            return ""
        left, right = item.pinch
        if min(left, right) > self.limit_n:
            self._note_both(truth.time)
            return ""
        self._both_since_s = None
        hand = 0 if left > right else 1
        firmer_n = max(left, right)
        if firmer_n <= self.limit_n or min(left, right) > TOUCH_N:
            self._holder = None
        else:
            self._note_alone(hand, item.xyz)
        return ""

    def _note_both(self, now_s: float) -> None:
        self._holder = None
        if self._both_since_s is None:
            self._both_since_s = now_s
        if self._giver is not None and now_s - self._both_since_s >= self.both_s - 1e-9:
            self._shared = True

    def _note_alone(self, hand: int, xyz: tuple[float, float, float]) -> None:
        if self._holder != hand:
            self._holder = hand
            self._took_at = xyz
        if math.dist(xyz, self._took_at) < self.alone_m:
            return
        if self._giver is None or (hand == self._giver and self._taken):
            self._giver = hand
            self._shared = False
            self._taken = False
        elif hand != self._giver and self._shared:
            self._taken = True

    def end(self, truth: Truth) -> str:
        if self._taken:
            return ""
        alone = f"{1e3 * self.alone_m:.0f} mm alone"
        if self._giver is None:
            return f"object not handed over (no hand carried it {alone})"
        giver = SIDES[self._giver]
        taker = SIDES[1 - self._giver]
        if self._shared:
            missing = f"the {taker} hand did not carry it {alone} after the {giver} one"
            return f"object not handed over ({missing})"
        firmly = f"with more than {self.limit_n:.0f} N each for {self.both_s} s"
        return f"object not handed over (both hands never pinched it in the air {firmly})"


@dataclass
class BroughtBy(AtEnd):
    """The hand that carried the object last is `hand`."""

    name = "brought"
    hand: int
    limit_n: float
    _last: int | None = None

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if item.airborne:
            left, right = item.pinch
            if max(left, right) > self.limit_n:
                self._last = 0 if left > right else 1
        return ""

    def end(self, truth: Truth) -> str:
        if self._last == self.hand:
            return ""
        who = "no hand" if self._last is None else f"the {SIDES[self._last]} hand"
        wanted = f"not the {SIDES[self.hand]} one"
        return f"object brought by the wrong hand ({who} brought it, {wanted})"
