"""Content of the report: its checks, state, warnings, media and analysis."""

import base64
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple

from minidual.errors import DataError, shortened
from minidual.gate.check import Check, Rows, checks_of
from minidual.gate.stage import StageContext, closing_checks
from minidual.gate.verdict import Verdict, derive_status
from minidual.show.report.figures import Figure
from minidual.show.report.tables import Tables, finite
from minidual.show.report.wording import WORDS, commit, joined, moment

_THINNEST = 5
_KINDS = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".mp4": "video/mp4"}
EMBED_BYTES = 1_500_000


class Banner(NamedTuple):
    """A warning; kind "tainted", "smoke", "fail" or "note"."""

    kind: str
    title: str
    lines: Sequence[str]


def gather(verdicts: Mapping[str, Verdict]) -> dict[str, Any]:
    """Return the analysis.

    `gap`: success of the policy on held-out starts, with 95 % interval, and on training starts, or None. `sets`: the
    summary of each set of its trials, by condition; "held_out" is undisturbed. `margins`:
    stage, check and share of its limit, thinnest first. `at_best_n`: number of passed checks at their best value.
    """
    ranked = list[dict[str, Any]]()
    at_best = 0
    for stage, check in [
        (stage, check) for stage, verdict in verdicts.items() for check in verdict.checks
    ]:
        relative = check.relative_margin
        if relative is not None and relative >= 0.0 and _at_its_best(check):
            at_best += 1
        elif relative is not None:
            ranked.append({"stage": stage, "check": check, "share_of_limit": relative})
    thinnest = sorted(ranked, key=lambda margin: margin["share_of_limit"])[:_THINNEST]
    deploy = verdicts.get("deploy")
    data = {} if deploy is None else {"held_out": deploy.data, **deploy.data}
    sets = {
        name: row for name, row in data.items() if isinstance(row, Mapping) and "successes_n" in row
    }
    return {"gap": _gap(deploy), "sets": sets, "margins": thinnest, "at_best_n": at_best}


def _gap(deploy: Verdict | None) -> dict[str, float] | None:
    known = (
        {}
        if deploy is None
        else {**deploy.data, **{check.name: check.observed for check in deploy.checks}}
    )
    names = ("success_rate", "success_low", "success_high", "training_success_rate")
    found = [number for name in names if (number := finite(known.get(name))) is not None]
    return (
        dict(zip(("held_out", "low", "high", "training"), found, strict=True))
        if len(found) == len(names)
        else None
    )


def _at_its_best(check: Check) -> bool:
    share = not check.unit and check.limit is not None and 0.0 < check.limit <= 1.0
    return check.margin == 0.0 or (share and check.op in (">", ">=") and check.observed == 1.0)


class Medium(NamedTuple):
    """A picture or film.

    Attributes:
        source: Data URI, or path relative to the page.
    """

    stage: str
    name: str
    caption: str
    source: str
    film: bool = False


def collect_media(verdict: Verdict, folder: Path, page_folder: Path) -> list[Medium]:
    """Return the pictures and films in a stage's folder, without subfolders; copy large ones into `page_folder`/media.

    Raises:
        DataError: A file is missing.
    """
    media: list[Medium] = []
    stage = verdict.stage
    captions = WORDS["captions"].get(verdict.stage, {}) | verdict.data.get("captions", {})
    for name in sorted(
        name for name in verdict.artefacts if Path(name).suffix in _KINDS and "/" not in name
    ):
        path = folder / name
        if not path.is_file():
            raise DataError(f"artefact {name} of stage {stage} is gone: {path}")
        if path.stat().st_size <= EMBED_BYTES:
            source = f"data:{_KINDS[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
        else:
            source = f"media/{stage}-{name}"
            (page_folder / "media").mkdir(exist_ok=True)
            shutil.copyfile(path, page_folder / source)
        caption = captions.get(name) or path.stem.replace("_", " ").capitalize()
        media.append(Medium(stage, name, caption, source, path.suffix == ".mp4"))
    return media


