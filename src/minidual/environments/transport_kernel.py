"""Compiled judge of many worlds: both hands carry one object (`tasks.rod_carry.carried_by_both`).

Each branch follows the condition of the same name in `tasks.success` and `tasks.movement`, which
are the reference: tests compare them (tests/environments/test_judging.py).
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from minidual.plant.bodies import HAND_FORCES, PINCHES, YAW, lie, look
from minidual.robot.compiled import kernel
from minidual.robot.pair import Array
from minidual.tasks.truth import AIRBORNE_M, TOUCH_N

CONDITIONS = (
    "",
    "level",
    "whole",
    "clear",
    "held",
    "slow",
    "carried",
    "settled",
)
"""Conditions that a step may violate, by their number in `JUDGED.failure`; 0 is none."""
_LEVEL, _WHOLE, _CLEAR, _HELD, _SLOW, _CARRIED, _SETTLED = range(1, len(CONDITIONS))
_PLACE = ("f8", 3)

JUDGED = np.dtype(
    [
        ("failure", "i8"),
        ("failed_s", "f8"),
        ("done_s", "f8"),  # NaN while the trial is not finished
        ("quiet_s", "f8"),  # NaN while the final conditions do not hold
        ("highest_m", "f8"),
        ("lifted_m", "f8"),  # highest while both hands pinch it
        ("tilt_max", "f8"),
        ("pinch_least", "f8"),
        ("seen", "b1"),
        ("last_s", "f8"),
        ("last_xyz", *_PLACE),
        ("low", "b1"),
        ("low_at", *_PLACE),
        ("lifted", "b1"),
        ("let_go", "b1"),
        ("free_s", "f8"),  # NaN while fingers touch it
        ("free_at", *_PLACE),
        ("free_over", "f8"),
        # What was seen last.
        ("tilt", "f8"),
        ("clearance", "f8"),
        ("yaw", "f8"),
        ("xyz", *_PLACE),
        ("pinch", "f8", 2),
        ("speed", "f8"),
    ]
)
"""What the judge keeps of a world."""
type Judged = Any
"""A row of JUDGED, with its fields as attributes."""


class Limits(NamedTuple):
    """Numbers of the conditions, named as there; lengths [m], angles [rad], forces [N]."""

    tilt: float
    break_pinch: float
    break_force: float
    pinch: float
    speed: float
    high: float
    shift: float
    rise: float
    goal: float
    yaw: float
    period: float
    settle: float
    over: float
    free_s: float
    rest_speed: float
    rest_s: float
    reach: float
    upright: bool


class Scene(NamedTuple):
    """What the judge reads, a row a world.

    Attributes:
        solids: (k, 8), see `plant.bodies.lie`.
        R, p: Pose of the object (N, 3, 3), (N, 3) before the last step, as a trial's judge sees it.
        palms: Axes (N, 2, 3) of the hands along which the fingers move, before the last step.
        pads: Forces of the fingers (N, 4, 3) [N].
        touches: (N, 4): contacts of the object with table, left and right arm; of the obstacle.
        velocity: (N, 3) of the object [m/s].
        time_s: (N,).
        goal: (N, 3), x, y [m] and yaw [rad].
    """

    solids: Array
    R: Array
    p: Array
    palms: Array
    pads: Array
    touches: Array
    velocity: Array
    time_s: Array
    goal: Array


@njit
def _remainder(x: float, period: float) -> float:
    """Return x less the nearest multiple of a period; numba has no `math.remainder`."""
    return x - period * np.round(x / period)


@njit
def _moved(s: Judged, place: Array, reach: float) -> float:
    """Return how far the object's centre or ends are from where they were at a place."""
    turned = abs(_remainder(s.yaw - place[2], math.tau))
    return math.hypot(s.xyz[0] - place[0], s.xyz[1] - place[1]) + reach * turned


@njit
def _put(place: Array, s: Judged) -> None:
    """Write where the object is: x, y and yaw."""
    place[0] = s.xyz[0]
    place[1] = s.xyz[1]
    place[2] = s.yaw


@njit
def _in_fingers(seen: Array) -> bool:
    if max(seen[PINCHES], seen[PINCHES + 1]) >= TOUCH_N:
        return True
    largest = 0.0
    for k in range(6):
        largest = max(largest, abs(seen[HAND_FORCES + k]))
    return largest > TOUCH_N


@njit
def _presses(seen: Array) -> float:
    """Return the larger force of a hand on the object [N]."""
    largest = 0.0
    for hand in range(2):
        square = 0.0
        for k in range(3):
            square += seen[HAND_FORCES + 3 * hand + k] ** 2
        largest = max(largest, square)
    return math.sqrt(largest)


