"""Tune internal force and stiffness of the object impedance by carrying.

    1  safe       softest stiffness, least force: torques below 95 % of the limits
    2  force      root of  least internal force - required,  bracketed in steps of 10 N, then Brent's method;
                  the result is 1.5 times the least force that held
    3  stiffness  root of  oscillation - limit,  likewise; the result is 80 % of it (100 % if the stiffest does not
                  oscillate) and must track within 1 cm

Each step is five carries; the worst counts. The order is the usual one for object impedance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.signal import butter, sosfiltfilt

from minidual.config.change import changed
from minidual.config.root import Config
from minidual.errors import MinidualError
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.tasks.success import ObjectTruth
from minidual.tasks.task import Trial, make_task
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import LOG_RATE_HZ, Bench
from minidual.workers import in_workers

PURPOSE = "tuning"
"""Random stream of the starts, not used for acceptance."""
CARRIES_N = 5
FORCES_N = (10.0, 20.0, 30.0, 40.0)
STIFFNESSES_N_PER_M = (150.0, 300.0, 450.0, 600.0)
"""Tried in order; the last is the largest recommended."""
FORCE_FACTOR, STIFFNESS_FACTOR = 1.5, 0.8
FORCE_CEILING_N = 80.0
OSCILLATION_MAX_M = 0.0003
"""Limit of the RMS tracking error above 5 Hz."""
TRACKING_MAX_M = 0.01
COMPARED_N = (20.0, 40.0, 80.0)
_HIGH_PASS_HZ = 5.0
_FORCE_STEP_N, _STIFFNESS_STEP_N_PER_M = 0.5, 10.0
_SAFE_TORQUE = 0.95


class TuningError(MinidualError):
    """No gains were found."""


@dataclass(frozen=True)
class Carried:
    """One carry of a step.

    Attributes:
        internal_force_min_n: Minimum off the table; 0 if never off it.
        tracking_max_m: Largest position error of the object.
        oscillation_m: RMS of that error above 5 Hz.
        series: (5, T) during the carry: time [s], error [m], internal force [N], torque ratio, tilt [rad].
    """

    success: bool
    text: str
    internal_force_min_n: float
    tracking_max_m: float
    oscillation_m: float
    tilt_max_rad: float
    torque_ratio_max: float
    series: Array


@dataclass(frozen=True)
class TuningStep:
    """Carries with one force and stiffness."""

    phase: str
    force_n: float
    stiffness_n_per_m: float
    carries: tuple[Carried, ...]

    @property
    def holds(self) -> bool:
        """Whether all succeeded."""
        return all(c.success for c in self.carries)

    def worst(self, name: str, take: Callable[[Any], Any] = np.max) -> float:
        """Return the worst of one number; NaN propagates."""
        return float(take([getattr(c, name) for c in self.carries]))

    def row(self) -> dict[str, Any]:
        """Return the tuning.csv row."""
        failed = [c.text for c in self.carries if not c.success]
        return {
            "phase": self.phase,
            "internal_force_n": round(self.force_n, 2),
            "stiffness_n_per_m": round(self.stiffness_n_per_m, 1),
            "successes": f"{len(self.carries) - len(failed)} of {len(self.carries)}",
            "internal_force_min_n": _said(self.worst("internal_force_min_n", np.min), 2),
            "tracking_max_mm": _said(1e3 * self.worst("tracking_max_m"), 2),
            "oscillation_rms_mm": _said(1e3 * self.worst("oscillation_m"), 3),
            "tilt_max_deg": _said(float(np.degrees(self.worst("tilt_max_rad"))), 2),
            "torque_max_percent": _said(100.0 * self.worst("torque_ratio_max"), 0),
            "first_failure": failed[0] if failed else "",
        }


@dataclass
class Tuning:
    """The gains and every step."""

    force_n: float
    stiffness_n_per_m: float
    least_force_n: float
    last_stiffness_n_per_m: float
    final: TuningStep
    compared: list[TuningStep]
    steps: list[TuningStep] = field(default_factory=list)

    @property
    def settings(self) -> dict[str, float]:
        """As configuration values."""
        return gains(self.force_n, self.stiffness_n_per_m)


def gains(force_n: float, stiffness_n_per_m: float) -> dict[str, float]:
    """Return configuration values; rotational stiffness is 1/25 of translational."""
    return {
        "carry.impedance.internal_force_n": float(force_n),
        "carry.impedance.stiffness_n_per_m": float(stiffness_n_per_m),
        "carry.impedance.stiffness_nm_per_rad": float(stiffness_n_per_m) / 25.0,
    }


class Tuner:
    """Runs the three phases."""

    def __init__(
        self, config: Config, seed: int, *, workers: int = 1, on_step: Callable[[TuningStep], None] | None = None
    ) -> None:
        self._config, self._seed, self._workers, self._on_step = config, seed, workers, on_step
        self.steps: list[TuningStep] = []

    def run(self) -> Tuning:
        """Return the gains.

        Raises:
            TuningError: The softest step is unsafe, or no gains hold.
        """
        soft, stiff = STIFFNESSES_N_PER_M[0], STIFFNESSES_N_PER_M[-1]
        safe = self.step("safe", FORCES_N[0], soft)
        if not safe.worst("torque_ratio_max") < _SAFE_TORQUE:
            raise TuningError(
                f"the softest carry ({soft:.0f} N/m, {FORCES_N[0]:.0f} N) already takes "
                f"{100 * safe.worst('torque_ratio_max'):.0f} % of a motor's torque",
                remedy="carry more slowly: lower carry.pace.object_speed_m_per_s",
            )
        start_n_per_m = self._config.carry.impedance.stiffness_n_per_m
        least = self._least_force(start_n_per_m)
        # Rounded before the final carries, so that exactly the written values are tried.
        force = round(min(FORCE_FACTOR * least, FORCE_CEILING_N), 1)
        last = self._last_stiffness(force)
        stiffness = last if last == stiff else float(round(STIFFNESS_FACTOR * last))
        final = self.step("final", force, stiffness)
        if not (final.holds and final.worst("tracking_max_m") < TRACKING_MAX_M):
            row = final.row()
            raise TuningError(
                f"{force:.1f} N and {stiffness:.0f} N/m: {row['successes']} held, tracking "
                f"{row['tracking_max_mm']} mm (limit {1e3 * TRACKING_MAX_M:.0f}) {row['first_failure']}",
                remedy="see tuning.csv; carry more slowly or pinch harder (carry.impedance.pinch_n)",
            )
        compared = [self.step("compared", f, stiffness) for f in COMPARED_N]
        return Tuning(force, stiffness, least, last, final, compared, self.steps)

    def step(self, phase: str, force_n: float, stiffness_n_per_m: float) -> TuningStep:
        """Run one step."""
        config = changed(self._config, gains(force_n, stiffness_n_per_m))
        inputs = MethodInputs(config, self._seed)
        task = make_task(config)
        trials = [task.trial(self._seed, PURPOSE, i) for i in range(CARRIES_N)]
        carried = in_workers(lambda trial: carry_once(inputs, trial), trials, self._workers)
        step = TuningStep(phase, force_n, stiffness_n_per_m, tuple(carried))
        self.steps.append(step)
        if self._on_step is not None:
            self._on_step(step)
        return step

    def _least_force(self, stiffness: float) -> float:
        needed = self._config.scene.task.internal_force_min_n

        def margin(force_n: float) -> float:
            step = self.step("force", force_n, stiffness)
            least = step.worst("internal_force_min_n", np.min) - needed
            return least if step.holds else min(least, -_FORCE_STEP_N)

        _raise_until(margin, FORCES_N, _FORCE_STEP_N)
        # Brent's method may end on either side of the root: take the least force that held.
        held = [s.force_n for s in self.steps if s.phase == "force" and s.holds]
        if not held:
            row = self.steps[-1].row()
            raise TuningError(
                f"no squeeze up to {FORCES_N[-1]:.0f} N holds: least force {row['internal_force_min_n']} N, needs > "
                f"{needed:.0f}; {row['first_failure']}",
                remedy="pinch harder (carry.impedance.pinch_n) or see whether the pads slip (friction)",
            )
        return min(held)

    def _last_stiffness(self, force_n: float) -> float:
        def excess(stiffness: float) -> float:
            step = self.step("stiffness", force_n, stiffness)
            oscillation = step.worst("oscillation_m")
            if not step.holds or not np.isfinite(oscillation):
                return 1.0  # a failed carry counts as past the limit
            return oscillation / OSCILLATION_MAX_M - 1.0

        _raise_until(excess, STIFFNESSES_N_PER_M, _STIFFNESS_STEP_N_PER_M)
        good = [
            s.stiffness_n_per_m
            for s in self.steps
            if s.phase == "stiffness" and s.holds and s.worst("oscillation_m") <= OSCILLATION_MAX_M
        ]
        if not good:
            row = self.steps[-1].row()
            raise TuningError(
                f"the object oscillates even at {STIFFNESSES_N_PER_M[0]:.0f} N/m with {force_n:.1f} N "
                f"({row['oscillation_rms_mm']} mm RMS above {_HIGH_PASS_HZ:.0f} Hz)",
                remedy="raise carry.impedance.damping_ratio or look at the sensing delay",
            )
        return max(good)


def _raise_until(value: Callable[[float], float], ladder: Sequence[float], tolerance: float) -> None:
    """Bracket a root on a ladder, then use Brent's method."""
    seen: dict[float, float] = {}

    def remembered(x: float) -> float:
        if x not in seen:
            seen[x] = value(x)
        return seen[x]

    for low, high in zip((None, *ladder), ladder, strict=False):
        if remembered(high) > 0.0:
            if low is not None:
                brentq(remembered, low, high, xtol=tolerance)
            return


