"""docs/checks.md has a row for each check of each stage, and names tests that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import NamedTuple

from minidual.gate.stage import closing_checks
from minidual.show.report.wording import CHECK_WORDS
from tests.support.stage_criteria import MODULES, criteria_of

TESTS = Path(__file__).resolve().parents[1]
PAGE = TESTS.parent / "docs" / "checks.md"


class Row(NamedTuple):
    """A row of the page."""

    check: str
    fault: str
    test: str


class Section(NamedTuple):
    """What the page says of a stage.

    Attributes:
        rows: Of checks with a limit.
        reported: Names of values without a limit.
    """

    rows: list[Row]
    reported: list[str]


def sections(text: str) -> dict[str, Section]:
    """Return the sections of the page by stage."""
    found: dict[str, Section] = {}
    for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        stage, _, body = part.partition("\n")
        lines = [line for line in body.splitlines() if line.startswith("| `")]
        rows = [Row(*(cell.strip(" `") for cell in line.strip("| ").split("|"))) for line in lines]
        _, _, without_limit = body.partition("Without a limit:")
        found[stage.strip()] = Section(rows, re.findall(r"`([^`]+)`", without_limit))
    return found


def declared() -> dict[str, tuple[set[str], set[str]]]:
    """Return the names of each stage's checks: those with a limit, and those without."""
    names: dict[str, tuple[set[str], set[str]]] = {}
    for stage, module in MODULES.items():
        criteria = criteria_of(module)
        limited = {criterion.name for criterion in criteria if criterion.op}
        names[stage] = limited, {criterion.name for criterion in criteria if not criterion.op}
    closing = {check.name for check in closing_checks([], {})}
    names["report"] = {*CHECK_WORDS, *closing}, set()
    return names


def faults_of_table(text: str) -> list[str]:
    """Return what the page lacks, repeats or says of checks that do not exist."""
    told = sections(text)
    faults: list[str] = []
    for stage, (limited, reported) in declared().items():
        section = told.get(stage, Section([], []))
        rows = [row.check for row in section.rows]
        faults += [f"{stage}: no row of {name}" for name in sorted(limited - set(rows))]
        faults += [f"{stage}: no check {name}" for name in sorted(set(rows) - limited)]
        faults += [f"{stage}: {name} twice" for name in sorted(set(rows)) if rows.count(name) > 1]
        differing = sorted(set(section.reported) ^ reported)
        faults += [f"{stage}: {name} has no limit, or a limit" for name in differing]
        faults += [
            f"{stage}: {row.check} has an empty cell" for row in section.rows if not row.fault
        ]
        faults += [f"{stage}: no test {row.test}" for row in section.rows if not exists(row.test)]
    return faults


def exists(test: str) -> bool:
    """Return whether a test named as `folder/test_file.py::test_name` exists."""
    file, _, name = test.partition("::")
    path = TESTS / file
    if not path.is_file() or not name.startswith("test_"):
        return False
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_check_has_a_row_and_a_test_that_exists() -> None:
    assert faults_of_table(PAGE.read_text(encoding="utf-8")) == []


def test_a_lost_row_a_strange_row_and_a_lost_test_are_found() -> None:
    text = PAGE.read_text(encoding="utf-8")
    row = re.search(r"^\| `tilt_max_rad` .*\n", text, flags=re.MULTILINE)
    assert row is not None
    lost = text.replace(row[0], "")
    assert faults_of_table(lost) == ["carry: no row of tilt_max_rad"]
    strange = text.replace("| `tilt_max_rad` |", "| `tilt` |", 1)
    assert faults_of_table(strange) == ["carry: no row of tilt_max_rad", "carry: no check tilt"]
    assert faults_of_table(text.replace(row[0], 2 * row[0])) == ["carry: tilt_max_rad twice"]
    renamed = text.replace("test_a_cap_on_the_lens", "test_no_cap")
    assert faults_of_table(renamed) == [
        "env-check: no test stages/env_check/test_faults.py::test_no_cap",
    ]
    unlimited = text.replace("`success_low`, `goal_error_max_m`", "`goal_error_max_m`")
    assert faults_of_table(unlimited) == ["carry: success_low has no limit, or a limit"]
