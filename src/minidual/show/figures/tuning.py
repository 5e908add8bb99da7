"""Figure of a tuning."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from minidual.show.figures.canvas import INK, LIMIT, limit_line, new_figure, save_plot
from minidual.trials.tuning import OSCILLATION_MAX_M, Tuning, TuningStep

_SQUEEZE = "commanded squeeze (N)"
_STIFFNESS = "stiffness (N/m)"


def draw_tuning(tuning: Tuning, needed_n: float, path: Path) -> None:
    """Draw both searches, and tilt and torque of the compared forces.

    Args:
        tuning: What was tried and chosen.
        needed_n: Least internal force that holds [N].
        path: Of the figure.
    """
    figure, ((force, stiffness), (tilt, torque)) = new_figure(2, 2, 11, 7.2)
    _draw_force(force, tuning, needed_n)
    _draw_stiffness(stiffness, tuning)
    _draw_tilt(tilt, tuning)
    _draw_torque(torque, tuning)
    for axis in figure.axes:
        axis.set_ylim(0, None)
        axis.legend(frameon=False, fontsize=8)
    save_plot(figure, path)


def _draw_force(axis: Any, tuning: Tuning, needed_n: float) -> None:
    def point(step: TuningStep) -> tuple[float, float]:
        return step.force_n, step.worst("internal_force_min_n")

    _scatter(axis, _steps(tuning, "force"), point)
    limit_line(axis, needed_n, "needed")
    axis.axvline(tuning.force_n, color=INK, lw=1, label=f"chosen: {tuning.force_n:.1f} N")
    axis.set(
        title="Phase 2: least squeeze that holds",
        xlabel=_SQUEEZE,
        ylabel="least measured (N)",
    )


def _draw_stiffness(axis: Any, tuning: Tuning) -> None:
    def point(step: TuningStep) -> tuple[float, float]:
        return step.stiffness_n_per_m, 1e3 * step.worst("oscillation_m")

    _scatter(axis, _steps(tuning, "stiffness"), point)
    limit_line(axis, 1e3 * OSCILLATION_MAX_M, "counts as oscillation")
    chosen = f"chosen: {tuning.stiffness_n_per_m:.0f} N/m"
    axis.axvline(tuning.stiffness_n_per_m, color=INK, lw=1, label=chosen)
    axis.set(
        title="Phase 3: stiffness before oscillation",
        xlabel=_STIFFNESS,
        ylabel="RMS above 5 Hz (mm)",
    )


def _draw_tilt(axis: Any, tuning: Tuning) -> None:
    def point(step: TuningStep) -> tuple[float, float]:
        return step.force_n, math.degrees(step.worst("tilt_max_rad"))

    _scatter(axis, _steps(tuning, "compared"), point)
    axis.set(
        title=f"Compared at {tuning.stiffness_n_per_m:.0f} N/m",
        xlabel=_SQUEEZE,
        ylabel="largest tilt (deg)",
    )


def _draw_torque(axis: Any, tuning: Tuning) -> None:
    def point(step: TuningStep) -> tuple[float, float]:
        return step.force_n, step.worst("torque_ratio_max")

    _scatter(axis, _steps(tuning, "compared"), point)
    limit_line(axis, 1.0)
    axis.set(
        title="Compared: peak torque",
        xlabel=_SQUEEZE,
        ylabel="largest motor torque / limit",
    )


def _steps(tuning: Tuning, phase: str) -> list[TuningStep]:
    return [step for step in tuning.steps if step.phase == phase]


def _scatter(
    axis: Any,
    steps: Sequence[TuningStep],
    point: Callable[[TuningStep], tuple[float, float]],
) -> None:
    """Draw the (x, y) of each step; crosses where not all trials held."""
    for holds, marker, colour, label in (
        (True, "o", INK, "all held"),
        (False, "x", LIMIT, "not all held"),
    ):
        points = [point(step) for step in steps if step.holds is holds]
        xs = [x for x, _ in points]
        ys = [y for _, y in points]
        axis.plot(xs, ys, marker, color=colour, label=label)
