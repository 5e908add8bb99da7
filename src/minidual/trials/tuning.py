"""Tune internal force and stiffness of the object impedance by carrying.

The steps are safe, force, stiffness (docs/carry.md). Each is five carries; the worst counts.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from minidual.config.root import Config, changed
from minidual.errors import MinidualError
from minidual.plant.simulation import Simulation
from minidual.robot.pair import Array
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import LOG_RATE_HZ, Bench
from minidual.workers import in_workers

PURPOSE = "tuning"
"""Random stream of the starts, not used for acceptance."""
CARRIES_N = 5
FORCES_N = (10.0, 20.0, 30.0, 40.0)
STIFFNESSES_N_PER_M = (150.0, 300.0, 450.0, 600.0)  # the last is the largest recommended
FORCE_FACTOR = 1.5
STIFFNESS_FACTOR = 0.8
OSCILLATION_MAX_M = 0.0003
TRACKING_MAX_M = 0.01
COMPARED_N = (20.0, 40.0, 80.0)
_HIGH_PASS_HZ = 5.0
_FORCE_STEP_N = 0.5
_STEP_N_PER_M = 10.0
_SAFE_TORQUE = 0.95
# The condition of success that the softest step may fail.
_SQUEEZED = "squeezed"
_WORST: dict[str, Callable[[Sequence[float]], Any]] = {
    "tracking_max_m": np.max,
    "oscillation_m": np.max,
    "torque_ratio_max": np.max,
    "tilt_max_rad": np.max,
    "internal_force_min_n": np.min,
}
"""The worst of several carries."""


class TuningError(MinidualError):
    """No gains were found."""


@dataclass(frozen=True)
class TuningStep:
    """Carries with one force and stiffness."""

    phase: str
    force_n: float
    stiffness_n_per_m: float
    carries: Sequence[TrialMetrics]

    @property
    def holds(self) -> bool:
        """Whether all succeeded."""
        return all(c.success for c in self.carries)

    @property
    def steady(self) -> bool:
        """Whether all succeeded without oscillation; false for NaN."""
        return self.holds and self.worst("oscillation_m") <= OSCILLATION_MAX_M

    def worst(self, name: str) -> float:
        """Return the worst of a number in `_WORST`; NaN propagates."""
        values = [{**vars(carry), **carry.measured}[name] for carry in self.carries]
        return float(_WORST[name](values))

    def row(self) -> dict[str, Any]:
        """Return the tuning.csv row."""
        failed = [carry.text for carry in self.carries if not carry.success]
        carries_n = len(self.carries)
        return {
            "phase": self.phase,
            "internal_force_n": round(self.force_n, 2),
            "stiffness_n_per_m": round(self.stiffness_n_per_m, 1),
            "successes": f"{carries_n - len(failed)} of {carries_n}",
            "internal_force_min_n": _or_words(self.worst("internal_force_min_n"), 2),
            "tracking_max_mm": _or_words(1e3 * self.worst("tracking_max_m"), 2),
            "oscillation_rms_mm": _or_words(1e3 * self.worst("oscillation_m"), 3),
            "tilt_max_deg": _or_words(math.degrees(self.worst("tilt_max_rad")), 2),
            "torque_max_percent": _or_words(100.0 * self.worst("torque_ratio_max"), 0),
            "first_failure": failed[0] if failed else "",
        }


class Tuning(NamedTuple):
    """The gains and every step."""

    force_n: float
    stiffness_n_per_m: float
    least_force_n: float
    steps: Sequence[TuningStep]


def gains(force_n: float, stiffness_n_per_m: float) -> dict[str, float]:
    """Return values of `carry.impedance`; rotational stiffness is 0.16 m^2 of translational."""
    return {
        "internal_force_n": float(force_n),
        "stiffness_n_per_m": float(stiffness_n_per_m),
        "stiffness_nm_per_rad": 0.16 * float(stiffness_n_per_m),
    }


class Tuner:
    """Runs the three phases."""

    def __init__(
        self,
        config: Config,
        seed: int,
        *,
        workers: int = 1,
        on_step: Callable[[TuningStep], None] = lambda step: None,
    ) -> None:
        self._config = config
        self._seed = seed
        self._workers = workers
        self._on_step = on_step
        self.steps: list[TuningStep] = []

    def run(self) -> Tuning:
        """Return the gains.

        Raises:
            TuningError: The softest step is unsafe, or no gains hold.
        """
        self._check_softest(FORCES_N[0], STIFFNESSES_N_PER_M[0])
        least_n = self._least_force_n()
        # Rounded before the final carries, so that exactly the written values are tried.
        force_n = round(FORCE_FACTOR * least_n, 1)
        stiffness = self._largest_stiffness_n_per_m(force_n)
        self._check_final(force_n, stiffness)
        for compared_n in COMPARED_N:
            self._step("compared", compared_n, stiffness)
        return Tuning(force_n, stiffness, least_n, self.steps)

    def _check_softest(self, force_n: float, stiffness_n_per_m: float) -> None:
        """Raise if the softest step overloads a motor, or fails for another reason than squeeze."""
        step = self._step("safe", force_n, stiffness_n_per_m)
        title = f"the softest carry ({stiffness_n_per_m:.0f} N/m, {force_n:.0f} N)"
        remedy = "carry more slowly: lower carry.pace.object_speed_m_per_s"
        torque_ratio = step.worst("torque_ratio_max")
        overloads = not torque_ratio < _SAFE_TORQUE  # true for NaN
        if overloads:
            raise TuningError(
                f"{title} already takes {100 * torque_ratio:.0f} % of a motor's torque",
                remedy=remedy,
            )
        for carry in step.carries:
            if not carry.success and carry.failure != _SQUEEZED:
                raise TuningError(
                    f"{title} is not safe: trial {carry.index}, {carry.text}",
                    remedy=remedy,
                )

    def _least_force_n(self) -> float:
        """Return the least internal force that holds, at the configured stiffness."""
        stiffness = self._config.carry.impedance.stiffness_n_per_m

        def holds(force_n: float) -> bool:
            return self._step("force", force_n, stiffness).holds

        _, least_n = _bracket(FORCES_N, _FORCE_STEP_N, holds)
        if least_n is not None:
            return least_n
        row = self.steps[-1].row()
        needed_n = self._config.scene.task.internal_force_min_n
        measured = f"least force {row['internal_force_min_n']} N, needs > {needed_n:.0f}"
        raise TuningError(
            f"no squeeze up to {FORCES_N[-1]:.0f} N holds: {measured}; {row['first_failure']}",
            remedy="pinch harder (carry.impedance.pinch_n) or see whether the pads slip (friction)",
        )

    def _largest_stiffness_n_per_m(self, force_n: float) -> float:
        """Return a share of the largest stiffness without oscillation, or the largest tried."""

        def oscillates(stiffness: float) -> bool:
            return not self._step("stiffness", force_n, stiffness).steady

        largest, _ = _bracket(STIFFNESSES_N_PER_M, _STEP_N_PER_M, oscillates)
        if largest is None:
            row = self.steps[-1].row()
            gains_text = f"{STIFFNESSES_N_PER_M[0]:.0f} N/m with {force_n:.1f} N"
            measured = f"{row['oscillation_rms_mm']} mm RMS above {_HIGH_PASS_HZ:.0f} Hz"
            raise TuningError(
                f"the object oscillates even at {gains_text} ({measured}) {row['first_failure']}",
                remedy="raise carry.impedance.damping_ratio or look at the sensing delay",
            )
        if largest == STIFFNESSES_N_PER_M[-1]:
            return largest
        return float(round(STIFFNESS_FACTOR * largest))

    def _check_final(self, force_n: float, stiffness_n_per_m: float) -> None:
        """Carry with the final gains; raise if that fails or the object is tracked badly."""
        final = self._step("final", force_n, stiffness_n_per_m)
        if final.holds and final.worst("tracking_max_m") < TRACKING_MAX_M:
            return
        row = final.row()
        gains_text = f"{force_n:.1f} N and {stiffness_n_per_m:.0f} N/m"
        limit_mm = 1e3 * TRACKING_MAX_M
        tracking = f"tracking {row['tracking_max_mm']} mm (limit {limit_mm:.0f})"
        raise TuningError(
            f"{gains_text}: {row['successes']} held, {tracking} {row['first_failure']}",
            remedy="see tuning.csv; carry more slowly or pinch harder (carry.impedance.pinch_n)",
        )

    def _step(self, phase: str, force_n: float, stiffness_n_per_m: float) -> TuningStep:
        values = gains(force_n, stiffness_n_per_m)
        config = changed(
            self._config,
            {f"carry.impedance.{name}": value for name, value in values.items()},
        )
        inputs = MethodInputs(config, self._seed)
        task = make_task(config)
        trials = [task.trial(self._seed, PURPOSE, index) for index in range(CARRIES_N)]
        carries = list(in_workers(lambda trial: carry_once(inputs, trial), trials, self._workers))
        step = TuningStep(phase, force_n, stiffness_n_per_m, carries)
        self.steps.append(step)
        self._on_step(step)
        return step


def _bracket(
    ladder: Sequence[float],
    step: float,
    stops: Callable[[float], bool],
) -> tuple[float | None, float | None]:
    """Return the last value for which `stops` is false and the first for which it is true.

    Tries `ladder` in order, then bisects to `step`. None where there is no such value.
    """
    low: float | None = None
    high: float | None = None
    for value in ladder:
        if stops(value):
            high = value
            break
        low = value
    while low is not None and high is not None and high - low > step:
        middle = 0.5 * (low + high)
        if stops(middle):
            high = middle
        else:
            low = middle
    return low, high


def carry_once(inputs: MethodInputs, trial: Trial) -> TrialMetrics:
    """Carry once, and measure how the object follows its desired position.

    `tracking_max_m` is the largest error, `oscillation_m` its oscillation.
    """
    bench = Bench("impedance", inputs)
    every = round(1.0 / (LOG_RATE_HZ * bench.world.dt))
    errors: list[Array] = []
    ticks = count(1)

    def watch(world: Simulation, method: Method) -> None:
        if next(ticks) % every != 0 or method.phase != "carry":
            return
        desired = method.stack.impedance.desired if isinstance(method, ImpedanceCarry) else None
        if desired is not None:
            position = world.truth(bench.task.carried).pose()[:3, 3]
            errors.append(position - desired.T_world_object[:3, 3])

    result, _ = bench.run(trial, on_step=watch)
    log = np.array(errors).reshape(-1, 3)
    tracking_max_m = float(np.linalg.norm(log, axis=1).max()) if errors else math.nan
    tracking = {"tracking_max_m": tracking_max_m, "oscillation_m": oscillation_m(log)}
    return replace(result, measured={**result.measured, **tracking})


def oscillation_m(errors: Array) -> float:
    """Return the RMS of tracking errors (T, 3) [m] above 5 Hz, zero phase; NaN if too short.

    They are logged at LOG_RATE_HZ.
    """
    if len(errors) < LOG_RATE_HZ / 2:
        return math.nan
    sos = butter(4, _HIGH_PASS_HZ, btype="highpass", fs=LOG_RATE_HZ, output="sos")
    fast = np.asarray(sosfiltfilt(sos, errors, axis=0))
    return float(np.sqrt(np.mean(np.sum(fast**2, axis=1))))


def _or_words(value: float, digits: int) -> Any:
    return round(value, digits) if np.isfinite(value) else "not measured"
