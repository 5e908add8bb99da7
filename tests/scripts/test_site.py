"""The documentation site: pages, navigation, generated references, and a build that finds broken links."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer

from minidual.cli.app import build_app
from minidual.config.base import StrictModel
from minidual.config.root import Config
from minidual.stages.registry import STAGES, TOOLS
from scripts.site.build import build_site
from scripts.site.commands import command_reference
from scripts.site.pages import KINDS, gather, pages_of, sections, title_of
from scripts.site.settings import field_comments, settings_reference, type_in_words
from scripts.site.surface import surface_reference
from tests.support.browser import Browser, find_browser
from tests.support.documents import ROOT

DOCS = "docs"
"""Apart from the names of pages that only these tests have: a test looks for pages that code names."""
INDEX = """# Documentation

## Guides

What you can do.

- [Start](start.md): the first hour, with [a file](../examples/scene.yaml)

## Reference

Tables.

- [Words](words.md)

## Below

- [Other](other.md)
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A small repository with an index, two pages in it and one beside it."""
    root = tmp_path / "repository"
    files = {
        "README.md": "# thing\n\nSee [docs](docs/README.md), [a folder](examples/).\n",
        "docs/README.md": INDEX,
        f"{DOCS}/start.md": "# Start: the first hour\n\nSee [words](words.md#a-word).\n",
        f"{DOCS}/words.md": "# Words\n\n## A word\n\nText.\n",
        f"{DOCS}/other.md": "# Other\n",
        "docs/zh/start.md": "# 开始：第一小时\n",
        "examples/scene.yaml": "table: true\n",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    return root


def test_the_navigation_is_that_of_the_index(repository: Path, tmp_path: Path) -> None:
    nav = gather(repository, tmp_path / "pages", {"All options": lambda: "# All options\n"})
    assert nav == [
        {"Home": "README.md"},
        {"All pages": "docs/README.md"},
        {"Guides": [{"Start": f"{DOCS}/start.md"}]},
        {"Reference": [{"All options": "reference/all-options.md"}, {"Words": f"{DOCS}/words.md"}]},
        {"中文": [{"开始": "docs/zh/start.md"}]},
        {"More": [{"Other": f"{DOCS}/other.md"}]},
    ]
    assert (tmp_path / "pages" / "examples" / "scene.yaml").is_file()
    home = (tmp_path / "pages" / "README.md").read_text(encoding="utf-8")
    assert "a folder." in home, "a site cannot show a folder"


def test_a_site_without_faults_is_built(repository: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    assert build_site(tmp_path / "pages", out, repository, {}) == []
    assert "the first hour" in (out / "docs" / "start.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("link", ["nowhere.md", "words.md#no-word", "../LICENSE"])
def test_a_broken_link_is_a_problem(repository: Path, tmp_path: Path, link: str) -> None:
    page = repository / "docs" / "start.md"
    page.write_text(f"# Start\n\nSee [it]({link}).\n", encoding="utf-8")
    problems = build_site(tmp_path / "pages", tmp_path / "site", repository, {})
    assert len(problems) == 1
    assert link in problems[0]


def test_every_page_is_in_the_site() -> None:
    pages = pages_of(ROOT)
    assert {"README.md", "CHANGELOG.md", "docs/README.md", "configs/README.md"} <= set(pages)
    assert not [page for page in pages if page.startswith((".", "build/"))]


def test_the_index_has_the_four_kinds_of_pages() -> None:
    found = sections((ROOT / "docs" / "README.md").read_text(encoding="utf-8"))
    assert tuple(found) == KINDS
    assert "quickstart.md" in found["Guides"]
    assert "howto-" not in found["Reference"]


def test_a_title_ends_at_a_colon(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("text\n\n# `try`: trials\n", encoding="utf-8")
    assert title_of(page) == "try"


def options_of(group: Any) -> Iterator[str]:
    for command in group.commands.values():
        if hasattr(command, "commands"):
            yield from options_of(command)
            continue
        for parameter in command.params:
            if parameter.param_type_name == "option":
                yield from parameter.opts


def test_every_command_and_option_is_in_the_reference() -> None:
    text = command_reference()
    group = typer.main.get_command(build_app(STAGES, TOOLS))
    assert [name for name in options_of(group) if f"`{name}`" not in text] == []
    headings = re.findall(r"^## minidual (.+)$", text, re.MULTILINE)
    assert {*STAGES, "config show", "try"} <= set(headings)


def paths_of(model: StrictModel, before: str = "") -> Iterator[str]:
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, StrictModel):
            yield from paths_of(value, f"{before}{name}.")
        else:
            yield f"{before}{name}"


def test_every_setting_is_in_the_reference_once() -> None:
    rows = re.findall(r"^\| `([a-z_.0-9]+)` \|", settings_reference(), re.MULTILINE)
    assert sorted(rows) == sorted(paths_of(Config()))


def test_a_setting_has_its_type_bounds_and_meaning() -> None:
    rows = {row.split("`")[1]: row for row in settings_reference().splitlines() if "| `" in row}
    assert "`20260`" in rows["seed"]
    assert "integer, >= 0, < 2^63" in rows["seed"]
    assert "integer, 1 to 512" in rows["workers"]
    assert field_comments(Config)["seed"] in rows["seed"]
    assert "acceptance asks for at least" in rows["benchmark.trials_n"]
    assert type_in_words(dict[str, tuple[float, float]]) == "mapping to list of 2 numbers"
    assert type_in_words(bool | None) == "true or false or null"


def test_every_public_name_is_in_the_reference() -> None:
    import minidual

    text = surface_reference()
    assert [name for name in minidual.__all__ if f"heading: {name}\n" not in text] == []


def test_a_public_name_without_its_place_is_refused() -> None:
    import minidual

    module = ModuleType("other")
    module.__all__ = [*minidual.__all__, "novelty"]
    with pytest.raises(ValueError, match="novelty"):
        surface_reference(module)


LOADED = re.compile(
    r"""<(?:script|img|iframe|source)[^>]*\ssrc=["']?(https?:)?//"""
    r"""|<link[^>]*rel=["']?(?:stylesheet|preconnect|icon|preload)[^>]*href=["']?(https?:)?//"""
    r"""|@import\s+url\(["']?(https?:)?//""",
)
"""What a browser fetches from another host when it opens a page."""


