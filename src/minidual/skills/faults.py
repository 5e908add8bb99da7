"""Faults of a carry: detection, and what the hands do. Latencies: docs/carry-faults.md."""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.config.control import CarryFaultConfig
from minidual.control.kernels import farthest
from minidual.robot.pair import SIDES, Array

OPENING = (
    "missed_grasp",
    "knocked_away",
    "object_lost",
    "unreachable",
    "gripper_stuck",
)
"""Faults after which the hands open."""
_OF_PATHS = "singular", "joint_limit", "off_path"
CLOSED = (
    "lost_arm",
    "slip",
    "tilted",
    "sensor_lost",
    "reflex",
    "interrupted",
    "gripper_jitter",
    *_OF_PATHS,
)
"""Faults after which the hands keep their command."""


class Fault(NamedTuple):
    """A fault; `name` is in OPENING or CLOSED, `at_s` the time of detection."""

    name: str
    detail: str
    at_s: float = math.nan

    @property
    def text(self) -> str:
        """One line for people."""
        return f"{self.name} at {self.at_s:.2f} s: {self.detail}"


_SCATTERS = 2.9
"""Threshold in RMS scatters, five standard deviations per coordinate: white noise exceeds it twice in a row once in a
billion samples."""
_FINGER_STEP_M = 0.001
_PINCH_STEP_N = 10.0
_PINCH_STEP = 0.2
"""Smallest steps that are no noise; of the pinch also as share of the wanted one."""
_TURNS = 4
_TURNS_S = 0.2
"""A hand whose opening or pinch turns back this often in this time jitters."""
_LEARNT = 10
"""Samples before the learnt scatter is used."""


class _Scatter:
    """RMS scatter (distance [m], angle [rad]) of a resting object's readings, at least `least` (2,)."""

    def __init__(self, least: Sequence[float]) -> None:
        self._parts = [
            (least_of, 0.0, 0) for least_of in least
        ]  # with the sum of squares, and of how many

    def exceeded(self, away: Sequence[float]) -> list[bool]:
        """Return which of away (2,) noise does not explain, such as NaN."""
        return [
            not x
            <= (4.0 * least if n < _LEARNT else max(least, _SCATTERS * math.sqrt(squares / n)))
            for x, (least, squares, n) in zip(away, self._parts, strict=True)
        ]

    def learn(self, away: Sequence[float]) -> None:
        """Add a reading of an unmoved object, without outliers."""
        for k, odd in enumerate(self.exceeded(away)):
            least, squares, n = self._parts[k]
            self._parts[k] = (
                (least, squares, n) if odd else (least, squares + away[k] * away[k], n + 1)
            )


class _Turns:
    """Last step of a signal that is no noise [s], and its turns."""

    def __init__(self, step: float) -> None:
        self._step = step
        self._at = math.inf
        self._way = 0
        self._high = -math.inf  # since the last turn
        self._low = math.inf
        self.moved_s = -math.inf
        self._turns_s: deque[float] = deque(maxlen=_TURNS)

    def update(self, value: float, now_s: float) -> bool:
        """Take a value; return whether it turns often."""
        step = self._step
        if abs(value - self._at) >= step:
            self._at = value
            self.moved_s = now_s
        if value > self._high:
            self._high = value
        if value < self._low:
            self._low = value
        falls = self._way >= 0 and self._high - value >= step
        if falls or (self._way <= 0 and value - self._low >= step):
            if self._way:
                self._turns_s.append(now_s)
            self._way = -1 if falls else 1
            self._high = value
            self._low = value
        return len(self._turns_s) == _TURNS and now_s - self._turns_s[0] < _TURNS_S


