"""Read: one validated `Measurement` a tick, made from what the plant says.

Laws, grippers and supervisor read only this. Its positions and velocities are finite. A joint whose readings failed a
check is *blind* from then on: its position and velocity are an estimate from readings taken before the failure (see
joint_check.py).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.config.control import SupervisorConfig
from minidual.control.joint_check import JointCheck
from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.pair import SIDES, Array


class MeasurementFault(NamedTuple):
    """What is wrong with a measurement.

    Attributes:
        reflex: `measurement` or `plant_failed`.
        detail: `not_finite`, `implausible`, `stale` or `clock`; empty where the plant has failed.
        text: Joint or quantity, and what is wrong with it.
        value, bound: Numbers of the violated bound; bound None where there is none.
    """

    reflex: str
    detail: str
    text: str
    value: float = 1.0
    bound: float | None = None


class Measurement(NamedTuple):
    """What was measured in one tick.

    Attributes:
        time_s: Control time.
        period_s: Time since the last tick; 0 in the first.
        stamp_s: Time of the joint readings on the same clock.
        fresh_s: How much newer the joint readings are than those of the last tick; 0 if there are no new ones.
        q, v: Joint positions (n,) [rad] and velocities [rad/s], finite.
        fingers_m: Distances of the fingers from the middle (2,), finite.
        grip_n: Closing forces (2,), finite.
        blind: (n,) joints whose q and v are estimates.
        fault: What is wrong, or None.
    """

    time_s: float
    period_s: float
    stamp_s: float
    fresh_s: float
    q: Array
    v: Array
    fingers_m: Array
    grip_n: Array
    blind: npt.NDArray[np.bool_]
    fault: MeasurementFault | None

    @property
    def age_s(self) -> float:
        """Age of the joint readings [s]."""
        return self.time_s - self.stamp_s

    @property
    def blind_arms(self) -> tuple[int, ...]:
        """Arms that have a blind joint."""
        arms = self.blind.reshape(len(SIDES), -1).any(axis=1)
        return tuple(int(arm) for arm in np.flatnonzero(arms))


class Readings(NamedTuple):
    """What the plant says in one tick, unchecked; `health` as in `Plant`, the others as in `Measurement`."""

    health: str
    time_s: float
    stamp_s: float
    q: Array
    v: Array
    fingers_m: Array
    grip_n: Array


def _array(x: Array, n: int) -> Array:
    """Return a copy of x as floats (n,): plants may keep, or write-protect, what they return."""
    copied = np.array(x, dtype=float, order="C")
    return copied if copied.shape == (n,) else copied.reshape(n)


class Reader:
    """Makes the measurements of a plant; `begin` comes first."""

    def __init__(self, plant: Plant, config: SupervisorConfig) -> None:
        self._plant = plant
        self._dof = plant.robot.dof
        self.age_max_s = max(config.measurement_age_max_s, 2.0 * plant.dt)
        """Joint readings may be this old."""
        self._check = JointCheck(plant.robot, config, plant.dt)
        self._hands_silent_s = 0.0
        self.overruns_n = 0
        """Ticks that came more than half a period late."""
        self._last: Measurement

    def first(self) -> Measurement:
        """Return a measurement to begin with; it changes nothing before `begin`.

        Raises:
            UsageError: The plant is ill, or its joints or hands are not measured.
        """
        try:
            readings = self._read_all()
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise UsageError(f"the plant is not measured: {reason}") from error
        health, time_s, stamp_s, q, v, fingers_m, grip_n = readings
        if health:
            raise UsageError(f"the plant cannot be driven: {health}", remedy="mend it first")
        if not np.isfinite(q + v).all():
            raise UsageError(f"the arms are not measured: positions {q} rad, velocities {v} rad/s")
        if not np.isfinite(fingers_m + grip_n).all():
            raise UsageError(
                f"the hands are not measured: fingers {fingers_m} m, grip {grip_n} N",
                remedy="begin once both hands are measured",
            )
        if not abs(time_s - stamp_s) <= self.age_max_s + 1e-9:
            age = f"the measurements are {time_s - stamp_s:.3f} s old; limit {self.age_max_s} s"
            raise UsageError(age, remedy="see that the plant delivers its state")
        blind = np.zeros(self._dof, dtype=bool)
        period_s = 0.0
        fresh_s = self._plant.dt
        return Measurement(time_s, period_s, stamp_s, fresh_s, q, v, fingers_m, grip_n, blind, None)

    def begin(self, first: Measurement) -> None:
        """Forget the past, and all blind joints; go on from a first measurement."""
        self._check.reset()
        self._check.begin(first.q, first.v)
        self._hands_silent_s = 0.0
        self._last = first

    def reset(self) -> Measurement:
        """Begin now; return the first measurement.

        Raises:
            UsageError: See `first`.
        """
        first = self.first()
        self.begin(first)
        return first

    def read(self, applied: Array, needed: Array) -> Measurement:
        """Return the measurement of this tick.

        Args:
            applied: Torques (n,) [Nm] since the last tick.
            needed: Torques (n,) [Nm] that posture and motion take; NaN where that is unknown.
        """
        last = self._last
        check = self._check
        fault: MeasurementFault | None = None
        try:
            readings = self._read_all()
        except Exception as error:
            readings = self._read_each(f"{type(error).__name__}: {error}")
        health, time_s, stamp_s, q, v, fingers_m, grip_n = readings
        if health:
            fault = MeasurementFault("plant_failed", "", health)

        period_s = time_s - last.time_s
        fresh_s = stamp_s - last.stamp_s
        if not period_s > 0.0:
            jump = f"{time_s} s after {last.time_s} s"
            fault = fault or MeasurementFault("measurement", "clock", jump)
            fresh_s = time_s - stamp_s + self._plant.dt  # the clock began anew
            period_s = self._plant.dt
            time_s = time_s if math.isfinite(time_s) else last.time_s + period_s
        if period_s > 1.5 * self._plant.dt:
            self.overruns_n += 1
        if not fresh_s > 0.0:  # nothing new, or overtaken by a later reading
            fresh_s = 0.0
            stamp_s = last.stamp_s
        age_s = time_s - stamp_s
        if abs(age_s) > self.age_max_s + 1e-9:
            check.lose_all()
            stale = "joint positions and velocities"
            fault = fault or MeasurementFault("measurement", "stale", stale, age_s, self.age_max_s)
        elif fresh_s > 0.0:
            check.update(q, v, fresh_s, applied, needed)
        check.coast(period_s)
        if check.why:
            fault = fault or MeasurementFault("measurement", check.detail, check.why)
        if not math.isfinite(sum(fingers_m.tolist()) + sum(grip_n.tolist())):
            fingers_m = np.where(np.isfinite(fingers_m), fingers_m, last.fingers_m)
            grip_n = np.where(np.isfinite(grip_n), grip_n, last.grip_n)
            fault = fault or self._hands_silent(period_s)
        else:
            self._hands_silent_s = 0.0
        self._last = Measurement(
            time_s,
            period_s,
            stamp_s,
            fresh_s,
            check.q,
            check.v,
            fingers_m,
            grip_n,
            check.blind,
            fault,
        )
        return self._last

    @property
    def braking_due(self) -> bool:
        """Whether blind joints are to be held by brakes now."""
        return self._check.braking_due

    def _hands_silent(self, period_s: float) -> MeasurementFault | None:
        """Count time without finite finger readings; the last ones stand in for a while."""
        self._hands_silent_s += period_s
        if self._hands_silent_s <= self.age_max_s:
            return None
        silent_s = self._hands_silent_s
        name = "fingers and grip of a hand"
        return MeasurementFault("measurement", "stale", name, silent_s, self.age_max_s)

    def _read_all(self) -> Readings:
        plant = self._plant
        return Readings(
            plant.health,
            float(plant.time),
            float(plant.stamp_s),
            _array(plant.q, self._dof),
            _array(plant.v, self._dof),
            _array(plant.fingers, len(SIDES)),
            _array(plant.grip, len(SIDES)),
        )

    def _read_each(self, health: str) -> Readings:
        """Return what can be read, NaN for what cannot."""
        plant = self._plant

        def attempt[T](read: Callable[[], T], missing: T) -> T:
            try:
                return read()
            except Exception:
                return missing

        no_joints = np.full(self._dof, math.nan)
        no_hands = np.full(len(SIDES), math.nan)
        return Readings(
            health,
            attempt(lambda: float(plant.time), math.nan),
            attempt(lambda: float(plant.stamp_s), math.nan),
            attempt(lambda: _array(plant.q, self._dof), no_joints),
            attempt(lambda: _array(plant.v, self._dof), no_joints),
            attempt(lambda: _array(plant.fingers, len(SIDES)), no_hands),
            attempt(lambda: _array(plant.grip, len(SIDES)), no_hands),
        )
