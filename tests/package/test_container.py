"""The Dockerfile: the same two commands, the packages that pages and messages name, nothing else."""

from __future__ import annotations

import re
from pathlib import Path

from minidual.stages.env_check import criteria
from minidual.variables import INSTALL_RENDERING, RENDERING_PACKAGES

ROOT = Path(__file__).resolve().parents[2]
TOOLS = {"git", "make"}
"""Programs that a slim image lacks; README names them."""


def instructions(text: str) -> list[str]:
    """Return the instructions of a Dockerfile, each on one line, without comments."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [re.sub(r"\s+", " ", line) for line in joined.splitlines()]


def installed(text: str) -> set[str]:
    """Return the Debian packages that a text installs."""
    names: set[str] = set()
    for words in re.findall(r"apt-get install ([^&`\n]*)", text.replace("\\\n", " ")):
        names |= {word for word in words.split() if not word.startswith("-")}
    return names


def dockerfile() -> str:
    return (ROOT / "Dockerfile").read_text(encoding="utf-8")


def test_the_container_is_made_by_the_same_two_commands() -> None:
    lines = instructions(dockerfile())
    assert lines[-1] == 'CMD ["make", "all"]'
    assert any(re.match(r"RUN make setup\b", line) for line in lines)
    assert len(dockerfile().splitlines()) <= 18
    assert len(lines) <= 10


def test_it_is_built_from_a_debian_image_and_an_index_alone() -> None:
    first, *others = instructions(dockerfile())
    version = (ROOT / ".python-version").read_text(encoding="utf-8").strip()
    assert re.fullmatch(rf"FROM python:{re.escape(version)}-slim-(bookworm|trixie)", first)
    assert not [line for line in others if re.search(r"\b(ADD|curl|wget|FROM|clone)\b|://", line)]


def test_its_packages_are_those_that_readme_and_env_check_name() -> None:
    assert installed(dockerfile()) - TOOLS == set(RENDERING_PACKAGES)
    assert installed(dockerfile()) >= TOOLS
    assert criteria.CONTRAST_MIN.remedy == INSTALL_RENDERING
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    needs = readme.partition("## What it needs")[2].partition("\n## ")[0]
    optional = "".join(re.findall(r"^- Optional:.*?(?=^- |\Z)", needs, re.MULTILINE | re.DOTALL))
    assert installed(needs) - installed(optional) == set(RENDERING_PACKAGES)
    assert all(f"`{tool}`" in needs for tool in TOOLS)
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert set(RENDERING_PACKAGES) <= installed(ci)
    simulation = (ROOT / "docs" / "simulation.md").read_text(encoding="utf-8")
    assert all(package in simulation for package in RENDERING_PACKAGES)


def test_another_package_is_found() -> None:
    text = "RUN apt-get update && apt-get install -y \\\n git libegl1 \\\n && true"
    assert installed(text) == {"git", "libegl1"}


def test_what_is_made_here_is_not_sent_to_the_builder() -> None:
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert {".venv", "runs/*", "data/*", "**/__pycache__"} <= set(ignored)
    copied = {"requirements.lock", "pyproject.toml", "Makefile", "src", "scripts", ".git"}
    assert not copied & set(ignored)
