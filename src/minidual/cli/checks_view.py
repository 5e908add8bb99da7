"""Checks of a verdict for people: tables where they fit the terminal, lines where they do not."""

from collections.abc import Callable, Mapping, Sequence

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Column, Table
from rich.text import Text

from minidual.gate.check import Check, with_unit

RESULTS = {
    True: Text("pass", "green"),
    False: Text("FAIL", "bold red"),
    None: Text("reported", "dim"),
}
_INDENT = 9
_WIDEST = 10_000
"""Columns in which the natural width of a table is measured."""

Wording = Callable[[str], str]
"""Completes the commands of a remedy."""


def checks_view(
    console: Console,
    checks: Sequence[Check],
    title: str,
    compared: Sequence[str] = (),
) -> RenderableType:
    """Return all checks, as the widest view that fits the console.

    Args:
        console: Where they are printed.
        checks: Of one verdict.
        title: Above them.
        compared: Names, such as methods, whose checks stand side by side.
    """
    by_row = _by_row(checks, compared)
    if by_row:
        rest = [check for check in checks if _split(check.name, compared) is None]
        return Group(_side_by_side(by_row, compared, title), *map(_line, rest))
    for table in (_table(checks, title), _narrow_table(checks, title)):
        options = console.options.update(max_width=_WIDEST)
        if console.measure(table, options=options).maximum <= console.width:
            return table
    return Group(Text(title, "italic"), *map(_line, checks))


def explained(checks: Sequence[Check], wording: Wording) -> RenderableType:
    """Return each check in words: value, limit, margin and reason, and the remedy of a failed one."""
    parts: list[RenderableType] = []
    for check in checks:
        margin = check.margin_text()
        parts.append(_line(check, f", margin {margin}" if margin else ""))
        texts = [check.why]
        if check.passed is False and check.remedy:
            texts.append(f"remedy: {check.remedy}")
        for text in texts:
            if text:
                parts.append(Padding(Text(wording(text)), (0, 0, 0, _INDENT)))
    return Group(*parts)


def _line(check: Check, more: str = "") -> Table:
    """Return, for example, "pass  tilt_max_rad is 0.1 rad, limit <= 0.2 rad", as one row."""
    row = Table.grid()
    row.add_column(width=_INDENT)
    row.add_column(overflow="fold")
    row.add_row(RESULTS[check.passed], check.sentence() + more)
    return row


def _table(checks: Sequence[Check], title: str) -> Table:
    table = Table(
        "check",
        Column("observed", justify="right"),
        Column("limit", justify="right"),
        Column("margin", justify="right"),
        "result",
        title=title,
        title_justify="left",
    )
    for check in checks:
        table.add_row(*_cells(check), check.margin_text(), RESULTS[check.passed])
    return table


def _narrow_table(checks: Sequence[Check], title: str) -> Table:
    """Return a table without margins and borders."""
    table = Table(
        "check",
        Column("observed", justify="right"),
        Column("limit", justify="right"),
        "result",
        title=title,
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    for check in checks:
        table.add_row(*_cells(check), RESULTS[check.passed])
    return table


def _cells(check: Check) -> tuple[str, str, str]:
    limit = f"{check.op} {with_unit(check.limit, check.unit)}" if check.op else ""
    return check.name, with_unit(check.observed, check.unit), limit


# Side by side


def _split(name: str, compared: Sequence[str]) -> tuple[str, str] | None:
    """Return (compared name, rest) of "rod_carry.moveit.success_rate"; None without one."""
    parts = name.split(".")
    for index, part in enumerate(parts):
        if part in compared:
            return part, ".".join([*parts[:index], *parts[index + 1 :]])
    return None


def _by_row(
    checks: Sequence[Check],
    compared: Sequence[str],
) -> dict[str, dict[str, Check]]:
    """Return {row: {compared name: check}}; nothing if fewer than two names have checks."""
    rows: dict[str, dict[str, Check]] = {}
    for check in checks:
        place = _split(check.name, compared)
        if place is not None:
            column, row = place
            rows.setdefault(row, {})[column] = check
    columns = {column for row in rows.values() for column in row}
    return rows if len(columns) > 1 else {}


def _side_by_side(
    rows: Mapping[str, Mapping[str, Check]],
    compared: Sequence[str],
    title: str,
) -> Table:
    """Return a table with one column for each compared name; units are part of the rows' names."""
    table = Table(
        Column("", overflow="fold"),
        *(Column(name, justify="right", no_wrap=True) for name in compared),
        title=title,
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    for name, cells in rows.items():
        table.add_row(name, *(_compared_cell(cells.get(column)) for column in compared))
    return table


def _compared_cell(check: Check | None) -> Text:
    """Return, for example, "0.62 > 0.8 FAIL"."""
    if check is None:
        return Text("-", "dim")
    text = with_unit(check.observed, "")
    if check.op:
        text += f" {check.op} {with_unit(check.limit, '')}"
    if check.passed is False:
        return Text(f"{text} FAIL", "bold red")
    return Text(text, "green" if check.passed else "")
