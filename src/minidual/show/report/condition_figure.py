"""Success of every method under every condition, as one dot plot."""

from __future__ import annotations

from minidual.show.report.figures import COLOURS, FAINT, GRID, Figure, label_rows, row_axes
from minidual.show.report.robustness import ConditionTable

_BAND = 0.72
"""Share of a row over which its methods are spread."""
_ROWS_EACH = 0.42
"""Height of one method's line, in rows of the other figures."""


def condition_figure(table: ConditionTable) -> Figure | None:
    """Return the figure; None where nothing disturbs."""
    if not table.rows:
        return None
    methods = [cell.method for cell in table.rows[0].cells]
    with row_axes(_ROWS_EACH * len(methods) * len(table.rows), "conditions") as (figure, axes, svg):
        for i, row in enumerate(table.rows):
            if i % 2 == 0:
                axes.axhspan(i - 0.5, i + 0.5, color=GRID, alpha=0.35, linewidth=0)
            for k, cell in enumerate(row.cells):
                y = i + _BAND * ((k + 0.5) / len(methods) - 0.5)
                colour = COLOURS[k % len(COLOURS)]
                if cell.rate is not None and cell.low is not None and cell.high is not None:
                    axes.plot([100 * cell.low, 100 * cell.high], [y, y], color=colour, linewidth=2.0, alpha=0.75)
                    axes.plot(100 * cell.rate, y, "o", color=colour, markersize=6.5, markeredgewidth=0)
                else:
                    words = "does not apply" if cell.state == "spared" else "missing"
                    axes.text(0, y, f"{cell.method}: {words}", fontsize=7.5, va="center", color=FAINT)
        for k, method in enumerate(methods):
            axes.plot([], [], "o-", color=COLOURS[k % len(COLOURS)], markersize=6.5, linewidth=2.0, label=method)
        label_rows(axes, [row.condition for row in table.rows])
        axes.set_ylim(len(table.rows) - 0.5, -0.5)
        axes.set_xlim(-2, 102)
        axes.set_xlabel("success, %")
        figure.legend(loc="outside upper center", ncols=len(methods), frameon=False, fontsize=9)
        caption = "Dots: share of trials that passed. Lines: 95 % Wilson interval. The first row is undisturbed."
        return Figure("conditions", "Success under each disturbance", caption, svg())
