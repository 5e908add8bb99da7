"""Figure of a tuning."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from minidual.show.figures.canvas import INK, LIMIT, limit_line, new_figure
from minidual.trials.tuning import OSCILLATION_MAX_M, Tuning, TuningStep

_SQUEEZE = "commanded squeeze (N)"
_STIFFNESS = "stiffness (N/m)"


def draw_tuning(tuning: Tuning, needed_n: float, path: Path) -> None:
    """Draw both searches, and tilt and torque of the compared forces."""
    figure, ((force, stiffness), (tilt, torque)) = new_figure(2, 2, 11, 7.2)
    phases = {
        name: [s for s in tuning.steps if s.phase == name]
        for name in ("force", "stiffness", "compared")
    }
    _scatter(force, phases["force"], lambda s: (s.force_n, s.worst("internal_force_min_n")))
    limit_line(force, needed_n, "needed")
    force.axvline(tuning.force_n, color=INK, lw=1, label=f"chosen: {tuning.force_n:.1f} N")
    force.set(
        title="Phase 2: least squeeze that holds",
        xlabel=_SQUEEZE,
        ylabel="least measured (N)",
    )

    _scatter(
        stiffness,
        phases["stiffness"],
        lambda s: (s.stiffness_n_per_m, 1e3 * s.worst("oscillation_m")),
    )
    limit_line(stiffness, 1e3 * OSCILLATION_MAX_M, "counts as oscillation")
    stiffness.axvline(
        tuning.stiffness_n_per_m,
        color=INK,
        lw=1,
        label=f"chosen: {tuning.stiffness_n_per_m:.0f} N/m",
    )
    stiffness.set(
        title="Phase 3: stiffness before oscillation",
        xlabel=_STIFFNESS,
        ylabel="RMS above 5 Hz (mm)",
    )

    _scatter(tilt, phases["compared"], lambda s: (s.force_n, math.degrees(s.worst("tilt_max_rad"))))
    tilt.set(
        title=f"Compared at {tuning.stiffness_n_per_m:.0f} N/m",
        xlabel=_SQUEEZE,
        ylabel="largest tilt (deg)",
    )
    _scatter(torque, phases["compared"], lambda s: (s.force_n, s.worst("torque_ratio_max")))
    limit_line(torque, 1.0)
    torque.set(
        title="Compared: peak torque",
        xlabel=_SQUEEZE,
        ylabel="largest motor torque / limit",
    )
    for axis in figure.axes:
        axis.set_ylim(0, None)
        axis.legend(frameon=False, fontsize=8)
    figure.savefig(path)


def _scatter(
    axis: Any,
    steps: Sequence[TuningStep],
    at: Callable[[TuningStep], tuple[float, float]],
) -> None:
    for holds, marker, colour, label in (
        (True, "o", INK, "all held"),
        (False, "x", LIMIT, "not all held"),
    ):
        points = [at(s) for s in steps if s.holds is holds]
        axis.plot([x for x, _ in points], [y for _, y in points], marker, color=colour, label=label)
