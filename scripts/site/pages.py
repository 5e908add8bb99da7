"""Gather the pages of the site: README, docs/ and generated references, laid out as in the repository.

So the links between pages hold as they are.
"""

import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PAGE_PATTERNS = ("*.md", "docs/**/*.md", "*/README.md")
_NOT_PAGES = ("build/", "dist/")
_INDEX = "docs/README.md"
_HOME = "README.md"
_LINK = re.compile(r"\]\(([^)\s]+)\)")
KINDS = ("Guides", "How-tos", "Explanations", "Reference")
"""Sections of the index, one for each kind of page."""

type Generated = Mapping[str, Callable[[], str]]
"""{title: text of a page}."""
type Nav = list[dict[str, Any]]
"""Navigation of MkDocs: [{title: page or list of the same}]."""


def pages_of(root: Path) -> list[str]:
    """Return the pages of a repository, relative to it."""
    found = {path for pattern in PAGE_PATTERNS for path in root.glob(pattern)}
    names = [path.relative_to(root).as_posix() for path in found]
    return sorted(name for name in names if not name.startswith((".", *_NOT_PAGES)))


def linked_files(root: Path, page: str) -> list[str]:
    """Return the files beside pages that a page links to, relative to the repository."""
    files: list[str] = []
    for target in _LINK.findall((root / page).read_text(encoding="utf-8")):
        name = target.partition("#")[0]
        if not name or "://" in target or name.endswith(".md"):
            continue
        path = (root / page).parent / name
        if path.is_file():
            files.append(path.resolve().relative_to(root.resolve()).as_posix())
    return files


def gather(root: Path, target: Path, generated: Generated) -> Nav:
    """Write all pages and the files that they link to; return the navigation.

    Args:
        root: The repository.
        target: An empty folder.
        generated: {title: text of a reference page}.
    """
    pages = pages_of(root)
    for page in pages:
        _write(target / page, _without_folder_links(root, page))
        for file in linked_files(root, page):
            (target / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / file, target / file)
    references: Nav = []
    for title, text in generated.items():
        name = f"reference/{title.lower().replace(' ', '-')}.md"
        _write(target / name, text())
        references.append({title: name})
    return navigation(root, pages, references)


def _without_folder_links(root: Path, page: str) -> str:
    """Return a page's text; links to folders, which a site cannot show, become plain words."""
    text = (root / page).read_text(encoding="utf-8")

    def plain(match: re.Match[str]) -> str:
        words, target = match.groups()
        name = target.partition("#")[0]
        is_folder = "://" not in target and ((root / page).parent / name).is_dir()
        return words if name and is_folder else match.group()

    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)", plain, text)


def navigation(root: Path, pages: list[str], references: Nav) -> Nav:
    """Return the navigation: the sections of the index, the references, Chinese, and what is left."""
    nav: Nav = [{"Home": _HOME}, {"All pages": _INDEX}]
    named = {_HOME, _INDEX}
    for section, text in sections((root / _INDEX).read_text(encoding="utf-8")).items():
        entries: Nav = list(references) if section == "Reference" else []
        for target in _LINK.findall(text):
            page = f"docs/{target.partition('#')[0]}"
            if page in pages and page not in named and not is_chinese(page):
                named.add(page)
                entries.append({title_of(root / page): page})
        nav.append({section: entries})
    chinese: Nav = [{title_of(root / page): page} for page in pages if is_chinese(page)]
    named |= {page for page in pages if is_chinese(page)}
    rest: Nav = [{title_of(root / page): page} for page in pages if page not in named]
    return [
        *nav,
        *({title: part} for title, part in {"中文": chinese, "More": rest}.items() if part),
    ]


def is_chinese(page: str) -> bool:
    """Return whether a page is in Chinese."""
    return page.startswith("docs/zh/") or page.endswith(".zh.md")


def sections(index: str) -> dict[str, str]:
    """Return {kind of pages: text of its section} of the index of the documentation."""
    found: dict[str, str] = {}
    for part in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        title, _, text = part.partition("\n")
        if title in KINDS:
            found[title] = text
    return found


def title_of(page: Path) -> str:
    """Return the first heading of a page, up to a colon, without marks."""
    heading = re.search(r"^# +(.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    title = page.stem if heading is None else heading.group(1)
    return re.sub(r"[`*]", "", re.split("[:：]", title)[0]).strip()


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
