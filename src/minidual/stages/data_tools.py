"""`minidual data ...`: look at, check, join and divide demonstrations of any origin."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from minidual.demos.data.check import Finding, check_data
from minidual.demos.data.places import open_data
from minidual.demos.data.rearrange import drawn_parts, merge, parsed_shares, split
from minidual.demos.data.source import DataSource
from minidual.demos.data.stats import data_stats, entry_rows, stats_lines
from minidual.durable import expanded, write_csv
from minidual.errors import DataError, ExitCode, UsageError
from minidual.gate.stage import ToolResult, aligned
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot
from minidual.show.episodes.page import write_page
from minidual.show.episodes.rerun_file import write_rerun
from minidual.stages.output_file import target_file

_SHOWN = 5
"""Episodes on a page, if none are named."""
_LISTED = 40
"""Faults that a terminal lists."""


def check(text: str, robot: Robot) -> ToolResult:
    """Name every fault of the demonstrations at a path; they exit with 1 if there is any.

    Raises:
        UsageError: There are none.
    """
    try:
        source = open_data(text, robot)
        findings = check_data(source)
    except DataError as error:
        lines = [f"dataset_unreadable: {error.message}"]
        if error.remedy:
            lines.append(f"  remedy: {error.remedy}")
        data: dict[str, Any] = {"faults": [{"name": "dataset_unreadable", "detail": error.message}]}
        return ToolResult(lines, data=data, exit_code=ExitCode.ACCEPTANCE_FAILED)
    faulty = len({finding.episode for finding in findings})
    lines = [f"{source.kind}: {len(source)} episodes, {faulty} with faults"]
    counts = Counter(finding.fault.name for finding in findings)
    lines += [f"  {name}: {count}" for name, count in counts.most_common()]
    for finding in findings[:_LISTED]:
        lines.append(f"{finding.episode}: {finding.fault.name}: {finding.fault.detail}")
    if len(findings) > _LISTED:
        lines.append(f"... and {len(findings) - _LISTED} more (--json lists all)")
    remedies = {finding.fault.name: finding.fault.remedy for finding in findings}
    lines += [f"remedy of {name}: {remedy}" for name, remedy in remedies.items()]
    return ToolResult(
        lines,
        data={
            "kind": source.kind,
            "episodes": len(source),
            "faults": [_record(finding) for finding in findings],
        },
        exit_code=ExitCode.ACCEPTANCE_FAILED if findings else ExitCode.PASS,
    )


def stats(text: str, robot: Robot, csv: str | None) -> ToolResult:
    """Say what the demonstrations at a path hold; `csv` takes a row for each episode."""
    table = target_file("csv", csv, ".csv")
    totals, rows = data_stats(open_data(text, robot), Kinematics(robot))
    lines = [*stats_lines(totals), "", *aligned(entry_rows(totals))]
    if table is not None:
        write_csv(table, rows)
        lines.append(f"episodes: {table}")
    document = totals._asdict()
    document["entries"] = [
        {key: _plain(value) for key, value in entry._asdict().items()} for entry in totals.entries
    ]
    return ToolResult(lines, data={**document, "episodes": rows})


def merge_data(texts: Sequence[str], out: str, robot: Robot) -> ToolResult:
    """Join the demonstrations at several paths."""
    folder = expanded(out)
    sources = [open_data(text, robot) for text in texts]
    count = merge(sources, folder, robot)
    return ToolResult(
        [f"{count} episodes are in {folder}", f"train on them: {_train(folder)}"],
        data={"folder": str(folder), "episodes": count},
    )


def split_data(text: str, parts: str, out: str, robot: Robot, seed: int) -> ToolResult:
    """Divide the demonstrations at a path into parts."""
    folder = expanded(out)
    shares = parsed_shares(parts)
    source = open_data(text, robot)
    drawn = drawn_parts(shares, len(source), seed)
    split(source, drawn, folder, robot)
    lines = [
        f"{name}: {len(numbers)} episodes in {folder / name}" for name, numbers in drawn.items()
    ]
    return ToolResult(lines, data={"folder": str(folder), "parts": drawn})


def show(
    text: str,
    robot: Robot,
    out: str | None,
    rrd: str | None,
    episodes: str | None,
) -> ToolResult:
    """Write a page of the demonstrations at a path, and a recording for rerun if it is named."""
    page = target_file("out", out or "demonstrations.html", ".html")
    recording = target_file("rrd", rrd, ".rrd")
    source = open_data(text, robot)
    findings = check_data(source)
    totals, _ = data_stats(source, Kinematics(robot))
    numbers = _numbers(episodes, source)
    written: list[Path] = []
    if recording is not None:
        write_rerun(source, numbers, recording)
        written.append(recording)
    if page is not None and (out is not None or recording is None):
        write_page(source, numbers, findings, stats_lines(totals), page)
        written.append(page)
    lines = [f"written: {path}" for path in written]
    if len(numbers) < len(source):
        lines.append(f"{len(numbers)} of {len(source)} episodes; --episodes 0-9 chooses others")
    return ToolResult(
        lines,
        data={"files": [str(path) for path in written], "faults": len(findings)},
    )


def parsed_numbers(text: str) -> list[int]:
    """Return the numbers of "0,3,7-9"; UsageError for another form."""
    numbers: list[int] = []
    for word in text.split(","):
        first, dash, last = word.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise UsageError(f"--episodes {text}: type numbers and ranges, such as 0,3,7-9")
        numbers += range(int(first), int(last or first) + 1)
    return numbers


def _numbers(text: str | None, source: DataSource) -> list[int]:
    if text is None:
        return list(range(min(_SHOWN, len(source))))
    numbers = parsed_numbers(text)
    beyond = [number for number in numbers if number >= len(source)]
    if beyond or not numbers:
        raise UsageError(f"--episodes {text}: there are episodes 0 to {len(source) - 1}")
    return numbers


def _record(finding: Finding) -> dict[str, str]:
    return {
        "episode": finding.episode,
        "name": finding.fault.name,
        "detail": finding.fault.detail,
        "remedy": finding.fault.remedy,
    }


def _plain(value: object) -> object:
    """Return a value that JSON has; NaN is None."""
    if isinstance(value, float) and math.isnan(value):
        return None
    return value


def _train(folder: Path) -> str:
    return f"minidual train-act --dataset {folder}"
