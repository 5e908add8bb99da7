"""The page in each language: the same words, the same structure, nothing left in English."""

from __future__ import annotations

import re
import string
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from minidual.config.root import Config
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.show.report.indicators import INDICATORS
from minidual.show.report.page import build_report
from minidual.show.report.words import TEXTS, Words, zh_names
from minidual.stages.registry import STAGES
from minidual.tasks.failures import FAILURES
from minidual.trials.compared import NAMED
from minidual.trials.conditions import CONDITIONS
from minidual.trials.measures import MEASURES
from minidual.trials.methods import METHODS
from tests.support import report_samples as samples
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)

TEMPLATES = Path(__file__).parents[2] / "src" / "minidual" / "show" / "report" / "templates"


def fields(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name}


def test_every_key_stands_in_every_language_with_the_same_fields() -> None:
    english = TEXTS["en"]
    for language, texts in TEXTS.items():
        assert texts.keys() == english.keys(), language
        for key, text in texts.items():
            assert fields(text) == fields(english[key]), key
            assert text, key


def test_every_key_that_the_templates_name_exists() -> None:
    named: set[str] = set()
    for file in TEMPLATES.glob("*.j2"):
        named |= set(re.findall(r'\bt\("([a-z_.]+)"[,)]', file.read_text(encoding="utf-8")))
    assert len(named) > 60
    assert named <= TEXTS["en"].keys()


def test_no_template_has_words_of_its_own() -> None:
    """Between tags and outside of expressions there is punctuation only."""
    for file in TEMPLATES.glob("*.j2"):
        text = re.sub(r"\{[%{].*?[%}]\}|<[^>]*>", " ", file.read_text(encoding="utf-8"))
        words = set(re.findall(r"[A-Za-z]{3,}", text))
        assert words <= {"minidual", "report", "commit", "goal", "most", "doctype", "html"}, (
            file.name
        )


def test_everything_that_verdicts_name_has_a_chinese_name() -> None:
    names = zh_names.NAMES
    assert set(CONDITIONS) <= set(names.conditions)
    own = {
        name for name in METHODS if METHODS[name] is not NAMED
    }  # a user's policy has its own name
    assert own <= set(names.methods)
    assert {entry.name for entry in STAGES.values()} <= set(names.stages)
    assert FAILURES.keys() == names.failures.keys()
    assert MEASURES.keys() == names.measures.keys()
    assert {indicator.key for indicator in INDICATORS} == names.indicators.keys()


def chinese(given: StageContext) -> StageContext:
    report = given.config.report.model_copy(
        update={"language": "zh", "title": Config().report.title},
    )
    return replace(given, config=given.config.model_copy(update={"report": report}))


def built(given: StageContext, root: Path) -> str:
    folder = root / "page"
    folder.mkdir()
    build_report(given, folder)
    return (folder / "report.html").read_text(encoding="utf-8")


def english_phrases(page: str) -> Iterator[str]:
    """Yield runs of four English words in what a reader sees; text marked as English is left out."""
    body = page[page.index("<body") :]
    for pattern in (
        r"<style.*?</style>",
        r'<(span|div)[^>]* lang="en">.*?</\1>',
        r"<code.*?</code>",
        r'<dl class="made">.*?</dl>',
        r"<!--.*?-->",
    ):
        body = re.sub(pattern, " ", body, flags=re.DOTALL)
    attributes = " . ".join(re.findall(r'(?:title|aria-label|alt|data-label)="([^"]*)"', body))
    text = re.sub(r"<[^>]*>", " . ", body) + attributes
    yield from re.findall(r"[A-Za-z]{2,}(?:[ ]+[A-Za-z]{2,}){3,}", text)


def test_a_chinese_page_has_no_english_sentence_left(tmp_path: Path) -> None:
    page = built(chinese(samples.make_run(tmp_path, samples.disturbed_trials(20))), tmp_path)
    assert list(english_phrases(page)) == []
    assert '<html lang="zh-CN">' in page
    for word in ("双臂", "阻抗控制", "内力", "规划器", "成功率", "置信区间", "物体不在目标处"):
        assert word in page


def test_an_english_page_is_full_of_english_sentences(tmp_path: Path) -> None:
    page = built(samples.make_run(tmp_path, samples.disturbed_trials(20)), tmp_path)
    assert len(list(english_phrases(page))) > 50


def test_both_pages_have_one_structure(tmp_path: Path) -> None:
    shapes = []
    for language in ("en", "zh"):
        root = tmp_path / language
        given = samples.make_run(root, samples.disturbed_trials(20))
        page = built(chinese(given) if language == "zh" else given, root)
        shapes.append(re.findall(r'<(section|article|table)(?: id="([^"]*)")?', page))
    assert shapes[0] == shapes[1]
    assert len(shapes[0]) > 15


def test_what_failed_on_a_chinese_page_keeps_its_reason_marked_as_english(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    bad = Check(
        "both_arms.time_max_s", 12.0, "<", 10.0, "s", "a person waits no longer", "wait less"
    )
    plan = replace(given.verdicts["plan"], checks=(bad,))
    given = replace(given, verdicts={**given.verdicts, "plan": plan}, waivers=(samples.WAIVER,))
    page = built(chinese(given), tmp_path)
    assert '<span lang="en">a person waits no longer</span>' in page
    assert '<span lang="en">wait less</span>' in page
    assert "本报告未通过" in page
    assert samples.WAIVER.reason in page


def test_a_name_without_translation_is_marked_as_english() -> None:
    words = Words("zh")
    assert words.condition("wind", "a wind blows") == '<span lang="en">a wind blows</span>'
    assert words.failure("too_loud (lift)") == '<span lang="en">too loud</span>（阶段 lift）'
    assert words.reason("moveit reads no picture") == "moveit 不读取图像"
    assert words.reason("it rains") == '<span lang="en">it rains</span>'
    assert Words("en").reason("it rains") == "it rains"


@pytest.mark.parametrize(("name", "caption"), [("failures-sort.png", "失败的试验，每类取第一次")])
def test_captions_are_found_by_their_stem(name: str, caption: str) -> None:
    assert Words("zh").caption(name, "rod: failed trials") == caption
    assert "lang" in Words("zh").caption("own.png", "my own picture")


def test_an_unknown_language_is_refused() -> None:
    with pytest.raises(ValueError, match="language"):
        Config.model_validate({"report": {"language": "fr"}})
