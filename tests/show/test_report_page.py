"""The page as its reader gets it: states and banners, nothing from outside, the same bytes twice."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from minidual.errors import DataError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.gate.verdict import build_manifest
from minidual.plant.render import write_video
from minidual.show.report import media
from minidual.show.report.model import Report
from minidual.show.report.page import build_report
from tests.support import report_samples as samples
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)


def built(given: StageContext, root: Path) -> tuple[Report, str]:
    folder = root / "report"
    folder.mkdir()
    report = build_report(given, folder)
    return report, (folder / "report.html").read_text(encoding="utf-8")


class Page(HTMLParser):
    """Collects tags that are not closed, references, and the text before the first heading."""

    VOID = frozenset({"meta", "img", "br", "link", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.before_heading = ""
        self._heading_seen = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self._heading_seen |= tag == "h1"
        self.references += [
            value or "" for name, value in attrs if name in ("src", "href", "poster", "xlink:href")
        ]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.references += [
            value or "" for name, value in attrs if name in ("src", "href", "poster", "xlink:href")
        ]

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self._heading_seen and (not self.open or self.open[-1] not in ("style", "title")):
            self.before_heading += data


def test_the_page_names_the_network_and_stock_act_beside_it(tmp_path: Path) -> None:
    """`act` names the method; what was trained has a name of its own."""
    given = samples.make_run(tmp_path)
    _, page = built(given, tmp_path)
    assert '<th scope="col">act (keyframe_act)</th>' in page
    assert "and no image feature" in page
    assert "stock ACT, trained for an equal time on the same pictures, carried 8 of 100" in page
    trained = replace(given.verdicts["train-act"], data={"architecture": "nearest"})
    (tmp_path / "other").mkdir()
    other = replace(given, verdicts={**given.verdicts, "train-act": trained})
    _, page = built(other, tmp_path / "other")
    assert '<th scope="col">act (nearest)</th>' in page
    assert "stock ACT" not in page


def test_a_passing_run_passes(tmp_path: Path) -> None:
    report, page = built(samples.make_run(tmp_path), tmp_path)
    assert report.state == "pass"
    assert report.banners == []
    assert all(check.passed for check in report.checks)
    assert '<span class="pill pass">Pass</span>' in page
    for stage, _ in samples.STAGES:
        assert f'id="{stage}"' in page
    for check in (
        check for verdict in report.context.verdicts.values() for check in verdict.checks
    ):
        assert check.name in page


def test_the_page_is_well_formed_and_needs_nothing_from_outside(tmp_path: Path) -> None:
    _, text = built(samples.make_run(tmp_path), tmp_path)
    page = Page(text)
    assert page.open == []
    for reference in page.references:
        inside = (
            reference.startswith(("#", "data:"))
            or (tmp_path / "report" / reference.partition("#")[0]).is_file()
        )
        assert inside, reference[:80]
    assert re.findall(r"(?:@import|url\()\s*['\"]?(?:https?:|//)", text) == []
    assert "<script" not in text


def test_the_same_verdicts_give_the_same_bytes(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.undo()  # figures are drawn twice here
    given = samples.make_run(tmp_path)
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        build_report(given, tmp_path / name)
    files = sorted(
        p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file()
    )
    assert len(files) > 5
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), (
            file
        )


def test_a_waiver_taints_the_report_at_its_very_top(tmp_path: Path) -> None:
    given = replace(samples.make_run(tmp_path), waivers=(samples.WAIVER,))
    report, text = built(given, tmp_path)
    assert report.state == "tainted"
    before = Page(text).before_heading
    assert "This report cannot pass" in before
    assert samples.WAIVER.reason in before
    assert "plan was fail" in before
    assert json.loads((tmp_path / "report" / "report.json").read_text())["acceptance"] is False


def test_results_of_other_code_fail_the_report_at_its_very_top(tmp_path: Path) -> None:
    given = replace(samples.make_run(tmp_path), code_changes={"plan": ["minidual.motion.api"]})
    report, text = built(given, tmp_path)
    assert report.state == "fail"
    assert "plan: minidual.motion.api" in Page(text).before_heading
    assert "gate.code_changed" in text


@pytest.mark.parametrize("where", ["report", "verdict"])
def test_a_smoke_run_says_smoke_at_its_very_top(tmp_path: Path, where: str) -> None:
    given = replace(samples.make_run(tmp_path), profile="smoke")
    if where == "report":
        given = replace(given, config=given.config.model_copy(update={"acceptance": False}))
    else:
        plan = replace(given.verdicts["plan"], acceptance_profile=False)
        given = replace(given, verdicts={**given.verdicts, "plan": plan})
    report, text = built(given, tmp_path)
    assert report.state == "smoke"
    assert "smoke: wiring only, not acceptance" in Page(text).before_heading
    assert json.loads((tmp_path / "report" / "report.json").read_text())["acceptance"] is False


def test_a_weakened_limit_is_said_and_is_not_acceptance(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    plan = replace(given.verdicts["plan"], weakened=("plan.queries_n is 1, the profile asks 100",))
    report, text = built(replace(given, verdicts={**given.verdicts, "plan": plan}), tmp_path)
    assert report.state == "weakened"
    assert "plan.queries_n is 1" in Page(text).before_heading
    assert json.loads((tmp_path / "report" / "report.json").read_text())["acceptance"] is False


def test_a_missing_method_fails_the_report_and_shows_the_hole(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    table = dict(given.verdicts["benchmark"].data["tasks"][samples.TASK]["methods"])
    del table["act"]
    report, text = built(samples.with_methods(given, table), tmp_path)
    assert report.state == "fail"
    assert next(check for check in report.checks if check.name == "missing_cells").passed is False
    assert text.count('<span class="value">missing</span>') == 6
    assert "This report does not pass" in Page(text).before_heading


def test_a_failing_or_absent_stage_fails_the_report(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    bad = replace(
        given.verdicts["plan"],
        checks=(Check("both_arms.time_max_s", 12.0, "<", 10.0, "s"),),
    )
    rest = {name: verdict for name, verdict in given.verdicts.items() if name != "deploy"}
    report, text = built(replace(given, verdicts={**rest, "plan": bad}), tmp_path)
    assert report.state == "fail"
    (check,) = [check for check in report.checks if check.name == "stages_not_passing"]
    assert (check.passed, check.observed) == (False, 2)
    assert "plan, deploy" in check.why
    assert "This stage left no verdict" in text


def test_without_a_benchmark_there_is_still_a_page_that_fails(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    rest = {name: verdict for name, verdict in given.verdicts.items() if name != "benchmark"}
    report, _ = built(replace(given, verdicts=rest), tmp_path)
    assert report.state == "fail"


def test_overrides_and_mixed_commits_are_said(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    plan = given.verdicts["plan"]
    plan = replace(
        plan,
        overrides=("plan.queries_n=1",),
        fingerprint=replace(plan.fingerprint, commit="feed" * 10),
    )
    _, text = built(replace(given, verdicts={**given.verdicts, "plan": plan}), tmp_path)
    before = Page(text).before_heading
    assert "plan.queries_n=1" in before
    assert "2 commits" in before


def test_text_from_verdicts_is_escaped(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    title = given.config.report.model_copy(update={"title": "<script>alert(1)</script> & co"})
    given = replace(given, config=given.config.model_copy(update={"report": title}))
    _, text = built(given, tmp_path)
    assert "<script" not in text
    assert "&lt;script&gt;" in text


def with_artefact(given: StageContext, stage: str) -> StageContext:
    """Return the run with the manifest of `stage` taken anew."""
    verdict = replace(given.verdicts[stage], artefacts=build_manifest(given.upstream[stage]))
    return replace(given, verdicts={**given.verdicts, stage: verdict})


def picture(path: Path, size: tuple[int, int] = (48, 32)) -> None:
    from PIL import Image

    Image.fromarray(np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)).save(
        path,
    )


def test_pictures_and_films_of_the_stages_are_shown_and_data_is_not(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    carry = given.upstream["carry"]
    picture(carry / "median_trial.png")
    (carry / "dataset" / "videos").mkdir(parents=True)
    frames = [np.full((32, 48, 3), 20 * i, dtype=np.uint8) for i in range(10)]
    write_video(carry / "carry.mp4", frames, fps=10)
    write_video(carry / "dataset" / "videos" / "file-000.mp4", frames, fps=10)
    report, text = built(with_artefact(given, "carry"), tmp_path)
    assert [(medium.name, medium.film) for medium in report.media] == [
        ("carry.mp4", True),
        ("median_trial.png", False),
    ]
    assert "Median trial" in text
    assert 'src="data:video/mp4;base64,' in text


def test_a_large_film_is_copied_beside_the_page(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(media, "EMBED_BYTES", 10)
    given = samples.make_run(tmp_path)
    film = given.upstream["deploy"] / "success.mp4"
    write_video(film, [np.zeros((32, 48, 3), dtype=np.uint8)] * 4, fps=10)
    _, text = built(with_artefact(given, "deploy"), tmp_path)
    assert 'src="media/deploy-success.mp4#t=3"' in text
    assert (tmp_path / "report" / "media" / "deploy-success.mp4").read_bytes() == film.read_bytes()


def test_a_picture_that_is_gone_is_named(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    path = given.upstream["plan"] / "times.png"
    picture(path)
    given = with_artefact(given, "plan")
    path.unlink()
    with pytest.raises(DataError, match=r"times\.png of stage plan is gone"):
        built(given, tmp_path)


def test_every_figure_is_drawn_from_the_data_and_themed(tmp_path: Path) -> None:
    report, _ = built(samples.make_run(tmp_path), tmp_path)
    names = [figure.name for figure in report.figures[samples.TASK]]
    assert names == [
        "success",
        *(
            f"{n}"
            for n in (
                "duration_median_s",
                "torque_ratio_max",
                "jerk_rms_median",
                "tilt_max_rad",
                "path_length_m",
            )
        ),
    ]
    for figure in report.figures[samples.TASK]:
        assert "moveit" in figure.svg
        assert "#1a2027" in figure.svg
        assert "#1a2027" not in figure.themed
        assert "var(--ink)" in figure.themed
        assert (tmp_path / "report" / "figures" / f"{figure.name}.svg").is_file()


def test_the_json_says_what_the_page_says(tmp_path: Path) -> None:
    report, text = built(samples.make_run(tmp_path), tmp_path)
    document = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert document["state"] == report.state == "pass"
    assert [stage["name"] for stage in document["stages"]] == [name for name, _ in samples.STAGES]
    assert document["tasks"][samples.TASK]["comparison"]["methods"]["act"]["measures"][
        "success_rate"
    ]["value"] == pytest.approx(0.75)
    pair = document["tasks"][samples.TASK]["analysis"]["pairs"][0]
    assert (pair["first"], pair["second"], pair["trials_n"]) == ("moveit", "impedance", 20)
    assert "moveit against impedance" in text
    assert document["analysis"]["margins"][0]["check"] in text[text.index("Thinnest margins") :]
