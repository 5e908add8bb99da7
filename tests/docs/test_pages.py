"""Pages: every link, heading and named page exists, and no page grows beyond its size."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from scripts.results.blocks import blocks
from scripts.site.pages import sections
from tests.support.documents import ROOT, heading_anchors, words

PAGES = sorted(
    {
        ROOT / "README.md",
        ROOT / "CHANGELOG.md",
        ROOT / "CONTRIBUTING.md",
        *ROOT.glob("README.*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("*/README.md"),
    },
)
WORDS_MAX = 1600
"""Of one page; a page that needs more has two jobs."""
WORDS_ALL_MAX = 50_400
"""Of all pages in docs/ together, as `wc -w` counts them, without the tables of `make results`.

A new page cuts what others repeat.
"""
CODE = ("src", "scripts", "tests", "examples", "configs", "Makefile", "pyproject.toml")
"""Where a page may be named by its path, such as docs/control.md."""
TOYS = {Path(__file__), ROOT / "tests" / "scripts" / "test_site.py"}
"""Tests that write pages of their own and name them."""


def page_name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def link_targets(page: Path) -> list[str]:
    """Return the targets of a page's links, without addresses of other hosts."""
    targets = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    return [target for target in targets if "://" not in target]


def broken_files(page: Path) -> list[str]:
    """Return the links of a page to files that do not exist."""
    names = [target.partition("#")[0] for target in link_targets(page)]
    return [name for name in names if name and not (page.parent / name).exists()]


def broken_anchors(page: Path) -> list[str]:
    """Return the links of a page to headings that no page has; missing files are left out."""
    broken = []
    for target in link_targets(page):
        name, hash_mark, anchor = target.partition("#")
        other = page.parent / name if name else page
        if not hash_mark or other.suffix != ".md" or not other.exists():
            continue
        if anchor not in heading_anchors(other.read_text(encoding="utf-8")):
            broken.append(target)
    return broken


def named_pages(root: Path) -> dict[str, set[str]]:
    """Return {page or page#heading: files that name it} of all code, as `docs/NAME.md#HEADING`."""
    files: list[Path] = []
    for name in CODE:
        path = root / name
        files += [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
    pages: dict[str, set[str]] = {}
    for file in files:
        if "__pycache__" in file.parts or file in TOYS:
            continue
        try:
            text = file.read_text(encoding="utf-8")
        except UnicodeDecodeError:  # a picture or a mesh
            continue
        for named in re.findall(r"\bdocs/[a-z0-9-]+\.md(?:#[\w-]+)?", text):
            pages.setdefault(named, set()).add(file.relative_to(root).as_posix())
    return pages


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_link_leads_to_a_file(page: Path) -> None:
    assert broken_files(page) == []


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_linked_heading_exists(page: Path) -> None:
    assert broken_anchors(page) == []


def exists(named: str) -> bool:
    """Return whether a page exists, and its heading where one is named."""
    name, _, anchor = named.partition("#")
    page = ROOT / name
    if not page.is_file():
        return False
    return not anchor or anchor in heading_anchors(page.read_text(encoding="utf-8"))


def test_every_page_that_code_names_exists() -> None:
    missing = {named: files for named, files in named_pages(ROOT).items() if not exists(named)}
    assert missing == {}


def missing_files(text: str) -> list[str]:
    """Return the Python files of the repository that a page names and that do not exist."""
    named = re.findall(r"\b(?:src|tests|scripts)/[\w/]+\.py\b", text)
    return [name for name in named if not (ROOT / name).is_file()]


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_python_file_that_a_page_names_exists(page: Path) -> None:
    assert missing_files(page.read_text(encoding="utf-8")) == []


def test_a_python_file_that_does_not_exist_is_found() -> None:
    text = "see `tests/docs/test_pages.py`, `scripts/none.py`"
    assert missing_files(text) == ["scripts/none.py"]


def test_a_page_that_code_names_is_found(tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "module.py").write_text('"""See docs/none.md#part, docs/other.md."""\n')
    assert named_pages(tmp_path) == {
        "docs/none.md#part": {"src/module.py"},
        "docs/other.md": {"src/module.py"},
    }


def test_every_page_is_in_the_index() -> None:
    index = {target.partition("#")[0] for target in link_targets(ROOT / "docs" / "README.md")}
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages - index == set()


def wrongly_grouped(text: str, pages: set[str]) -> list[str]:
    """Return the pages that stand in no section of the index, or in several: a page has one job."""
    groups = [set(re.findall(r"\]\(([\w-]+\.md)", body)) for body in sections(text).values()]
    return sorted(page for page in pages if sum(page in group for group in groups) != 1)


def test_every_page_stands_in_one_section_of_the_index() -> None:
    index = ROOT / "docs" / "README.md"
    pages = {page.name for page in index.parent.glob("*.md")} - {index.name}
    assert wrongly_grouped(index.read_text(encoding="utf-8"), pages) == []


def test_a_page_in_no_section_or_in_two_is_found() -> None:
    text = (
        "## Guides\n\n[a](a.md), [b](b.md)\n\n## Reference\n\n[b](b.md#x)\n\n## Else\n\n[c](c.md)\n"
    )
    assert wrongly_grouped(text, {"a.md", "b.md", "c.md"}) == ["b.md", "c.md"]


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_a_page_has_one_job(page: Path) -> None:
    assert words(page) <= WORDS_MAX


def test_all_pages_together_can_be_read() -> None:
    total = 0
    for page in (ROOT / "docs").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        tables = blocks(text).values()
        total += len(text.split()) - sum(len(table.split()) for table in tables)
    assert total <= WORDS_ALL_MAX


def test_words_are_counted_without_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("| two | words |\n|---|---|\n\n- three = 3\n", encoding="utf-8")
    assert words(page) == 4
    page.write_text("两个手臂，`minidual demo`。\n", encoding="utf-8")
    assert words(page) == 4


@pytest.mark.parametrize(
    ("target", "broken"),
    [
        ("#minidual-replay-file", False),
        ("other.md#against-libfrankas-errors-25-", False),
        ("other.md#twice", False),
        ("other.md#twice-1", False),
        ("https://example.org/page.md#none", False),
        ("#minidual-replay", True),
        ("#against-libfrankas-errors-25-", True),
        ("other.md#twice-2", True),
        ("other.md#Twice", True),
        ("other.md#a-comment", True),
        ("other.md#", True),
    ],
)
def test_a_link_to_a_heading_that_does_not_exist_is_found(
    tmp_path: Path,
    target: str,
    broken: bool,
) -> None:
    other = (
        "# Against libfranka's errors (25 %)\n\n```sh\n# A comment\n```\n\n"
        "## Twice\n\n### [Twice](x.md)\n"
    )
    (tmp_path / "other.md").write_text(other, encoding="utf-8")
    page = tmp_path / "page.md"
    page.write_text(
        f"## `minidual replay FILE`\n\nSee [the other\npage]({target}).\n",
        encoding="utf-8",
    )
    assert broken_anchors(page) == ([target] if broken else [])


def test_a_link_to_a_file_that_does_not_exist_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("[a](page.md#x), [b](none.md), [c](https://example.org)\n", encoding="utf-8")
    assert broken_files(page) == ["none.md"]
