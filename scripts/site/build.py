"""Build the site with MkDocs, in strict mode and without the network."""

import logging
from pathlib import Path
from typing import Any

from mkdocs.commands.build import build
from mkdocs.config import load_config

from scripts.site.commands import command_reference
from scripts.site.pages import Generated, gather
from scripts.site.settings import settings_reference
from scripts.site.surface import surface_reference

ROOT = Path(__file__).resolve().parents[2]
ASSETS = Path(__file__).with_name("assets")
CONFIG = Path(__file__).with_name("mkdocs.yml")
GENERATED: Generated = {
    "Python API": surface_reference,
    "Command line": command_reference,
    "Configuration": settings_reference,
}
"""The pages of the reference that are made, not written."""


class _Problems(logging.Handler):
    """Collects warnings and errors of the build."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


def build_site(
    pages: Path,
    out: Path,
    root: Path = ROOT,
    generated: Generated = GENERATED,
) -> list[str]:
    """Build the site of a repository; return the problems of its pages, none if all is well.

    Args:
        pages: An empty folder for the sources.
        out: The site's folder; what it held is removed.
        root: The repository.
        generated: {title: text of a page} of the reference.
    """
    nav = gather(root, pages, generated)
    for asset in ASSETS.iterdir():
        (pages / "assets").mkdir(exist_ok=True)
        (pages / "assets" / asset.name).write_bytes(asset.read_bytes())
    problems = _Problems()
    logger = logging.getLogger("mkdocs")
    logger.addHandler(problems)
    try:
        settings: dict[str, Any] = {"docs_dir": str(pages), "site_dir": str(out), "nav": nav}
        build(load_config(str(CONFIG), **settings))
    finally:
        logger.removeHandler(problems)
    return problems.messages
