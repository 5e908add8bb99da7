"""Figure of a tuning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minidual.robot.pair import Array
from minidual.show.figures.canvas import BLUE, GREEN, INK, LIMIT, ORANGE, limit_line, new_figure
from minidual.trials.tuning import OSCILLATION_MAX_M, TRACKING_MAX_M, Carried, Tuning, TuningStep


def draw_tuning(tuning: Tuning, needed_n: float, path: Path) -> None:
    """Draw both searches and the compared forces."""
    figure, ((force, stiffness, track), (squeeze, torque, tilt)) = new_figure(2, 3, 14, 7.2)
    steps = [s for s in tuning.steps if s.phase == "force"]
    _scatter(force, steps, lambda s: s.force_n, lambda s: s.internal_force_min_n)
    limit_line(force, needed_n, "needed")
    force.axvline(tuning.force_n, color=INK, lw=1, label=f"chosen: {tuning.force_n:.1f} N")
    force.set(title="Phase 2: least squeeze that holds", xlabel="commanded squeeze (N)", ylabel="least measured (N)")

    steps = [s for s in tuning.steps if s.phase == "stiffness"]
    _scatter(stiffness, steps, lambda s: s.stiffness_n_per_m, lambda s: 1e3 * s.oscillation_m)
    limit_line(stiffness, 1e3 * OSCILLATION_MAX_M, "counts as oscillation")
    stiffness.axvline(tuning.stiffness_n_per_m, color=INK, lw=1, label=f"chosen: {tuning.stiffness_n_per_m:.0f} N/m")
    title = "Phase 3: stiffness before oscillation"
    stiffness.set(title=title, xlabel="stiffness (N/m)", ylabel="RMS above 5 Hz (mm)", ylim=(0, None))

    panels: tuple[tuple[Any, str, str, Callable[[Carried], Array], float | None], ...] = (
        (track, "Tracking error of the object", "mm", lambda c: 1e3 * c.series[1], 1e3 * TRACKING_MAX_M),
        (squeeze, "Internal force", "N", lambda c: c.series[2], needed_n),
        (torque, "Largest motor torque / limit", "", lambda c: c.series[3], 1.0),
        (tilt, "Tilt", "deg", lambda c: np.degrees(c.series[4]), None),
    )
    for axis, title, unit, value, limit in panels:
        for step, colour in zip(tuning.compared, (GREEN, BLUE, ORANGE), strict=True):
            carry = step.carries[0]
            label = f"{step.force_n:.0f} N" + ("" if step.holds else " (does not hold)")
            axis.plot(carry.series[0] - carry.series[0, :1], value(carry), color=colour, lw=1.2, label=label)
        if limit is not None:
            limit_line(axis, limit)
        axis.set(title=f"{title}, {tuning.stiffness_n_per_m:.0f} N/m", xlabel="s since the lift", ylabel=unit)
        axis.set_ylim(0, None)
    for axis in figure.axes:
        axis.legend(frameon=False, fontsize=8)
    figure.savefig(path)


def _scatter(
    axis: Any, steps: Sequence[TuningStep], x: Callable[[TuningStep], float], y: Callable[[TuningStep], float]
) -> None:
    for holds, marker, colour, label in ((True, "o", INK, "all held"), (False, "x", LIMIT, "not all held")):
        chosen = [s for s in steps if s.holds is holds]
        axis.plot([x(s) for s in chosen], [y(s) for s in chosen], marker, color=colour, label=label)
