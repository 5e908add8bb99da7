"""Figure of planning times."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from minidual.config.seeds import stream
from minidual.motion.result import PHASES
from minidual.show.figures.canvas import INK, LIMIT, new_figure
from minidual.trials.planning.evaluate import Outcome

_SHOWN = tuple(phase for phase in PHASES if phase != "scene")


def write_times(
    outcomes: Mapping[str, Sequence[Outcome]], path: Path, median_max_s: Mapping[str, float | None]
) -> None:
    """Draw planning times by group and phase."""
    figure, ((spread, shares),) = new_figure(1, 2, 11.0, 4.2)
    groups = list(outcomes)
    for row, (group, done) in enumerate(outcomes.items()):
        solved, failed = (1e3 * np.array([o.total_s for o in done if o.ok is ok]) for ok in (True, False))
        jitter = stream(0, "figure/jitter", row).uniform(-0.18, 0.18, len(solved))
        spread.plot(solved, row + jitter, "o", ms=5, alpha=0.6, mew=0)
        spread.plot(failed, np.full(len(failed), row), "x", ms=8, color=LIMIT)
        ends = [row - 0.3, row + 0.3]
        if len(solved):
            median = float(np.median(solved))
            spread.plot([median, median], ends, color=INK, lw=2)
            spread.annotate(f"{median:.1f} ms", (median, row + 0.33), ha="center", va="bottom", fontsize=9)
        limit = median_max_s[group]
        if limit is not None:
            spread.plot([limit * 1e3] * 2, ends, color=LIMIT, lw=1.6, ls="--")
    spread.set_xscale("log")
    spread.xaxis.set_major_formatter("{x:g}")
    spread.xaxis.set_minor_formatter("{x:g}")
    spread.grid(axis="x", which="both", alpha=0.25)
    spread.set_yticks(range(len(groups)), groups)
    spread.set_ylim(-0.6, len(groups) - 0.3)
    spread.set_xlabel("goal in to proven trajectory out [ms]; bar: median, dashed: its limit")
    left = np.zeros(len(groups))
    for phase in _SHOWN:
        times = ([o.result.times_s[phase] for o in outcomes[g] if o.result is not None] for g in groups)
        medians = np.array([1e3 * float(np.median(found or [0.0])) for found in times])
        shares.barh(groups, medians, left=left, label=phase, height=0.55)
        left += medians
    shares.set_xlabel("median time of each phase [ms]")
    shares.legend(fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.18), frameon=False)
    figure.savefig(path)
