"""Everything the report shows."""

from __future__ import annotations

from dataclasses import dataclass

from minidual.gate.check import Check
from minidual.show.report.facts import Facts
from minidual.show.report.figures import Figure
from minidual.show.report.media import Medium
from minidual.show.report.model import Banner, OverallState, ReportInput
from minidual.show.report.tables import Tables


@dataclass(frozen=True)
class Report:
    """Content of the page."""

    given: ReportInput
    state: OverallState
    banners: tuple[Banner, ...]
    checks: tuple[Check, ...]
    tables: Tables
    facts: Facts
    figures: tuple[Figure, ...]
    condition_figure: Figure | None
    media: tuple[Medium, ...]

    @property
    def passing_stages(self) -> int:
        """Number of passing stages."""
        return len(self.given.stages) - len(self.given.not_passing())

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