@dataclass(frozen=True)
class Report:
    """Content of the page, by task; `given` is the stage's input."""

    given: StageContext
    tables: Mapping[str, Tables]
    figures: Mapping[str, Sequence[Figure]]
    media: Sequence[Medium]

    @cached_property
    def facts(self) -> dict[str, Any]:
        """The analysis; see `gather`."""
        return gather(self.given.verdicts)

    @property
    def not_passing(self) -> list[str]:
        """The preceding stages without a passing verdict."""
        verdicts = self.given.verdicts
        return [
            name
            for name in self.given.summaries
            if name not in verdicts or verdicts[name].status != "pass"
        ]

    @property
    def checks(self) -> list[Check]:
        """The report's own checks: complete tables of every task, passing stages."""
        short = self.not_passing
        holes = [
            f"{task}.{hole}" for task, table in self.tables.items() for hole in table.missing()
        ]
        rows: Rows = {
            "missing_cells": (len(holes), "==", 0),
            "stages_not_passing": (len(short), "==", 0),
        }
        missing = f"; missing: {shortened(holes)}" if holes else ""
        without = f"; without one: {', '.join(short)}" if short else ""
        return checks_of(WORDS["checks"], rows, missing=missing, without=without)

    @property
    def shown_checks(self) -> list[Check]:
        """The report's own checks, and failed ones for waivers and code changes."""
        closing = closing_checks(self.given.waivers, self.given.code_changes)
        return [*self.checks, *(check for check in closing if not check.passed)]

    @property
    def accepts(self) -> bool:
        """Whether all profiles count as acceptance."""
        return self.given.config.acceptance and all(
            v.acceptance_profile for v in self.given.verdicts.values()
        )

    @property
    def weakened(self) -> list[str]:
        """Counts and limits less demanding than the shipped profile's."""
        return list(
            dict.fromkeys(
                line for verdict in self.given.verdicts.values() for line in verdict.weakened
            ),
        )

    @property
    def newest(self) -> Verdict | None:
        """The last finished verdict."""
        return max(
            self.given.verdicts.values(),
            key=lambda verdict: verdict.finished_at,
            default=None,
        )

    @property
    def total_s(self) -> float:
        """Wall time of all stages."""
        return sum(verdict.duration_s for verdict in self.given.verdicts.values())

    @property
    def state(self) -> Literal["pass", "fail", "weakened", "smoke", "tainted"]:
        """The gravest state that applies."""
        if self.given.waivers:
            return "tainted"
        if derive_status(self.checks) != "pass" or self.given.code_changes:
            return "fail"
        return "smoke" if not self.accepts else "weakened" if self.weakened else "pass"

    @property
    def banners(self) -> list[Banner]:
        """The warnings, gravest first."""
        given = self.given
        waivers = self.given.waivers
        verdicts = given.verdicts.values()
        gates = f"{len(waivers)} gate{'s' if len(waivers) > 1 else ''}"
        blocked = [
            joined([f"{stage} was {state}" for stage, state in w.blocking.items()]) for w in waivers
        ]
        by_hand = zip(waivers, blocked, strict=True)
        opened = [
            f"gate of {w.stage}, {moment(w.at)}: “{w.reason}” ({states})" for w, states in by_hand
        ]
        failed = [
            f"{check.sentence()}: {check.why}" for check in self.checks if check.passed is False
        ]
        changed = [
            f"{stage}: {shortened(modules)}" for stage, modules in given.code_changes.items()
        ]
        wiring = "Few trials and little training show that the parts fit together. The rates prove nothing else."
        overrides = sorted({text for verdict in verdicts for text in verdict.overrides})
        commits = sorted({commit(verdict.fingerprint.commit) for verdict in verdicts})
        every = (
            Banner("tainted", f"Tainted: {gates} opened by hand. This report cannot pass.", opened),
            Banner("fail", "This report does not pass", failed),
            Banner("fail", "Results of other code: this report cannot pass", changed),
            Banner(
                "smoke",
                f"{given.profile}: wiring only, not acceptance",
                () if self.accepts else (wiring,),
            ),
            Banner(
                "smoke",
                f"Less was asked than the {given.profile} profile asks: not acceptance",
                self.weakened,
            ),
            Banner("note", f"Values of the {given.profile} profile were overridden", overrides),
            Banner(
                "note",
                f"The stages were run at {len(commits)} commits",
                commits if len(commits) > 1 else (),
            ),
        )
        return [banner for banner in every if banner.lines]