def carry_once(inputs: MethodInputs, trial: Trial) -> Carried:
    """Carry once and measure."""
    bench = Bench("impedance", inputs)
    name, tau_max = bench.task.carried, bench.world.robot.tau_max
    seen = ObjectTruth(name, bench.task.scene.objects[name])
    every = round(1.0 / (LOG_RATE_HZ * bench.world.dt))
    rows: list[tuple[float, ...]] = []
    count = 0

    def watch(world: World, method: Method) -> None:
        nonlocal count
        count += 1
        desired = getattr(method, "desired", None)
        if count % every or method.phase != "carry" or desired is None:
            return
        seen.refresh(world)
        error = seen.T[:3, 3] - desired.T_world_object[:3, 3]
        torque = float(np.max(np.abs(world.tau) / tau_max))
        rows.append((world.time, *error, seen.squeeze_n, torque, seen.tilt_rad))

    result, _ = bench.run(trial, on_step=watch)
    t, x, y, z, force, torque, tilt = np.array(rows).reshape(-1, 7).T
    errors = np.column_stack([x, y, z])
    size = np.linalg.norm(errors, axis=1)
    metrics = result.metrics
    return Carried(
        result.success,
        result.text,
        metrics.internal_force_min_n,
        float(size.max()) if len(size) else float("nan"),
        oscillation_m(errors),
        metrics.tilt_max_rad,
        metrics.torque_ratio_max,
        np.array([t, size, force, torque, tilt]),
    )


def oscillation_m(errors: Array, rate_hz: float = LOG_RATE_HZ) -> float:
    """Return the RMS of tracking errors (T, 3) [m] above 5 Hz, zero phase; NaN if too short."""
    if len(errors) < rate_hz / 2:
        return float("nan")
    sos = butter(4, _HIGH_PASS_HZ, btype="highpass", fs=rate_hz, output="sos")
    fast = np.asarray(sosfiltfilt(sos, errors, axis=0))
    return float(np.sqrt(np.mean(np.sum(fast**2, axis=1))))


def _said(value: float, digits: int) -> Any:
    return round(value, digits) if np.isfinite(value) else "not measured"
