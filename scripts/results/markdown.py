"""Tables of a page, and the line that says where their numbers come from."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

_COLUMNS = 100
_COMMIT_LENGTH = 8


class Origin(NamedTuple):
    """Where numbers come from.

    Attributes:
        commit: Of the code, with "+changes" if it was edited.
        machine: Processor and number of cores.
        date: YYYY-MM-DD.
    """

    commit: str
    machine: str
    date: str


def origin(commit: str | None, machine: Mapping[str, Any], made_at: str) -> Origin:
    """Return an origin from the fields of a verdict or of a bench's record."""
    whole, changes, _ = (commit or "unknown").partition("+")
    short = whole[:_COMMIT_LENGTH] + ("+changes" if changes else "")
    processor = f"{machine['processor']}, {machine['cores']} cores"
    return Origin(short, processor, made_at.partition("T")[0])


def origin_line(origins: Iterable[Origin], command: str) -> str:
    """Return the line above a table; each commit, machine and date once."""
    unique = list(dict.fromkeys(origins))
    commits = " and ".join(dict.fromkeys(item.commit for item in unique))
    machines = " and ".join(dict.fromkeys(item.machine for item in unique))
    dates = sorted({item.date for item in unique})
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    words = f"{commits}; {machines}; {when}; `{command}`"
    return "\n".join(
        textwrap.wrap(words, _COLUMNS, break_long_words=False, break_on_hyphens=False),
    )


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; every row has the header's number of cells."""
    lines = [_line(header), "|" + "---|" * len(header)]
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"{len(row)} cells under {len(header)} headers: {list(row)}")
        lines.append(_line(row))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "".join(f"| {cell} " if cell else "| " for cell in cells) + "|"