@pytest.mark.parametrize(
    ("text", "fetches"),
    [
        ('<script src="https://unpkg.com/x"></script>', True),
        ('<link rel="preconnect" href="https://fonts.gstatic.com">', True),
        ('<script src="../assets/x.js"></script>', False),
        ('<a href="https://keepachangelog.com">', False),
    ],
)
def test_what_a_page_fetches_is_found(text: str, fetches: bool) -> None:
    assert bool(LOADED.search(text)) == fetches


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole site."""
    folder = tmp_path_factory.mktemp("site")
    assert build_site(folder / "pages", folder / "site") == []
    return folder / "site"


@pytest.mark.slow
def test_the_whole_site_is_built_and_fetches_nothing(site: Path) -> None:
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html")}
    assert {"index.html", "docs/quickstart.html", "reference/python-api.html"} <= pages
    fetching = [path for path in site.rglob("*.html") if LOADED.search(path.read_text("utf-8"))]
    assert fetching == []
    api = (site / "reference" / "python-api.html").read_text(encoding="utf-8")
    assert 'id="minidual.api.planning.Planner.plan"' in api


@pytest.mark.slow
def test_a_reader_searches_without_a_server(site: Path, tmp_path: Path) -> None:
    path = find_browser()
    if path is None:
        pytest.skip("no browser on this machine")
    with Browser(path, tmp_path, (1300, 900)) as browser:
        browser.go(f"{(site / 'index.html').as_uri()}", limit_s=60.0)
        browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
        browser.until(lambda: "From a clone" in browser.text())
        time.sleep(1.0)
        for kind in ("mousePressed", "mouseReleased"):
            browser.call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=1180,
                y=24,
                button="left",
                clickCount=1,
            )
        browser.call("Input.insertText", text="handover")
        assert browser.until(lambda: "matching documents" in browser.text(), 90.0)
        other_hosts = [
            url for url in browser.requests if not url.startswith(("file:", "data:", "about:"))
        ]
        assert other_hosts == []
