"""Figure of planning times."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.seeds import stream
from minidual.motion.api import PLAN_PHASES
from minidual.show.figures.canvas import BLUE, GREEN, INK, LIMIT, ORANGE, new_figure, save_plot
from minidual.trials.planning.evaluate import QueryOutcome

_PHASES = tuple(phase for phase in PLAN_PHASES if phase != "scene")
"""Phases that count as planning time."""
_FILLS = (BLUE, ORANGE, GREEN, "#7d5bbf", "#b04066", "#66717e")
_HATCHES = ("", "//", "..", "\\\\", "xx", "--")


def write_times(
    outcomes: Mapping[str, Sequence[QueryOutcome]],
    path: Path,
    median_max_s: Mapping[str, float | None],
) -> None:
    """Draw planning times by group and phase.

    Args:
        outcomes: Queries by group.
        path: Of the figure.
        median_max_s: Limit of the median by group, if it has one.
    """
    figure, ((spread, shares),) = new_figure(1, 2, 11.0, 4.2)
    _draw_spread(spread, outcomes, median_max_s)
    _draw_phases(shares, outcomes)
    save_plot(figure, path)


def _draw_spread(
    axis: Any,
    outcomes: Mapping[str, Sequence[QueryOutcome]],
    median_max_s: Mapping[str, float | None],
) -> None:
    """Draw the time of every query, a row per group."""
    for row, (group, of_group) in enumerate(outcomes.items()):
        solved_ms = 1e3 * np.array([outcome.total_s for outcome in of_group if outcome.ok])
        failed_ms = 1e3 * np.array([outcome.total_s for outcome in of_group if not outcome.ok])
        jitter = stream(0, "figure/jitter", row).uniform(-0.18, 0.18, len(solved_ms))
        axis.plot(solved_ms, row + jitter, "o", color="0.5", ms=5, alpha=0.6, mew=0)
        axis.plot(failed_ms, np.full(len(failed_ms), row), "x", ms=8, color=LIMIT)
        bar = [row - 0.3, row + 0.3]
        if len(solved_ms):
            median_ms = float(np.median(solved_ms))
            axis.plot([median_ms, median_ms], bar, color=INK, lw=2)
            axis.annotate(
                f"{median_ms:.1f} ms",
                (median_ms, row + 0.33),
                ha="center",
                va="bottom",
                fontsize=9,
            )
        limit_s = median_max_s[group]
        if limit_s is not None:
            axis.plot([1e3 * limit_s, 1e3 * limit_s], bar, color=LIMIT, lw=1.6, ls="--")
    axis.set_xscale("log", subs=[2, 5])
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter("{x:g}")
    axis.grid(axis="x", which="both", alpha=0.25)
    axis.set_yticks(range(len(outcomes)), list(outcomes))
    axis.set_ylim(-0.6, len(outcomes) - 0.3)
    axis.set_xlabel(
        "goal in to proven trajectory out [ms]; bar: median; dashed: its limit, if it has one",
    )


def _draw_phases(axis: Any, outcomes: Mapping[str, Sequence[QueryOutcome]]) -> None:
    """Draw the median time of each phase, a stacked bar per group."""
    groups = list(outcomes)
    left_ms = np.zeros(len(groups))
    for k, phase in enumerate(_PHASES):
        medians_ms = np.array([_median_ms(outcomes[group], phase) for group in groups])
        axis.barh(
            groups,
            medians_ms,
            left=left_ms,
            label=phase,
            height=0.55,
            hatch=_HATCHES[k % len(_HATCHES)],
            color=_FILLS[k % len(_FILLS)],
            edgecolor="white",
        )
        left_ms += medians_ms
    axis.set_xlabel("median time of each phase [ms]")
    axis.legend(
        fontsize=8,
        ncols=3,
        loc="upper center",
        bbox_to_anchor=(0.5, 1.18),
        frameon=False,
    )


def _median_ms(outcomes: Sequence[QueryOutcome], phase: str) -> float:
    """Return the median of a phase over the solved queries; 0 without any."""
    times_s = [outcome.result.times_s[phase] for outcome in outcomes if outcome.result is not None]
    if not times_s:
        return 0.0
    return 1e3 * float(np.median(times_s))