class FaultMonitor:
    """Detects faults; call each method once a control step in its phases. NaN counts as a fault."""

    def __init__(
        self,
        config: CarryFaultConfig,
        *,
        dt_s: float,
        width_m: float,
        pinch_n: float,
    ) -> None:
        self._config = config
        self._width = width_m
        self._pinch = pinch_n
        self._least_n = config.lost_pinch_share * pinch_n
        self._least_m = width_m - config.gap_margin_m
        self._torque_max = config.motor_torque_n_m
        self._squeeze_share = config.squeeze_share
        self._crept_max_m = config.displaced_m
        self._tilt_max_rad = config.tilt_rad
        self._motors_missing = False
        self._needed = max(1, round(config.persistence_s / dt_s))
        self._counts: dict[str, int] = {}
        self.spread_m: float | None = None
        """Distance between the hands from which slip counts; None for that of the next check."""
        self.lost: npt.NDArray[np.bool_] = np.zeros(len(SIDES), dtype=bool)
        """(2,) arms with lost motors."""
        self._scatter = _Scatter((config.displaced_m, config.displaced_rad))
        self._told = ("", 0.0)
        self._step_n = max(_PINCH_STEP_N, _PINCH_STEP * pinch_n)
        self._watch_hands()

    def _watch_hands(self) -> None:
        self._hands = [(_Turns(_FINGER_STEP_M), _Turns(self._step_n)) for _ in SIDES]

    def _lasts(self, key: str, now: bool, needed: int | None = None) -> bool:
        if not now:
            self._counts.pop(key, None)
            return False
        count = self._counts[key] = self._counts.get(key, 0) + 1
        return count >= (self._needed if needed is None else needed)

    def motors(self, commanded: Array, applied: Array) -> Fault | None:
        """Compare commanded and applied torques (n,); updates `lost`."""
        if farthest(commanded, applied) <= self._torque_max and not self._motors_missing:
            return None
        missing, told = (
            np.abs(x).reshape(2, -1).max(axis=1) for x in (commanded - applied, commanded)
        )
        self._motors_missing = not bool((missing <= self._torque_max).all()) or bool(
            self.lost.any(),
        )
        found: list[str] = []
        for arm, name in enumerate(SIDES):  # check both: drives can share a supply
            if self._lasts(f"motor {name}", not missing[arm] <= self._torque_max):
                self.lost[arm] = True
                found.append(
                    f"{name} arm: a motor gives {missing[arm]:.1f} Nm less than it was told",
                )
            if self._lasts(
                f"back {name}",
                bool(missing[arm] <= self._torque_max < 0.5 * told[arm]),
            ):
                self.lost[arm] = (
                    False  # a dip: its torque has not yet been ramped to nothing, and the motors give it
                )
        return Fault("lost_arm", "; ".join(found)) if found else None

    def silent(self, what: str, age_s: float, bound_s: float) -> Fault | None:
        """Check the age of a sensor's last usable reading."""
        if age_s <= bound_s:
            return None
        return Fault(
            "sensor_lost",
            f"no {what} for {1e3 * age_s:.0f} ms; bound {1e3 * bound_s:.0f} ms",
        )

    def frozen(self, what: str, same: bool, needed: int) -> Fault | None:
        """Check a sensor whose readings must change; `same` to the bit as the last."""
        if not self._lasts(what, same, needed):
            return None
        return Fault("sensor_lost", f"{what} stays the same to the bit while the object moves")

    def resting(self, innovation: tuple[float, float]) -> Fault | None:
        """Check a pose sample of an untouched object."""
        away = any(self._scatter.exceeded(innovation))
        self._scatter.learn(innovation)
        if not self._lasts("resting", away, 2):
            return None
        return Fault(
            "knocked_away",
            f"the object is {1e3 * innovation[0]:.0f} mm from where it lay",
        )

    def closing(self, gap_m: Sequence[float], pinch_n: Array, t_s: float) -> Fault | None:
        """Check closing hands by gaps (2,), pinch (2,) and time."""
        for arm, name in enumerate(SIDES):
            if self._lasts(f"gap {name}", not gap_m[arm] >= self._least_m, 3):
                closed = f"the {name} hand has closed to {1e3 * gap_m[arm]:.0f} mm"
                return Fault(
                    "missed_grasp",
                    f"{closed}, the object is {1e3 * self._width:.0f} mm wide",
                )
        if t_s > self._config.grasp_timeout_s:
            felt = ", ".join(f"{f:.1f}" for f in pinch_n)
            return Fault("missed_grasp", f"pinch {felt} N after {self._config.grasp_timeout_s} s")
        return None

    def grippers(
        self,
        now_s: float,
        told: str,
        gap_m: Sequence[float],
        pinch_n: Sequence[float],
        target_m: float,
    ) -> Fault | None:
        """Check that hands told to "close" or "open" move until their gaps (2,) reach the target, others hold still."""
        if told != self._told[0]:  # a step counts from here
            self._told = told, now_s
            self._watch_hands()
        bound_s = self._config.gripper_answer_s * (
            2.0 if told == "open" else 1.0
        )  # its force must fall first
        for name, (gap, pinch), gap_now_m, pinch_now_n in zip(
            SIDES,
            self._hands,
            gap_m,
            pinch_n,
            strict=True,
        ):
            jitters = gap.update(gap_now_m, now_s) | pinch.update(pinch_now_n, now_s)
            still_s = now_s - max(gap.moved_s, pinch.moved_s, self._told[1])
            done = gap_now_m > target_m if told == "open" else gap_now_m < target_m
            if told and not done and still_s > bound_s:
                where = f"stays at {1e3 * gap_now_m:.0f} mm for {still_s:.2f} s"
                return Fault("gripper_stuck", f"the {name} hand, told to {told}, {where}")
            if jitters and not told:
                return Fault(
                    "gripper_jitter",
                    f"the {name} hand turned back {_TURNS} times within {_TURNS_S} s",
                )
        return None

    def holding(
        self,
        pinch_n: Sequence[float],
        gap_m: Sequence[float],
        spread_m: float,
        tilt_rad: float,
    ) -> Fault | None:
        """Check a held object by pinch (2,), gaps (2,), hand distance and tilt."""
        least_n = self._least_n
        least_m = self._least_m
        tilt_max_rad = self._tilt_max_rad
        if self.spread_m is None:
            self.spread_m = spread_m
        crept = abs(spread_m - self.spread_m)
        firm = pinch_n[0] >= least_n <= pinch_n[1] and gap_m[0] >= least_m <= gap_m[1]
        if firm and crept <= self._crept_max_m and tilt_rad <= tilt_max_rad and not self._counts:
            return None
        for name, pinch, gap in zip(SIDES, pinch_n, gap_m, strict=True):
            if self._lasts(f"pinch {name}", not pinch >= least_n):
                return Fault(
                    "object_lost",
                    f"the {name} hand pinches {pinch:.1f} of {self._pinch:.0f} N",
                )
            if self._lasts(f"held gap {name}", not gap >= least_m, 3):
                return Fault("object_lost", f"the {name} hand has closed to {1e3 * gap:.0f} mm")
        if self._lasts(
            "spread",
            not crept <= self._crept_max_m,
            1,
        ):  # encoders: one reading suffices
            return Fault("slip", f"the hands have moved {1e3 * crept:.1f} mm along the object")
        if self._lasts("tilt", not tilt_rad <= tilt_max_rad):
            return Fault("tilted", f"the object is tilted by {np.degrees(tilt_rad):.0f} deg")
        return None

    def held_pose(self, innovation: tuple[float, float]) -> Fault | None:
        """Check a pose sample against the hands."""
        if not self._lasts("held", any(self._scatter.exceeded(innovation)), 2):
            return None
        away_m, away_rad = innovation
        return Fault(
            "slip",
            f"the object is {1e3 * away_m:.1f} mm, {np.degrees(away_rad):.1f} deg off in the hands",
        )

    def squeezing(self, wanted_n: float, felt_n: float) -> Fault | None:
        """Compare requested and felt internal force."""
        weak = not felt_n >= self._squeeze_share * wanted_n
        lasts = (weak or self._counts) and self._lasts("squeeze", weak)
        return Fault("slip", f"internal force {felt_n:.1f} of {wanted_n:.0f} N") if lasts else None
