"""Marked blocks of a Markdown page.

A block begins with the line `<!-- results: NAME -->` and ends with `<!-- /results -->`. What stands
between them is written by `make results`; a page quotes the results by a block of the same name.
"""

import re

from minidual.errors import DataError

_BLOCK = re.compile(
    r"(?P<begin><!-- results: (?P<name>[\w-]+) -->\n)(?P<body>.*?)(?P<end><!-- /results -->)",
    re.DOTALL,
)


def blocks(text: str) -> dict[str, str]:
    """Return {name: content} of a page.

    Raises:
        DataError: A name stands twice, or a mark has no other end.
    """
    found: dict[str, str] = {}
    for match in _BLOCK.finditer(text):
        if match["name"] in found:
            raise DataError(f"the block '{match['name']}' stands twice in one page")
        found[match["name"]] = match["body"].strip()
    marks_n = text.count("<!-- results: ") + text.count("<!-- /results -->")
    if marks_n != 2 * len(found):
        raise DataError("a mark of a block has no other end")
    return found


def with_blocks(text: str, contents: dict[str, str]) -> str:
    """Return the page with the named blocks filled; blocks without a content stay."""

    def filled(match: re.Match[str]) -> str:
        content = contents.get(match["name"])
        if content is None:
            return match[0]
        return f"{match['begin']}\n{content.strip()}\n\n{match['end']}"

    return _BLOCK.sub(filled, text)
