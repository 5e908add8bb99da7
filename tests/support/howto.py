"""Read the code of a how-to page, so that a test runs what the page prints."""

from __future__ import annotations

import importlib
import os
import re
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from minidual.registry import Registry

DOCS = Path(__file__).resolve().parents[2] / "docs"


def blocks(page: str, language: str = "python") -> list[str]:
    """Return the fenced blocks of one language in docs/<page>, in order.

    Raises:
        ValueError: There is none.
    """
    text = (DOCS / page).read_text(encoding="utf-8")
    texts = re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    if not texts:
        raise ValueError(f"docs/{page} holds no {language} block")
    return texts


def distribution(folder: Path, name: str, modules: dict[str, str], toml: str) -> dict[str, str]:
    """Lay out an installed distribution, and return the environment in which Python finds it.

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
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n",
        encoding="utf-8",
    )
    groups = tomllib.loads(toml)["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "\n".join(f"{key} = {value}" for key, value in rows.items())
        for group, rows in groups.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    paths = [str(folder), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}


@contextmanager
def program(page: str, table: Registry[Any], folder: Path) -> Iterator[dict[str, Any]]:
    """Install the module that a page prints first, run the program after it; yield its names.

    It is installed as the page's pyproject.toml says.
    """
    (module, text) = blocks(page)
    (toml,) = blocks(page, "toml")
    name = tomllib.loads(toml)["project"]["name"].replace("-", "_")
    with installed(table, folder, name, {name: module}, toml):
        names = {"module": importlib.import_module(name)}
        exec(compile(text, page, "exec"), names)
        yield names


@contextmanager
def installed(
    table: Registry[Any],
    folder: Path,
    name: str,
    modules: dict[str, str],
    toml: str,
) -> Iterator[None]:
    """Install a distribution in this process: until the end its entry point adds a row."""
    distribution(folder, name, modules, toml)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setattr(table, "_rows", dict(table._rows))
        patch.setattr(table, "_plugged", False)  # entry points are looked for again
        yield
    for module in modules:
        sys.modules.pop(module, None)
    importlib.invalidate_caches()
