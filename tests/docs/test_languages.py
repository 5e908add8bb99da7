"""The Chinese pages follow the English ones: same sections, commands, numbers, names and links."""

from __future__ import annotations

import os
import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.documents import ROOT, code_lines, heading_anchors

PAIRS = {
    ROOT / "README.md": ROOT / "README.zh.md",
    **{ROOT / "docs" / page.name: page for page in sorted((ROOT / "docs" / "zh").glob("*.md"))},
}
"""{English page: its Chinese page}."""
TRANSLATED = {"README.md", "quickstart.md", "concepts.md", "can-i.md", "tutorial.md"}
NAMES_WITH_NUMBERS = re.compile(r"\b(?:ROS|MoveIt|WSL|RoboTwin) \d(?:\.\d)?")
NUMBER = re.compile(r"(?<![A-Za-z0-9_.])\d+(?:[.,]\d+)*")
LINK = re.compile(r"\]\(([^)\s]+)\)")


class Section(NamedTuple):
    """What must be the same in both languages.

    Attributes:
        level: Of the heading.
        numbers: {number: how often}, outside code and addresses.
        names: What stands in `code` marks.
        links: Pages and headings, as those of the English page.
        code: Shell lines without comments, and Python blocks.
    """

    level: int
    numbers: Counter[str]
    names: set[str]
    links: set[str]
    code: list[str]


def texts(page: str) -> list[str]:
    """Split a page before each heading; a comment in a code block is no heading."""
    starts: list[int] = []
    fenced = False
    offset = 0
    for line in page.splitlines(keepends=True):
        fenced ^= line.startswith("```")
        if not fenced and line.startswith("#"):
            starts.append(offset)
        offset += len(line)
    ends = [*starts[1:], len(page)]
    return [page[start:end] for start, end in zip(starts, ends, strict=True)]


def section(text: str, page: Path) -> Section:
    python = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^```\w*\n.*?^```$|^ {4}\S.*$", "", text, flags=re.MULTILINE | re.DOTALL)
    links = {english_target(target, page) for target in LINK.findall(prose)}
    prose = LINK.sub("]", prose)
    names = {" ".join(name.split()) for name in re.findall(r"`([^`]+)`", prose)}
    plain = NAMES_WITH_NUMBERS.sub("", re.sub(r"`[^`]+`", "", prose))
    return Section(
        level=len(text) - len(text.lstrip("#")),
        numbers=Counter(NUMBER.findall(plain)),
        names=names,
        links=links,
        code=code_lines(text) + python,
    )


def anchor_names(page: Path) -> list[str]:
    """Return the anchors of a page's headings, in order; headings of one page differ."""
    headings = [text.splitlines()[0] for text in texts(page.read_text(encoding="utf-8"))]
    return [heading_anchors(heading).pop() for heading in headings]


def english_target(target: str, page: Path) -> str:
    """Return what a link leads to, as path#heading of the English page."""
    if "://" in target:
        return target
    name, _, anchor = target.partition("#")
    path = Path(os.path.normpath(page.parent / name)) if name else page
    for english, chinese in PAIRS.items():
        if path == chinese:
            path = english
            if anchor:
                anchor = anchor_names(english)[anchor_names(chinese).index(anchor)]
    return f"{path.relative_to(ROOT).as_posix()}#{anchor}".removesuffix("#")


def differences(english: Path, chinese: Path) -> list[str]:
    """Return what differs between the two pages, section by section."""
    first = texts(english.read_text(encoding="utf-8"))
    second = texts(chinese.read_text(encoding="utf-8"))
    if len(first) != len(second):
        return [f"{len(first)} sections against {len(second)}"]
    found: list[str] = []
    for one, other in zip(first, second, strict=True):
        pair = zip(section(one, english), section(other, chinese), strict=True)
        for field, (value, translated) in zip(Section._fields, pair, strict=True):
            if value != translated:
                heading = one.splitlines()[0]
                found.append(f"{heading}: {field}: {value} against {translated}")
    return found


@pytest.mark.parametrize("english", PAIRS, ids=lambda page: page.name)
def test_both_languages_say_the_same(english: Path) -> None:
    assert differences(english, PAIRS[english]) == []


def test_the_pages_of_the_first_hour_are_translated() -> None:
    assert {page.name for page in PAIRS} == TRANSLATED
    assert all(page.is_file() for page in PAIRS)


@pytest.mark.parametrize("english", PAIRS, ids=lambda page: page.name)
def test_each_page_leads_to_the_other_language(english: Path) -> None:
    to_chinese = os.path.relpath(PAIRS[english], english.parent)
    to_english = os.path.relpath(english, PAIRS[english].parent)
    assert f"English | [中文]({to_chinese})" in english.read_text(encoding="utf-8")
    assert f"[English]({to_english}) | 中文" in PAIRS[english].read_text(encoding="utf-8")


ENGLISH = """# Start

It takes 5 minutes ([results](results.md#tasks)), see `demo`.

    minidual demo     # a film

## More

ROS 2 has 14 joints.
"""
CHINESE = """# 开始

需要 5 分钟（[结果](results.md#tasks)），见 `demo`。

    minidual demo     # 一段影片

## 更多

有 14 个关节。
"""


def compared(
    folder: Path, english: str, chinese: str, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    monkeypatch.setattr("tests.docs.test_languages.ROOT", folder)
    pages = (folder / "page.md", folder / "page.zh.md")
    for page, text in zip(pages, (english, chinese), strict=True):
        page.write_text(text, encoding="utf-8")
    return differences(*pages)


@pytest.mark.parametrize(
    ("text", "changed", "field"),
    [
        ("", "", ""),
        ("5 分钟", "6 分钟", "numbers"),
        ("minidual demo", "minidual try", "code"),
        ("#tasks", "#policies", "links"),
        ("`demo`", "`try`", "names"),
        ("## 更多", "### 更多", "level"),
        ("## 更多\n", "", "sections against"),
        ("14 个", "14 个、15 个", "numbers"),
    ],
)
def test_a_page_that_drifts_is_found(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    text: str,
    changed: str,
    field: str,
) -> None:
    found = compared(tmp_path, ENGLISH, CHINESE.replace(text, changed, 1), monkeypatch)
    assert len(found) == (1 if field else 0)
    assert all(field in each for each in found)
