"""One page on a tuning: what was tried, what was chosen, and 20, 40 and 80 N of squeeze side by side."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from minidual.robot.constants import Array
from minidual.trials.tuning import OSCILLATION_MAX_M, TRACKING_MAX_M, Carried, Tuning, TuningStep

_INK, _LIMIT = "#1f3b57", "#c0392b"
_COLOURS = ("#3a9a5b", "#2f6db5", "#e07b27")


def draw_tuning(tuning: Tuning, needed_n: float, path: Path) -> None:
    """Write a figure of six panels: the two searches, then tracking, force, torque and tilt of the compared forces."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(14, 7.2), constrained_layout=True)
    (force, stiffness, track), (squeeze, torque, tilt) = axes

    steps = [s for s in tuning.steps if s.phase == "force"]
    _scatter(force, steps, lambda s: s.force_n, lambda s: s.worst("internal_force_min_n", np.min))
    force.axhline(needed_n, color=_LIMIT, lw=1, ls="--", label="needed")
    force.axvline(tuning.force_n, color=_INK, lw=1, label=f"chosen: {tuning.force_n:.1f} N")
    force.set(title="Phase 2: least squeeze that holds", xlabel="commanded squeeze (N)", ylabel="least measured (N)")

    steps = [s for s in tuning.steps if s.phase == "stiffness"]
    _scatter(stiffness, steps, lambda s: s.stiffness_n_per_m, lambda s: 1e3 * s.worst("oscillation_m"))
    stiffness.axhline(1e3 * OSCILLATION_MAX_M, color=_LIMIT, lw=1, ls="--", label="counts as oscillation")
    stiffness.axvline(tuning.stiffness_n_per_m, color=_INK, lw=1, label=f"chosen: {tuning.stiffness_n_per_m:.0f} N/m")
    stiffness.set(
        title="Phase 3: stiffness before oscillation",
        xlabel="stiffness (N/m)",
        ylabel="RMS above 5 Hz (mm)",
        ylim=(0, None),
    )
    panels: tuple[tuple[object, str, str, Callable[[Carried], Array], float | None], ...] = (
        (track, "Tracking error of the object", "mm", lambda c: 1e3 * c.error_m, 1e3 * TRACKING_MAX_M),
        (squeeze, "Internal force", "N", lambda c: c.force_n, needed_n),
        (torque, "Largest motor torque / limit", "", lambda c: c.torque_ratio, 1.0),
        (tilt, "Tilt", "deg", lambda c: np.degrees(c.tilt_rad), None),
    )
    for axis, title, unit, value, limit in panels:
        for step, colour in zip(tuning.compared, _COLOURS, strict=True):
            carry = step.carries[0]
            label = f"{step.force_n:.0f} N" + ("" if step.holds else " (does not hold)")
            if len(carry.t_s):
                axis.plot(carry.t_s - carry.t_s[0], value(carry), color=colour, lw=1.2, label=label)  # type: ignore[attr-defined]
            else:
                axis.plot([], [], color=colour, label=label)  # type: ignore[attr-defined]
        if limit is not None:
            axis.axhline(limit, color=_LIMIT, lw=1, ls="--", label="limit")  # type: ignore[attr-defined]
        axis.set(
            title=f"{title}, {tuning.stiffness_n_per_m:.0f} N/m", xlabel="s since the lift", ylabel=unit, ylim=(0, None)
        )  # type: ignore[attr-defined]
    for axis in axes.flat:
        axis.grid(alpha=0.25)
        axis.legend(frameon=False, fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _scatter(
    axis: object, steps: list[TuningStep], x: Callable[[TuningStep], float], y: Callable[[TuningStep], float]
) -> None:
    for holds, marker, colour, label in ((True, "o", _INK, "all five held"), (False, "x", _LIMIT, "not all held")):
        chosen = [s for s in steps if s.holds is holds]
        axis.plot([x(s) for s in chosen], [y(s) for s in chosen], marker, color=colour, label=label)  # type: ignore[attr-defined]
