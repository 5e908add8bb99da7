"""Faults of a carry: their detection, and the commands of the hands. Latencies: docs/carry-faults.md."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from minidual.config.control import CarryFaultConfig
from minidual.robot.pair import SIDES, Array
from minidual.skills.object_kernels import farthest
from minidual.skills.signals import TURNS, TURNS_S, Scatter, Turns

OPENING = (
    "missed_grasp",
    "knocked_away",
    "object_lost",
    "unreachable",
    "gripper_stuck",
)
"""Faults after which the hands open."""
CLOSED = (
    "lost_arm",
    "slip",
    "tilted",
    "sensor_lost",
    "reflex",
    "interrupted",
    "gripper_jitter",
    "singular",
    "joint_limit",
    "off_path",
)
"""Faults after which the hands keep their command. The last three are refusals of paths."""

_FINGER_STEP_M = 0.001
_PINCH_STEP_N = 10.0
_PINCH_STEP = 0.2
"""Smallest steps that are no noise; of the pinch also as a share of the requested one."""
_POSES_N = 2
_GAPS_N = 3
"""Bad samples in a row that make a fault."""
_MOTOR_SHARE = 0.12
"""Share of the commanded torque by which sound motors may differ; they are calibrated to 0.1."""


class Fault(NamedTuple):
    """A fault; `name` is in OPENING or CLOSED, `at_s` the time of detection."""

    name: str
    detail: str
    at_s: float = math.nan

    @property
    def text(self) -> str:
        """One line for people."""
        return f"{self.name} at {self.at_s:.2f} s: {self.detail}"


class Order(StrEnum):
    """Commands of the hands."""

    NONE = ""
    OPEN = "open"
    CLOSE = "close"


class _Hand:
    """Signals of one hand since its last order: the gap of its fingers, and its pinch."""

    def __init__(self, pinch_step_n: float) -> None:
        self._gap = Turns(_FINGER_STEP_M)
        self._pinch = Turns(pinch_step_n)

    @property
    def moved_s(self) -> float:
        """Time at which the gap or the pinch changed last."""
        return max(self._gap.moved_s, self._pinch.moved_s)

    def update(self, gap_m: float, pinch_n: float, now_s: float) -> bool:
        """Take measurements; return whether the hand jitters."""
        gap_jitters = self._gap.update(gap_m, now_s)
        pinch_jitters = self._pinch.update(pinch_n, now_s)
        return gap_jitters or pinch_jitters


class FaultMonitor:
    """Detects faults; call each method once a control step in its phases. NaN counts as a fault.

    Args:
        config: Bounds and times.
        dt_s: Control period.
        width_m: Width of the object between the fingers.
        pinch_n: Requested pinch of each hand.
        left_n: Joints of the left arm; None: half of all.

    Attributes:
        spread_m: Distance between the hands from which slip counts; None takes that of the next
            check.
    """

    def __init__(
        self,
        config: CarryFaultConfig,
        *,
        dt_s: float,
        width_m: float,
        pinch_n: float,
        left_n: int | None = None,
    ) -> None:
        self._config = config
        self._left_n = left_n
        self._width_m = width_m
        self._pinch_n = pinch_n
        self._pinch_min_n = config.lost_pinch_share * pinch_n
        self._gap_min_m = width_m - config.gap_margin_m
        self._crept_max_m = config.displaced_m
        self._tilt_max_rad = config.tilt_rad
        self._torque_max_nm = config.motor_torque_n_m
        self._motors_missing = False
        self._needed = max(1, round(config.persistence_s / dt_s))
        self._counts: dict[str, int] = {}
        self._scatter = Scatter((config.displaced_m, config.displaced_rad))
        self._pinch_step_n = max(_PINCH_STEP_N, _PINCH_STEP * pinch_n)
        self._begin_order(Order.NONE, 0.0)
        self.spread_m: float | None = None

    def _lasts(self, key: str, bad: bool, needed: int | None = None) -> bool:
        """Count bad samples in a row; return whether they are `needed`, or persist."""
        if not bad:
            self._counts.pop(key, None)
            return False
        count = self._counts.get(key, 0) + 1
        self._counts[key] = count
        return count >= (self._needed if needed is None else needed)

    # Motors and sensors ------------------------------------------------------------------------

    def motors(self, commanded: Array, applied: Array) -> Fault | None:
        """Compare commanded and applied torques (n,) [Nm]; a motor may be off by a share."""
        torque_max_nm = self._torque_max_nm
        if farthest(commanded, applied) <= torque_max_nm and not self._motors_missing:
            return None
        missing = np.abs(commanded - applied) - _MOTOR_SHARE * np.abs(commanded)
        left_n = len(missing) // 2 if self._left_n is None else self._left_n
        missing_nm = np.array([missing[:left_n].max(), missing[left_n:].max()])
        self._motors_missing = not bool((missing_nm <= torque_max_nm).all())  # true for NaN
        details: list[str] = []
        for name, arm_missing_nm in zip(SIDES, missing_nm, strict=True):
            # Check both: drives can share a supply.
            if self._lasts(f"motor {name}", not arm_missing_nm <= torque_max_nm):
                details.append(
                    f"{name} arm: a motor's torque is {arm_missing_nm:.1f} Nm farther from the "
                    f"command than {_MOTOR_SHARE:.0%} of it",
                )
        return Fault("lost_arm", "; ".join(details)) if details else None

    def silent(self, sensor: str, age_s: float, age_max_s: float) -> Fault | None:
        """Check the age of a sensor's last usable reading."""
        if age_s <= age_max_s:
            return None
        return Fault(
            "sensor_lost",
            f"no {sensor} for {1e3 * age_s:.0f} ms; bound {1e3 * age_max_s:.0f} ms",
        )

    def frozen(self, sensor: str, same: bool, needed: int) -> Fault | None:
        """Check a sensor whose readings must change; `same`: to the bit as the last."""
        if not self._lasts(sensor, same, needed):
            return None
        return Fault("sensor_lost", f"{sensor} stays the same to the bit while the object moves")

    # An object that no hand holds --------------------------------------------------------------

    def resting(self, innovation: tuple[float, float]) -> Fault | None:
        """Check a pose sample of an untouched object by its distance [m] and angle [rad]."""
        is_away = any(self._scatter.exceeded(innovation))
        self._scatter.learn(innovation)
        if not self._lasts("resting", is_away, _POSES_N):
            return None
        return Fault(
            "knocked_away",
            f"the object is {1e3 * innovation[0]:.0f} mm from where it lay",
        )

    def closing(self, gap_m: Sequence[float], pinch_n: Array, t_s: float) -> Fault | None:
        """Check closing hands by gaps (2,), pinch (2,) and time."""
        for arm, name in enumerate(SIDES):
            is_past = not gap_m[arm] >= self._gap_min_m
            if self._lasts(f"gap {name}", is_past, _GAPS_N):
                return Fault(
                    "missed_grasp",
                    f"the {name} hand has closed to {1e3 * gap_m[arm]:.0f} mm, "
                    f"the object is {1e3 * self._width_m:.0f} mm wide",
                )
        if t_s <= self._config.grasp_timeout_s:
            return None
        pinches = ", ".join(f"{force:.1f}" for force in pinch_n)
        return Fault("missed_grasp", f"pinch {pinches} N after {self._config.grasp_timeout_s} s")

    # Hands -------------------------------------------------------------------------------------

    def _begin_order(self, order: Order, now_s: float) -> None:
        """Count steps of the hands from here."""
        self._order = order
        self._ordered_s = now_s
        self._hands = [_Hand(self._pinch_step_n) for _ in SIDES]

    def grippers(
        self,
        now_s: float,
        order: Order,
        gap_m: Sequence[float],
        pinch_n: Sequence[float],
        target_m: float,
    ) -> Fault | None:
        """Check that hands with an order move until they have followed it, and others do not move.

        Args:
            now_s: Time.
            order: To the hands.
            gap_m: (2,), of each hand's fingers.
            pinch_n: (2,).
            target_m: Gap at which the order is followed.
        """
        if order != self._order:
            self._begin_order(order, now_s)
        opens = order == Order.OPEN
        # The force of a hand that opens must fall first.
        answer_max_s = self._config.gripper_answer_s * (2.0 if opens else 1.0)
        for name, hand, gap, pinch in zip(SIDES, self._hands, gap_m, pinch_n, strict=True):
            jitters = hand.update(gap, pinch, now_s)
            still_s = now_s - max(hand.moved_s, self._ordered_s)
            followed = gap > target_m if opens else gap < target_m
            if order and not followed and still_s > answer_max_s:
                return Fault(
                    "gripper_stuck",
                    f"the {name} hand, commanded to {order}, "
                    f"stays at {1e3 * gap:.0f} mm for {still_s:.2f} s",
                )
            if jitters and not order:
                return Fault(
                    "gripper_jitter",
                    f"the {name} hand turned back {TURNS} times within {TURNS_S} s",
                )
        return None

    # A held object -----------------------------------------------------------------------------

    def holding(
        self,
        pinch_n: Sequence[float],
        gap_m: Sequence[float],
        spread_m: float,
        tilt_rad: float,
    ) -> Fault | None:
        """Check a held object by pinch (2,), gaps (2,), hand distance and tilt."""
        if self.spread_m is None:
            self.spread_m = spread_m
        crept_m = abs(spread_m - self.spread_m)
        left_pinch_n, right_pinch_n = pinch_n
        left_gap_m, right_gap_m = gap_m
        pinched = left_pinch_n >= self._pinch_min_n and right_pinch_n >= self._pinch_min_n
        between = left_gap_m >= self._gap_min_m and right_gap_m >= self._gap_min_m
        in_place = crept_m <= self._crept_max_m and tilt_rad <= self._tilt_max_rad
        if pinched and between and in_place and not self._counts:
            return None
        for name, pinch, gap in zip(SIDES, pinch_n, gap_m, strict=True):
            if self._lasts(f"pinch {name}", not pinch >= self._pinch_min_n):
                return Fault(
                    "object_lost",
                    f"the {name} hand pinches {pinch:.1f} of {self._pinch_n:.0f} N",
                )
            if self._lasts(f"held gap {name}", not gap >= self._gap_min_m, _GAPS_N):
                return Fault("object_lost", f"the {name} hand has closed to {1e3 * gap:.0f} mm")
        if not crept_m <= self._crept_max_m:  # by encoders: one reading suffices
            return Fault("slip", f"the hands have moved {1e3 * crept_m:.1f} mm along the object")
        if self._lasts("tilt", not tilt_rad <= self._tilt_max_rad):
            return Fault("tilted", f"the object is tilted by {np.degrees(tilt_rad):.0f} deg")
        return None

    def held_pose(self, innovation: tuple[float, float]) -> Fault | None:
        """Check a pose sample against the hands by its distance [m] and angle [rad]."""
        is_away = any(self._scatter.exceeded(innovation))
        if not self._lasts("held", is_away, _POSES_N):
            return None
        away_m, away_rad = innovation
        return Fault(
            "slip",
            f"the object is {1e3 * away_m:.1f} mm, {np.degrees(away_rad):.1f} deg off in the hands",
        )

    def squeezing(self, requested_n: float, felt_n: float) -> Fault | None:
        """Compare requested and felt internal force."""
        is_weak = not felt_n >= self._config.squeeze_share * requested_n
        if not self._lasts("squeeze", is_weak):
            return None
        return Fault("slip", f"internal force {felt_n:.1f} of {requested_n:.0f} N")
