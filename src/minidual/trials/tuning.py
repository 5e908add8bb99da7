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
from minidual.plant.world import World
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
    **dict.fromkeys(
        ("tracking_max_m", "oscillation_m", "torque_ratio_max", "tilt_max_rad"),
        np.max,
    ),
    "internal_force_min_n": np.min,
}
"""What the worst of several carries is."""


class TuningError(MinidualError):
    """No gains were found."""


@dataclass(frozen=True)
class TuningStep:
    """Carries with one force and stiffness; `worst` tells their numbers."""

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
        return float(_WORST[name]([{**vars(c), **c.measured}[name] for c in self.carries]))

    def row(self) -> dict[str, Any]:
        """Return the tuning.csv row."""
        failed = [c.text for c in self.carries if not c.success]
        return {
            "phase": self.phase,
            "internal_force_n": round(self.force_n, 2),
            "stiffness_n_per_m": round(self.stiffness_n_per_m, 1),
            "successes": f"{len(self.carries) - len(failed)} of {len(self.carries)}",
            "internal_force_min_n": _said(self.worst("internal_force_min_n"), 2),
            "tracking_max_mm": _said(1e3 * self.worst("tracking_max_m"), 2),
            "oscillation_rms_mm": _said(1e3 * self.worst("oscillation_m"), 3),
            "tilt_max_deg": _said(math.degrees(self.worst("tilt_max_rad")), 2),
            "torque_max_percent": _said(100.0 * self.worst("torque_ratio_max"), 0),
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
        self._safe(FORCES_N[0], STIFFNESSES_N_PER_M[0])
        start = self._config.carry.impedance.stiffness_n_per_m
        _, least = _bracket(
            FORCES_N,
            _FORCE_STEP_N,
            lambda force: self._step("force", force, start).holds,
        )
        if least is None:
            row = self.steps[-1].row()
            found = f"least force {row['internal_force_min_n']} N, needs > {self._config.scene.task.internal_force_min_n:.0f}"
            remedy = (
                "pinch harder (carry.impedance.pinch_n) or see whether the pads slip (friction)"
            )
            what = f"no squeeze up to {FORCES_N[-1]:.0f} N holds: {found}; {row['first_failure']}"
            raise TuningError(what, remedy=remedy)
        # Rounded before the final carries, so that exactly the written values are tried.
        force = round(FORCE_FACTOR * least, 1)

        last, _ = _bracket(
            STIFFNESSES_N_PER_M,
            _STEP_N_PER_M,
            lambda k: not self._step("stiffness", force, k).steady,
        )
        if last is None:
            row = self.steps[-1].row()
            found = f"{row['oscillation_rms_mm']} mm RMS above {_HIGH_PASS_HZ:.0f} Hz) {row['first_failure']}"
            what = f"the object oscillates even at {STIFFNESSES_N_PER_M[0]:.0f} N/m with {force:.1f} N ({found}"
            raise TuningError(
                what,
                remedy="raise carry.impedance.damping_ratio or look at the sensing delay",
            )
        stiffness = (
            last if last == STIFFNESSES_N_PER_M[-1] else float(round(STIFFNESS_FACTOR * last))
        )
        final = self._step("final", force, stiffness)
        if not (final.holds and final.worst("tracking_max_m") < TRACKING_MAX_M):
            row = final.row()
            tracking = f"tracking {row['tracking_max_mm']} mm (limit {1e3 * TRACKING_MAX_M:.0f}) {row['first_failure']}"
            what = f"{force:.1f} N and {stiffness:.0f} N/m: {row['successes']} held, {tracking}"
            remedy = "see tuning.csv; carry more slowly or pinch harder (carry.impedance.pinch_n)"
            raise TuningError(what, remedy=remedy)
        for compared in COMPARED_N:
            self._step("compared", compared, stiffness)
        return Tuning(force, stiffness, least, self.steps)

    def _safe(self, force_n: float, stiffness_n_per_m: float) -> None:
        """Raise if the softest step overloads a motor, or fails for another reason than too little squeeze."""
        step = self._step("safe", force_n, stiffness_n_per_m)
        remedy = "carry more slowly: lower carry.pace.object_speed_m_per_s"
        what = f"the softest carry ({stiffness_n_per_m:.0f} N/m, {force_n:.0f} N)"
        if not (ratio := step.worst("torque_ratio_max")) < _SAFE_TORQUE:
            raise TuningError(
                f"{what} already takes {100 * ratio:.0f} % of a motor's torque",
                remedy=remedy,
            )
        if failed := [c for c in step.carries if not c.success and c.failure != _SQUEEZED]:
            raise TuningError(
                f"{what} is not safe: trial {failed[0].index}, {failed[0].text}",
                remedy=remedy,
            )

    def _step(self, phase: str, force_n: float, stiffness_n_per_m: float) -> TuningStep:
        settings = {f"carry.impedance.{k}": v for k, v in gains(force_n, stiffness_n_per_m).items()}
        config = changed(self._config, settings)
        inputs = MethodInputs(config, self._seed)
        task = make_task(config)
        trials = [task.trial(self._seed, PURPOSE, i) for i in range(CARRIES_N)]
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
    """Return the last value for which `stops` is false and the first for which it is true, or None.

    Tries `ladder` in order, then bisects to `step`.
    """
    first = next((k for k, value in enumerate(ladder) if stops(value)), len(ladder))
    low = ladder[first - 1] if first else None
    high = ladder[first] if first < len(ladder) else None
    while low is not None and high is not None and high - low > step:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if stops(middle) else (middle, high)
    return low, high


def carry_once(inputs: MethodInputs, trial: Trial) -> TrialMetrics:
    """Carry once; measure `tracking_max_m`, the largest position error of the object, and `oscillation_m` of it too."""
    bench = Bench("impedance", inputs)
    every = round(1.0 / (LOG_RATE_HZ * bench.world.dt))
    errors: list[Array] = []
    ticks = count(1)

    def watch(world: World, method: Method) -> None:
        desired = method.stack.impedance.desired if isinstance(method, ImpedanceCarry) else None
        if next(ticks) % every == 0 and method.phase == "carry" and desired is not None:
            errors.append(
                world.object_pose(bench.task.carried)[:3, 3] - desired.T_world_object[:3, 3],
            )

    result, _ = bench.run(trial, on_step=watch)
    log = np.array(errors).reshape(-1, 3)
    tracking_max_m = float(np.linalg.norm(log, axis=1).max()) if errors else math.nan
    found = {"tracking_max_m": tracking_max_m, "oscillation_m": oscillation_m(log)}
    return replace(result, measured={**result.measured, **found})


def oscillation_m(errors: Array) -> float:
    """Return the RMS of tracking errors (T, 3) [m], logged at LOG_RATE_HZ, above 5 Hz, zero phase; NaN if too short."""
    if len(errors) < LOG_RATE_HZ / 2:
        return math.nan
    sos = butter(4, _HIGH_PASS_HZ, btype="highpass", fs=LOG_RATE_HZ, output="sos")
    fast = np.asarray(sosfiltfilt(sos, errors, axis=0))
    return float(np.sqrt(np.mean(np.sum(fast**2, axis=1))))


def _said(value: float, digits: int) -> Any:
    return round(value, digits) if np.isfinite(value) else "not measured"
