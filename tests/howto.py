"""Read the code of a how-to page, so that a test runs what the page prints."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"


def blocks(page: str, language: str = "python") -> list[str]:
    """Return the fenced blocks of one language in docs/<page>, in order; none is an error."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    if not found:
        raise ValueError(f"docs/{page} holds no {language} block")
    return found


def distribution(folder: Path, name: str, modules: dict[str, str], toml: str) -> dict[str, str]:
    """Lay out an installed distribution in a folder and return the environment in which Python finds it.

    Args:
        folder: Empty folder.
        name: Of the distribution.
        modules: {module: source text}.
        toml: Entry points as they stand in a pyproject.toml.
    """
    for module, text in modules.items():
        (folder / f"{module}.py").write_text(text, encoding="utf-8")
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    groups = tomllib.loads(toml)["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "\n".join(f"{key} = {value}" for key, value in rows.items()) for group, rows in groups.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    paths = [str(folder), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}
