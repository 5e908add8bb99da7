"""Numbers that pages quote from the results: they must stand there.

The results are the pages docs/results*.md. A page quotes them by a block of the same name, or by a
link whose text holds the number, such as `[8 of 100](results.md#policies)`: it must stand in that
section of that page. A page of results quotes its own sections by `(#policies)`. A count such as
`8 of 100` that is no link must stand in one of the pages.
"""

import re
from collections.abc import Mapping

from scripts.results.blocks import blocks

type Published = Mapping[str, str]
"""{name of a page of results: its text}."""

_LINK = re.compile(
    r"\[(?P<text>[^\]]+)\]\((?:[\w./-]*/)?(?P<page>results[\w-]*\.md)(?:#(?P<anchor>[\w-]+))?\)",
)
_OWN_LINK = re.compile(r"\[(?P<text>[^\]]+)\]\(#(?P<anchor>[\w-]+)\)")
_NUMBER = re.compile(
    r"\d[\d.,]*(?:\s+of\s+\d[\d.,]*)?(?:\s%)?(?<![.,])(?:\s\([\d.]+-[\d.]+\s%\))?",
)
_COUNT = re.compile(r"(?<![\d.,])\d[\d,]*\s+of\s+\d[\d,]*(?![\d,]*\.\d)")
_CODE = re.compile(r"(?ms)^```.*?^```$|^ {4}.*?$")
_SECTION = re.compile(r"^## +(?P<title>.+)$", re.MULTILINE)
_LEAST_TRIALS = 20
"""A count of fewer is no measured rate."""


def stale_quotes(page: str, published: Published) -> list[str]:
    """Return what a page quotes and the results do not say."""
    return [
        *_other_blocks(page, published),
        *_stale_links(page, published),
        *_stale_counts(page, published),
    ]


def _other_blocks(page: str, published: Published) -> list[str]:
    of_results: dict[str, str] = {}
    for text in published.values():
        of_results |= blocks(text)
    quoted = blocks(page).items()
    return [f"block '{name}'" for name, content in quoted if of_results.get(name) != content]


def _stale_links(page: str, published: Published) -> list[str]:
    stale: list[str] = []
    for match in _LINK.finditer(page):
        source = published.get(match["page"], "")
        stale += _missing_numbers(match["text"], source, match["anchor"])
    if page in published.values():
        for match in _OWN_LINK.finditer(page):
            stale += _missing_numbers(match["text"], page, match["anchor"])
    return stale


def _missing_numbers(text: str, source: str, anchor: str | None) -> list[str]:
    """Return the numbers of a link's text that its section, or its page, does not have."""
    section = _section(source, anchor) if anchor else source
    numbers = [number for number in _NUMBER.findall(text) if not _stands_in(number, section)]
    return [f"{_one_line(number)} (section {anchor or 'any'})" for number in numbers]


def _stale_counts(page: str, published: Published) -> list[str]:
    prose = _LINK.sub("", _CODE.sub("", page))
    counts = [_one_line(count) for count in _COUNT.findall(prose)]
    rates = [count for count in counts if _trials(count) >= _LEAST_TRIALS]
    texts = published.values()
    return [count for count in rates if not any(_stands_in(count, text) for text in texts)]


def _trials(count: str) -> int:
    return int(count.rpartition(" ")[2].replace(",", ""))


def _section(page: str, anchor: str) -> str:
    """Return a section of second level by the name of its link; nothing if there is none."""
    for heading in _SECTION.finditer(page):
        if heading["title"].strip().lower().replace(" ", "-") == anchor:
            following = _SECTION.search(page, heading.end())
            end = following.start() if following else len(page)
            return page[heading.start() : end]
    return ""


def _stands_in(number: str, text: str) -> bool:
    words = r"\s+".join(re.escape(word) for word in number.split())
    return re.search(rf"(?<![\d.,]){words}(?![\d]|[.,]\d)", text) is not None


def _one_line(text: str) -> str:
    return " ".join(text.split())
