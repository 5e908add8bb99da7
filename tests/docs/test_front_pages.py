"""The pages that a stranger reads first: short, plain answers, and no command that no test types."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from tests.support import lerobot_env
from tests.support.documents import ROOT, code_lines, printed_commands, words
from tests.support.typed_commands import parse

FRONT = ("README.md", "docs/quickstart.md", "docs/can-i.md")
README_WORDS_MAX = 700
"""Tables included: what one reads in two to three minutes."""
SET_UP = {"make setup", "make all", "make all PROFILE=smoke", "make plugins"}
"""Typed by every build on a fresh clone (.ci/), `make all` with the profile smoke; the plug-ins are
built by tests/plugins/test_commands.py."""
SHELL = (
    "source .venv/bin/activate",
    "export MINIDUAL_RUNS=/scratch/$USER/runs MINIDUAL_CACHE=/scratch/$USER/cache",
)
"""Lines of the shell itself."""
CONTAINER = "docker "
"""Begins lines that build or run an image; tests/package/test_container.py reads the Dockerfile."""
ANSWER = re.compile(r"^- \*\*[^*]+\?\*\* (?P<answer>.+)$", re.DOTALL)
ISSUE_TEMPLATES = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


def untested_lines(page: str) -> list[str]:
    """Return the lines of a page's code blocks that no test types."""
    typed = {command for name, command in printed_commands() if name == page}
    typed |= set(lerobot_env.printed_lines())
    known = typed | SET_UP | set(SHELL)
    return [
        line
        for line in code_lines((ROOT / page).read_text(encoding="utf-8"))
        if line not in known and not line.startswith(CONTAINER)
    ]


@pytest.mark.parametrize("page", FRONT)
def test_every_printed_line_is_typed_by_a_test(page: str) -> None:
    """tests/docs/test_commands.py types them, and tests/plugins/test_commands.py those of LeRobot."""
    assert untested_lines(page) == []


def test_a_line_that_no_test_types_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "```\n.venv/bin/minidual demo   # a film\npip install minidual\n```\n\n    make all\n"
    assert code_lines(text) == ["minidual demo", "pip install minidual", "make all"]
    monkeypatch.setattr("tests.docs.test_front_pages.code_lines", lambda _: ["pip install x"])
    assert untested_lines("README.md") == ["pip install x"]


@pytest.mark.parametrize("line", sorted(SET_UP))
def test_a_printed_target_exists(line: str) -> None:
    target, *variables = line.split()[1:]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}:", makefile, re.MULTILINE)
    for variable in variables:
        name, _, _ = variable.partition("=")
        assert re.search(rf"^{name} \?=", makefile, re.MULTILINE)
    done = subprocess.run(
        ["make", "-n", target, *variables],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", FRONT)
def test_a_command_inside_a_sentence_parses(page: str) -> None:
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    for command in re.findall(r"`(?:\.venv/bin/)?minidual ([a-z][^`]*)`", text):
        parse(command.split())


def test_every_build_types_the_targets() -> None:
    scripts = "".join(path.read_text(encoding="utf-8") for path in (ROOT / ".ci").iterdir())
    assert "make all PROFILE=smoke" in scripts


def test_the_readme_is_read_in_two_minutes() -> None:
    assert words(ROOT / "README.md") <= README_WORDS_MAX


def items(text: str) -> list[str]:
    """Return the items of a page's lists, each in one line."""
    return [" ".join(item.split()) for item in re.findall(r"^- .+(?:\n  .+)*", text, re.MULTILINE)]


def test_every_question_has_an_answer_and_a_link() -> None:
    answers = items((ROOT / "docs" / "can-i.md").read_text(encoding="utf-8"))
    assert len(answers) > 30
    for item in answers:
        match = ANSWER.match(item)
        assert match, item
        assert re.search(r"\]\([^)]+\)", match["answer"]), item
        assert len(match["answer"].split()) <= 45, f"one line, not a page: {item}"


@pytest.mark.parametrize(
    "question",
    [
        "mouse", "gamepad", "GELLO", "My own arms", "different arms", "Franka", "ROS 2", "MoveIt 2",
        "Reinforcement", "dataset", "policy", "task", "GPU", "cluster", "Windows", "macOS", "Docker",
        "disk", "time",
    ],
)  # fmt: skip
def test_what_people_ask_is_answered(question: str) -> None:
    asked = re.findall(
        r"^- \*\*([^*]+\?)\*\*", (ROOT / "docs" / "can-i.md").read_text(), re.MULTILINE
    )
    assert any(question in each for each in asked)


def published(text: str) -> list[str]:
    """Return the rates with one decimal place: those of other suites."""
    return re.findall(r"\d+\.\d %(?: \(\d+\.\d-\d+\.\d\))?", text)


def test_the_readme_quotes_the_published_results() -> None:
    """Numbers of other suites stand in docs/other-suites.md, with their source."""
    page = (ROOT / "docs" / "other-suites.md").read_text(encoding="utf-8")
    quoted = published((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(quoted) == 4
    assert [rate for rate in quoted if rate not in published(page)] == []
    rows = [row for row in page.splitlines() if row.startswith("|") and published(row)]
    assert all("https://" in row for row in rows)


@pytest.mark.parametrize("template", ISSUE_TEMPLATES, ids=lambda path: path.name)
def test_an_issue_template_can_be_filled_in(template: Path) -> None:
    form = yaml.safe_load(template.read_text(encoding="utf-8"))
    if template.name == "config.yml":
        assert form == {"blank_issues_enabled": True}
        return
    assert {"name", "description", "body"} <= set(form)
    fields = [field for field in form["body"] if field["type"] != "markdown"]
    ids = [field["id"] for field in fields]
    assert len(ids) == len(set(ids))
    assert all(field["attributes"]["label"] for field in fields)
    assert any(field.get("validations", {}).get("required") for field in fields)


def test_there_are_issue_templates() -> None:
    assert [path.stem for path in ISSUE_TEMPLATES] == ["bug", "config", "feature", "result"]
