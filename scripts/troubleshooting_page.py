"""Write docs/troubleshooting.md from the catalogue of `minidual doctor --explain`."""

from __future__ import annotations

from pathlib import Path

from minidual.stages.troubles.catalogue import MISTAKES, SECTIONS, TROUBLES
from minidual.stages.troubles.trouble import LEVELS, Reference, Trouble

PAGE = Path(__file__).resolve().parents[1] / "docs" / "troubleshooting.md"
_MARKS = {"here": "yes", "in a run": "run", "": ""}
_HEAD = """# Troubleshooting: known troubles of two-arm systems

<!-- written by scripts/troubleshooting_page.py from src/minidual/stages/troubles -->

The {total} troubles that a tutorial on two-arm systems lists, and what minidual does about each.
`minidual doctor` probes {probed} of them: {here} on any machine ("yes"), {in_run} more in what a
run holds ("run"). The rest are explained only: they are detected where they happen, or minidual
lacks what causes them.

    minidual doctor                          # look for all of them
    minidual doctor --list                   # their names, by level
    minidual doctor --explain joint-order    # one of them, by name or number, with its cause

## Levels

Look from below. While a level fails, what lies above it tells nothing: most policies that "need
more data" have a fault far below.

"""
_MISTAKES = """
| symptom | often blamed | often the cause | look first at |
|---|---|---|---|
"""
_TABLE = """
## {title}

| | name | symptom | what minidual does | detected or set by | probed |
|---|---|---|---|---|---|
"""


def page() -> str:
    """Return the text of the page."""
    rows = list(TROUBLES.values())
    here_n = sum(row.probed == "here" for row in rows)
    in_run_n = sum(row.probed == "in a run" for row in rows)
    text = _HEAD.format(total=len(rows), probed=here_n + in_run_n, here=here_n, in_run=in_run_n)
    for level, words in LEVELS.items():
        text += f"{level + 1}. **{words.name}**: {words.question} `{words.command}`\n"
    text += _MISTAKES
    for mistake in MISTAKES:
        cells = (mistake.symptom, mistake.blamed, mistake.place, _named(mistake.reference))
        text += f"| {' | '.join(cells)} |\n"
    for title, troubles in SECTIONS.items():
        text += _TABLE.format(title=title)
        text += "".join(f"{_line(row)}\n" for row in troubles)
    return text


def _line(row: Trouble) -> str:
    references = ", ".join(_named(reference) for reference in row.references)
    cells = (
        str(row.number),
        f"`{row.name}`",
        row.symptom,
        row.answer,
        references,
        _MARKS[row.probed],
    )
    return f"| {' | '.join(cells)} |"


def _named(reference: Reference) -> str:
    if reference.kind == "message":
        return f'"{reference.name}"'
    return f"`{reference.name}`"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
