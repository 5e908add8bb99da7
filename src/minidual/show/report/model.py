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
from minidual.show.report.wording import CHECK_WORDS, commit, moment
from minidual.show.report.words import Words


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
        headlines: At most five sentences on what the benchmark shows.
    """

    context: StageContext
    tables: Mapping[str, Tables]
    figures: Mapping[str, Sequence[Figure]]
    media: Sequence[Medium]
    bench: BenchRecord | None = None
    headlines: Sequence[str] = ()

    @cached_property
    def words(self) -> Words:
        """Words of the page's language."""
        return Words(self.context.config.report.language)

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
    def _failed(self) -> list[str]:
        """The failed checks of the report, one line each."""
        words = self.words
        failed = [check for check in self.checks if check.passed is False]
        return [
            words("banner.check", check=words.check(check), why=words.foreign(check.why))
            for check in failed
        ]

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

        words = self.words
        waivers_n = len(context.waivers)
        yield Banner(
            "tainted",
            words("banner.tainted_one" if waivers_n == 1 else "banner.tainted", n=waivers_n),
            [self._waiver_line(waiver) for waiver in context.waivers],
        )
        yield Banner("fail", words("banner.fail"), self._failed)
        yield Banner(
            "fail",
            words("banner.code"),
            [f"{stage}: {shortened(names)}" for stage, names in context.code_changes.items()],
        )
        yield Banner(
            "smoke",
            words("banner.smoke", profile=context.profile),
            [] if self.accepts else [words("banner.wiring_only")],
        )
        yield Banner(
            "smoke",
            words("banner.weakened", profile=context.profile),
            [words.foreign(line) for line in self.weakened],
        )
        yield Banner(
            "note",
            words("banner.overrides", profile=context.profile),
            sorted({override for verdict in verdicts for override in verdict.overrides}),
        )
        commits = sorted({commit(verdict.fingerprint.commit) for verdict in verdicts})
        yield Banner(
            "note",
            words("banner.commits", n=len(commits)),
            commits if len(commits) > 1 else [],
        )

    def _waiver_line(self, waiver: Waiver) -> str:
        words = self.words
        blocking = [
            words("banner.was", stage=stage, state=state)
            for stage, state in waiver.blocking.items()
        ]
        return words(
            "banner.waiver",
            stage=waiver.stage,
            at=moment(waiver.at),
            reason=waiver.reason,
            blocking=words("comma").join(blocking),
        )
