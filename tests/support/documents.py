"""The pages of README and docs: the commands that they print, their headings and words."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    {
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("*/README.md"),
    },
)
"""English pages; those in Chinese print the same commands (tests/docs/test_languages.py)."""


def code_lines(text: str) -> list[str]:
    """Return the lines of a page's shell blocks: continued ones joined, without comments and path.

    Other languages are left out; lines that are indented by four blanks count as shell.
    """
    text = re.sub(r" *\\\n *", " ", text)
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    fenced = [body for language, body in blocks if language in ("", "bash", "sh")]
    prose = re.sub(r"^```\w*\n.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^ {4}(\S.*)$", prose, re.MULTILINE)
    lines = [line for body in fenced for line in body.splitlines()] + indented
    bare = [re.sub(r"\s+#.*$|\s{3,}\S.*$", "", line).strip() for line in lines]
    return [line.removeprefix(".venv/bin/") for line in bare if line and not line.startswith("#")]


def printed_commands() -> list[tuple[str, str]]:
    """Return (page, command) of each line of a code block that types minidual.

    Synopses with [...] are left out.
    """
    commands: list[tuple[str, str]] = []
    for page in PAGES:
        name = page.relative_to(ROOT).as_posix()
        for line in code_lines(page.read_text(encoding="utf-8")):
            if line.startswith("minidual ") and "[" not in line:
                commands.append((name, line))
    return list(dict.fromkeys(commands))


def heading_anchors(text: str) -> set[str]:
    """Return the names that GitHub gives the headings of a page.

    A name is the heading in lower case, with hyphens for spaces and without punctuation. A name that
    exists already gets a number.
    """
    without_code = re.sub(r"(?ms)^```.*?^```$", "", text)
    anchors: set[str] = set()
    for heading in re.findall(r"^#{1,6} +(.+?)(?: +#+)? *$", without_code, re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        anchor = name
        repeats = 0
        while anchor in anchors:
            repeats += 1
            anchor = f"{name}-{repeats}"
        anchors.add(anchor)
    return anchors


def words(page: Path) -> int:
    """Return the number of words of a page; marks alone, such as the bars of a table, do not count.

    Chinese has no blanks between words: two characters count as one.
    """
    text = page.read_text(encoding="utf-8")
    chinese = re.findall(r"[\u4e00-\u9fff]", text)
    others = re.sub(r"[\u3000-\u9fff\uff00-\uffef]", " ", text).split()
    return sum(bool(re.search(r"\w", word)) for word in others) + len(chinese) // 2
