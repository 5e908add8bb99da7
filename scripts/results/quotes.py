"""Numbers that pages quote from docs/results.md: they must stand there.

A page quotes by a block of the same name, or by a link whose text holds the number, such as
`[8 of 100](results.md#policies)`: it must stand in that section. docs/results.md itself quotes its
sections by `(#policies)`. A count such as `8 of 100` that is no link must stand somewhere there.
"""

import re

from scripts.results.blocks import blocks

_LINK = re.compile(
    r"\[(?P<text>[^\]]+)\]\((?:[\w./-]*/)?results\.md(?:#(?P<anchor>[\w-]+))?\)",
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


def stale_quotes(page: str, results: str) -> list[str]:
    """Return what a page quotes and docs/results.md does not say."""
    return [
        *_other_blocks(page, results),
        *_stale_links(page, results),
        *_stale_counts(page, results),
    ]


def _other_blocks(page: str, results: str) -> list[str]:
    own = blocks(results)
    return [f"block '{name}'" for name, content in blocks(page).items() if own.get(name) != content]


def _stale_links(page: str, results: str) -> list[str]:
    stale: list[str] = []
    link = _OWN_LINK if page == results else _LINK
    for match in link.finditer(page):
        anchor = match["anchor"]
        section = _section(results, anchor) if anchor else results
        for number in _NUMBER.findall(match["text"]):
            if not _stands_in(number, section):
                stale.append(f"{_one_line(number)} (section {anchor or 'any'})")
    return stale


def _stale_counts(page: str, results: str) -> list[str]:
    prose = _LINK.sub("", _CODE.sub("", page))
    counts = [_one_line(count) for count in _COUNT.findall(prose)]
    rates = [count for count in counts if _trials(count) >= _LEAST_TRIALS]
    return [count for count in rates if not _stands_in(count, results)]


def _trials(count: str) -> int:
    return int(count.rpartition(" ")[2].replace(",", ""))


def _section(results: str, anchor: str) -> str:
    """Return a section of second level by the name of its link; nothing if there is none."""
    headings = list(_SECTION.finditer(results))
    ends = [*(heading.start() for heading in headings[1:]), len(results)]
    for heading, end in zip(headings, ends, strict=True):
        if heading["title"].strip().lower().replace(" ", "-") == anchor:
            return results[heading.start() : end]
    return ""


def _stands_in(number: str, text: str) -> bool:
    words = r"\s+".join(re.escape(word) for word in number.split())
    return re.search(rf"(?<![\d.,]){words}(?![\d]|[.,]\d)", text) is not None


def _one_line(text: str) -> str:
    return " ".join(text.split())
