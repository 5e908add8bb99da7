"""Content of the report: its input, checks, state and warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from minidual.gate.check import Check
from minidual.gate.verdict import Verdict, Waiver, derive_status
from minidual.show.report.facts import Facts
from minidual.show.report.figures import Figure
from minidual.show.report.media import Medium
from minidual.show.report.tables import Tables
from minidual.show.report.wording import commit, joined, moment, shortened
from minidual.trials.conditions import CLEAN

OverallState = Literal["pass", "fail", "weakened", "smoke", "tainted"]


@dataclass(frozen=True)
class ReportInput:
    """Everything the report is built from.

    Attributes:
        stages: (name, summary) of the preceding stages.
        methods: Required in the comparison.
        acceptance: Whether the profile counts as acceptance.
        conditions: Required in the table.
        code_changes: Changed modules by stage whose results other code made.
    """

    title: str
    stages: Sequence[tuple[str, str]]
    verdicts: Mapping[str, Verdict]
    folders: Mapping[str, Path]
    waivers: Sequence[Waiver]
    methods: Sequence[str]
    acceptance: bool
    profile: str
    seed: int
    conditions: Sequence[str] = (CLEAN,)
    code_changes: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])

    def all_waivers(self) -> tuple[Waiver, ...]:
        """Return the distinct waivers, including upstream."""
        found: list[Waiver] = []
        for waiver in (*self.waivers, *(w for v in self.verdicts.values() for w in v.waivers)):
            if waiver not in found:
                found.append(waiver)
        return tuple(found)

    def counts_as_acceptance(self) -> bool:
        """Return whether all profiles count as acceptance."""
        return self.acceptance and all(verdict.acceptance_profile for verdict in self.verdicts.values())

    def weakened(self) -> list[str]:
        """Return counts and limits below the shipped profile's."""
        return list(dict.fromkeys(line for verdict in self.verdicts.values() for line in verdict.weakened))

    def not_passing(self) -> list[str]:
        """Return the stages without a passing verdict."""
        return [name for name, _ in self.stages if name not in self.verdicts or self.verdicts[name].status != "pass"]

    @property
    def newest(self) -> Verdict | None:
        """The last finished verdict."""
        return max(self.verdicts.values(), key=lambda verdict: verdict.finished_at, default=None)


@dataclass(frozen=True)
class Banner:
    """A warning; kind "tainted", "smoke", "fail" or "note"."""

    kind: str
    title: str
    lines: Sequence[str] = ()


def report_checks(given: ReportInput, tables: Tables) -> list[Check]:
    """Return the report's checks: complete tables, passing stages."""
    holes, short = tables.missing(), given.not_passing()
    shown = f"; missing: {shortened(holes)}" if holes else ""
    return [
        Check(
            "missing_cells",
            len(holes),
            "==",
            0,
            why="every method has every indicator as a finite number with its interval, undisturbed and under every "
            f"condition that applies to it{shown}",
            remedy="run minidual benchmark again, with every method and condition that the tables should hold",
        ),
        Check(
            "stages_not_passing",
            len(short),
            "==",
            0,
            why="a report is built on passing verdicts" + (f"; without one: {', '.join(short)}" if short else ""),
            remedy="minidual status says what to run",
        ),
    ]


@dataclass(frozen=True)
class Report:
    """Content of the page."""

    given: ReportInput
    tables: Tables
    facts: Facts
    figures: Sequence[Figure]
    condition_figure: Figure | None
    media: Sequence[Medium]

    @property
    def checks(self) -> list[Check]:
        """The report's own checks."""
        return report_checks(self.given, self.tables)

    @property
    def shown_checks(self) -> list[Check]:
        """The report's own checks and those failed by waivers or code changes."""
        found = [
            ("gate.waivers", self.given.all_waivers(), "evidence behind a waived gate does not count as acceptance"),
            ("gate.code_changed", self.given.code_changes, "results of other code do not accept this code"),
        ]
        return [*self.checks, *(Check(name, len(bad), "==", 0, why=why) for name, bad, why in found if bad)]

    @property
    def total_s(self) -> float:
        """Wall time of all stages."""
        return sum(verdict.duration_s for verdict in self.given.verdicts.values())

    @property
    def state(self) -> OverallState:
        """The gravest state that applies."""
        given = self.given
        if given.all_waivers():
            return "tainted"
        if derive_status(self.checks) != "pass" or given.code_changes:
            return "fail"
        if not given.counts_as_acceptance():
            return "smoke"
        return "weakened" if given.weakened() else "pass"

    @property
    def banners(self) -> list[Banner]:
        """The warnings, gravest first."""
        given, found = self.given, list[Banner]()
        verdicts, waivers = given.verdicts.values(), given.all_waivers()
        if waivers:
            lines = [
                f"gate of {waiver.stage}, {moment(waiver.at)}: “{waiver.reason}” ("
                + joined([f"{stage} was {state}" for stage, state in waiver.blocking.items()])
                + ")"
                for waiver in waivers
            ]
            gates = f"{len(waivers)} gate{'s' if len(waivers) > 1 else ''}"
            found.append(Banner("tainted", f"Tainted: {gates} opened by hand. This report cannot pass.", lines))
        failed = [f"{check.sentence()}: {check.why}" for check in self.checks if check.passed is False]
        if failed:
            found.append(Banner("fail", "This report does not pass", failed))
        if given.code_changes:
            lines = [f"{stage}: {shortened(modules)}" for stage, modules in given.code_changes.items()]
            found.append(Banner("fail", "Results of other code: this report cannot pass", lines))
        if not given.counts_as_acceptance():
            meaning = (
                "Few trials and little training show that the parts fit together. The rates below prove nothing else."
            )
            found.append(Banner("smoke", f"{given.profile}: wiring only, not acceptance", [meaning]))
        if given.weakened():
            title = f"Less was asked than the {given.profile} profile asks: not acceptance"
            found.append(Banner("smoke", title, given.weakened()))
        overrides = sorted({text for verdict in verdicts for text in verdict.overrides})
        if overrides:
            found.append(Banner("note", f"Values of the {given.profile} profile were overridden", overrides))
        commits = sorted({commit(verdict.fingerprint.commit) for verdict in verdicts})
        if len(commits) > 1:
            found.append(Banner("note", f"The stages were run at {len(commits)} commits", commits))
        return found