@njit
def _too_fast(s: Judged, now: float, limit: float) -> bool:
    square = 0.0
    for k in range(3):
        square += (s.xyz[k] - s.last_xyz[k]) ** 2
    fast = s.seen and math.sqrt(square) > limit * (now - s.last_s)
    s.seen = True
    s.last_s = now
    s.last_xyz[:] = s.xyz
    return fast


@njit
def _strays(s: Judged, limits: Limits) -> bool:
    """Return whether the object has moved too far near the table."""
    if s.clearance >= limits.high:
        s.low = False
        return False
    if not s.low:
        s.low = True
        _put(s.low_at, s)
    return _moved(s, s.low_at, limits.reach) > limits.shift


@njit
def _unsettled(s: Judged, now: float, touched: bool, limits: Limits) -> bool:
    """Return whether the object is let go above the table, or moves after its release."""
    if s.clearance >= limits.high:
        s.lifted = True
        s.let_go = False
        s.free_s = math.nan
        return False
    if not s.lifted:
        return False
    if s.let_go:
        return _moved(s, s.free_at, limits.reach) > limits.settle
    if touched:
        s.free_s = math.nan
        return False
    if math.isnan(s.free_s):
        s.free_s = now
        s.free_over = s.clearance
        _put(s.free_at, s)
    if now - s.free_s < limits.free_s - 1e-9:
        return False
    s.let_go = True
    return s.free_over > limits.over


@njit
def _ends(s: Judged, seen: Array, touches: Array, goal: Array, limits: Limits) -> bool:
    """Return whether the final conditions hold."""
    off = _remainder(s.yaw - goal[2], limits.period)
    if not s.highest_m > AIRBORNE_M or s.clearance > AIRBORNE_M:
        return False
    if not math.hypot(s.xyz[0] - goal[0], s.xyz[1] - goal[1]) < limits.goal:
        return False
    if not abs(off) < limits.yaw:
        return False
    if _in_fingers(seen) or touches[1] > 0.0 or touches[2] > 0.0:
        return False
    return s.speed < limits.rest_speed and touches[0] > 0.0


@njit
def _violated(
    s: Judged, seen: Array, now: float, touches: Array, airborne: bool, limits: Limits
) -> int:
    """Update what the conditions remember; return the number of the first that is violated, or 0."""
    broken = 0
    if _unsettled(s, now, _in_fingers(seen), limits):
        broken = _SETTLED
    if _strays(s, limits):
        broken = _CARRIED
    if _too_fast(s, now, limits.speed):
        broken = _SLOW
    if airborne and not min(s.pinch[0], s.pinch[1]) > limits.pinch:
        broken = _HELD
    if touches[3] > 0.0:
        broken = _CLEAR
    if max(s.pinch[0], s.pinch[1]) > limits.break_pinch or _presses(seen) > limits.break_force:
        broken = _WHOLE
    if s.tilt > limits.tilt:
        broken = _LEVEL
    return broken


@kernel(heap=True)
def judge(scene: Scene, limits: Limits, judged: npt.NDArray[np.void]) -> None:
    """Evaluate one physics step of every world; `judged` (N,) of JUDGED is updated."""
    seen = np.empty(16)
    R = np.empty((3, 3))
    p = np.empty(3)
    pads = np.empty((4, 3))
    left = np.empty(3)
    right = np.empty(3)
    solids = scene.solids.copy()
    for i in range(len(judged)):
        s: Judged = judged[i]
        R[:] = scene.R[i]
        p[:] = scene.p[i]
        pads[:] = scene.pads[i]
        left[:] = scene.palms[i, 0]
        right[:] = scene.palms[i, 1]
        look(pads, R, p, left, right, seen)
        s.tilt, s.clearance = lie(seen, solids, limits.upright)
        s.xyz[:] = p
        s.yaw = seen[YAW]
        s.pinch[0] = seen[PINCHES]
        s.pinch[1] = seen[PINCHES + 1]
        velocity = scene.velocity[i]
        s.speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
        now = scene.time_s[i]
        airborne = s.clearance > AIRBORNE_M
        s.tilt_max = max(s.tilt_max, s.tilt)
        s.highest_m = max(s.highest_m, s.clearance)
        weaker = min(s.pinch[0], s.pinch[1])
        if weaker > limits.pinch:
            s.lifted_m = max(s.lifted_m, s.clearance)
        if airborne:
            s.pinch_least = min(s.pinch_least, weaker)
        broken = _violated(s, seen, now, scene.touches[i], airborne, limits)
        if broken > 0 and s.failure == 0:
            s.failure = broken
            s.failed_s = now
        if not _ends(s, seen, scene.touches[i], scene.goal[i], limits):
            s.quiet_s = math.nan
            s.done_s = math.nan
        elif math.isnan(s.quiet_s):
            s.quiet_s = now
        elif math.isnan(s.done_s) and now - s.quiet_s >= limits.rest_s:
            s.done_s = now
