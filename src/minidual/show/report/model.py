"""Content of the report: its tables, checks, state and warnings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from minidual.errors import shortened
from minidual.gate.check import Check, Rows, checks_of
from minidual.gate.stage import StageContext, closing_checks
from minidual.gate.verdict import Verdict, Waiver, derive_status
from minidual.show.report.analysis import Analysis, analyse
from minidual.show.report.bench import BenchRecord
from minidual.show.report.figures import Figure
from minidual.show.report.media import Medium
from minidual.show.report.tables import Tables
from minidual.show.report.wording import CHECK_WORDS, commit, joined, moment

_WIRING_ONLY = (
    "Few trials and little training show that the parts fit together. The rates prove nothing else."
)


class Banner(NamedTuple):
    """A warning at the top of the page.

    Attributes:
        kind: "tainted", "fail", "smoke" or "note".
        title: One sentence.
        lines: Details, one a line.
    """

    kind: str
    title: str
    lines: Sequence[str]


@dataclass(frozen=True)
class Report:
    """Content of the page.

    Attributes:
        context: Input of the report's stage.
        tables: By task.
        figures: By task.
        media: Pictures and films of the stages.
        bench: Record of `make bench` that lies in the run; None without one.
    """

    context: StageContext
    tables: Mapping[str, Tables]
    figures: Mapping[str, Sequence[Figure]]
    media: Sequence[Medium]
    bench: BenchRecord | None = None

    @cached_property
    def analysis(self) -> Analysis:
        """Conclusions over all stages."""
        return analyse(self.context.verdicts)

    @property
    def not_passing(self) -> list[str]:
        """The preceding stages without a passing, fresh verdict."""
        return [stage for stage in self.context.summaries if not self._passes(stage)]

    def _passes(self, stage: str) -> bool:
        verdict = self.context.verdicts.get(stage)
        if verdict is None:
            return False
        state = self.context.states.get(stage, verdict.status)
        return state == verdict.status == "pass"

    @property
    def checks(self) -> list[Check]:
        """The report's own checks: complete tables of every task, passing stages."""
        holes = [
            f"{task}.{hole}" for task, tables in self.tables.items() for hole in tables.missing()
        ]
        stages = self.not_passing
        rows: Rows = {
            "missing_cells": (len(holes), "==", 0),
            "stages_not_passing": (len(stages), "==", 0),
        }
        missing = f"; missing: {shortened(holes)}" if holes else ""
        without = f"; without one: {', '.join(stages)}" if stages else ""
        return checks_of(CHECK_WORDS, rows, missing=missing, without=without)

    @property
    def shown_checks(self) -> list[Check]:
        """The report's own checks, and the failed ones for waivers and code changes."""
        closing = closing_checks(self.context.waivers, self.context.code_changes)
        failed = [check for check in closing if not check.passed]
        return [*self.checks, *failed]

    @property
    def accepts(self) -> bool:
        """Whether the profiles of all verdicts count as acceptance."""
        verdicts = self.context.verdicts.values()
        return self.context.config.acceptance and all(
            verdict.acceptance_profile for verdict in verdicts
        )

    @property
    def weakened(self) -> list[str]:
        """Counts and limits that are less demanding than the shipped profile's."""
        lines = (line for verdict in self.context.verdicts.values() for line in verdict.weakened)
        return list(dict.fromkeys(lines))

    @property
    def newest(self) -> Verdict | None:
        """The verdict that was finished last."""
        return max(
            self.context.verdicts.values(),
            key=lambda verdict: verdict.finished_at,
            default=None,
        )

    @property
    def total_s(self) -> float:
        """Wall time of all stages."""
        return sum(verdict.duration_s for verdict in self.context.verdicts.values())

    @property
    def state(self) -> Literal["pass", "fail", "weakened", "smoke", "tainted"]:
        """The gravest state that applies."""
        if self.context.waivers:
            return "tainted"
        if derive_status(self.checks) != "pass" or self.context.code_changes:
            return "fail"
        if not self.accepts:
            return "smoke"
        if self.weakened:
            return "weakened"
        return "pass"

    @property
    def banners(self) -> list[Banner]:
        """The warnings, gravest first."""
        return [banner for banner in self._possible_banners() if banner.lines]

    def _possible_banners(self) -> Iterator[Banner]:
        """Yield every warning; one without lines does not apply."""
        context = self.context
        verdicts = context.verdicts.values()

        gates = "1 gate" if len(context.waivers) == 1 else f"{len(context.waivers)} gates"
        yield Banner(
            "tainted",
            f"Tainted: {gates} opened by hand. This report cannot pass.",
            [_waiver_line(waiver) for waiver in context.waivers],
        )
        yield Banner(
            "fail",
            "This report does not pass",
            [f"{check.sentence()}: {check.why}" for check in self.checks if check.passed is False],
        )
        yield Banner(
            "fail",
            "Results of other code: this report cannot pass",
            [f"{stage}: {shortened(names)}" for stage, names in context.code_changes.items()],
        )
        yield Banner(
            "smoke",
            f"{context.profile}: wiring only, not acceptance",
            [] if self.accepts else [_WIRING_ONLY],
        )
        yield Banner(
            "smoke",
            f"Less was asked than the {context.profile} profile asks: not acceptance",
            self.weakened,
        )
        yield Banner(
            "note",
            f"Values of the {context.profile} profile were overridden",
            sorted({override for verdict in verdicts for override in verdict.overrides}),
        )
        commits = sorted({commit(verdict.fingerprint.commit) for verdict in verdicts})
        yield Banner(
            "note",
            f"The stages were run at {len(commits)} commits",
            commits if len(commits) > 1 else [],
        )


def _waiver_line(waiver: Waiver) -> str:
    blocking = joined([f"{stage} was {state}" for stage, state in waiver.blocking.items()])
    return f"gate of {waiver.stage}, {moment(waiver.at)}: “{waiver.reason}” ({blocking})"
