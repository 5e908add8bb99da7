"""A stage: a function from `StageContext` to `StageResult`.

It writes only in `context.folder`, derives randomness from `context.seed` and returns at least one check with a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.errors import GateClosedError
from minidual.gate.check import Check
from minidual.gate.progress import Progress

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.gate.verdict import Verdict, Waiver


class Folders(dict[str, Path]):
    """{upstream stage: its folder}; GateClosedError for a stage without result, which no waiver replaces."""

    def __missing__(self, stage: str) -> Path:
        raise GateClosedError(f"it works on the result of {stage}, and there is none", remedy=f"minidual {stage}")


@dataclass(frozen=True)
class StageContext:
    """Input of a stage; `workers` and `view` must not affect results.

    Attributes:
        folder: Temporary.
        upstream: {upstream stage: its folder}.
        code_changes: {upstream stage: modules changed since}; closing stages only.
        waivers: Own and inherited.
    """

    folder: Path
    config: Config
    seed: int
    profile: str
    upstream: Mapping[str, Path] = field(default_factory=dict[str, Path])
    verdicts: Mapping[str, Verdict] = field(default_factory=lambda: dict[str, "Verdict"]())
    summaries: Mapping[str, str] = field(default_factory=dict[str, str])
    code_changes: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    waivers: tuple[Waiver, ...] = ()
    progress: Progress = field(default_factory=Progress)
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    workers: int = 1
    view: Any = None


@dataclass(frozen=True)
class StageResult:
    """Result of a stage.

    Attributes:
        checks: Unique names; at least one limit.
        data: JSON types, under about 100 kB.
    """

    checks: Sequence[Check]
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()


def closing_checks(waivers: Sequence[Waiver], code_changes: Mapping[str, Sequence[str]]) -> list[Check]:
    """Return the checks of a closing stage; `code_changes` is {upstream stage: modules changed since}."""
    waived, stages = ", ".join(waiver.stage for waiver in waivers), ", ".join(code_changes)
    modules = ", ".join(sorted({module for names in code_changes.values() for module in names})[:3])
    rerun = f"run {stages} again with --force ({modules} changed)"
    rows = (
        ("gate.waivers", waivers, "evidence behind a waived gate", f"run {waived} without --waive-gate"),
        ("gate.code_changed", code_changes, "results of other code", rerun),
    )
    return [
        Check(name, len(found), "==", 0, why=f"{what} is no acceptance", remedy=mend if found else "")
        for name, found, what, mend in rows
    ]


StageFunction = Callable[[StageContext], StageResult]
