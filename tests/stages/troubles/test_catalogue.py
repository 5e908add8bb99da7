"""The catalogue of troubles: complete, true in what it names, and equal to its page."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from minidual.cli.options import CommonOptions
from minidual.cli.session import Session
from minidual.config.root import Config
from minidual.control.reflexes import REFLEXES
from minidual.errors import ExitCode, UsageError
from minidual.gate.check import Check
from minidual.skills.faults import CLOSED, OPENING
from minidual.stages.registry import STAGES, TOOLS
from minidual.stages.troubles import catalogue
from minidual.stages.troubles.trouble import (
    LEVELS,
    Level,
    Reference,
    Trouble,
    check,
    command,
    episode_fault,
    fault,
    message,
    reflex,
    refusal,
    setting,
)
from scripts.troubleshooting_page import PAGE, page
from tests.support.stage_criteria import MODULES, criteria_of
from tests.support.typed_commands import parse

ROOT = Path(__file__).resolve().parents[3]
SOURCES = ROOT / "src" / "minidual"


@cache
def strings(folder: str) -> frozenset[str]:
    """Return the texts in the code of a package, docstrings and f-strings in parts included."""
    texts: set[str] = set()
    for path in (SOURCES / folder).rglob("*.py"):
        if "troubles" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.add(node.value)
            if isinstance(node, ast.JoinedStr):
                texts.add(ast.unparse(node)[2:-1])
    return frozenset(texts)


def has_setting(path: str) -> bool:
    model: object = Config()
    for name in path.split("."):
        if name not in getattr(type(model), "model_fields", {}):
            return False
        model = getattr(model, name)
    return True


def is_command(words: str) -> bool:
    program, *rest = words.split()
    if program == "make":
        return f"\n{rest[0]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")
    try:
        parse(rest)
    except Exception:  # whatever the parser raises
        return False
    return program == "minidual"


def exists(reference: Reference) -> bool:
    """Return whether minidual has what a row names."""
    name = reference.name
    if reference.kind == "check":
        stage, _, own = name.partition(" ")
        return stage in MODULES and own in {c.name for c in criteria_of(MODULES[stage])}
    if reference.kind == "reflex":
        family, _, detail = name.partition(".")
        return family in REFLEXES and detail in REFLEXES[family].causes
    if reference.kind == "refusal":
        page_of_refusals = (ROOT / "docs" / "refusals.md").read_text(encoding="utf-8")
        return f"`{name}`" in page_of_refusals and name in strings("control")
    if reference.kind == "fault":
        return name in (*OPENING, *CLOSED)
    if reference.kind == "episode fault":
        page_of_data = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")
        return f"`{name}`" in page_of_data and name in strings("demos")
    if reference.kind == "message":
        return any(name in text for text in strings(""))
    if reference.kind == "setting":
        return has_setting(name)
    return is_command(name)


def test_all_rows_of_the_table_are_there() -> None:
    rows = list(catalogue.TROUBLES.values())
    assert [row.number for row in rows] == list(range(1, 53))
    assert [len(section) for section in catalogue.SECTIONS.values()] == [15, 15, 10, 12]
    assert len({row.symptom for row in rows}) == 52
    assert all(row.cause and row.answer and row.references for row in rows)
    assert {row.level for row in rows} == set(Level) == set(LEVELS)


@pytest.mark.parametrize("row", catalogue.TROUBLES.values(), ids=lambda row: row.name)
def test_what_a_row_names_exists(row: Trouble) -> None:
    assert [str(ref) for ref in row.references if not exists(ref)] == []


def test_what_is_often_mistaken_names_what_exists() -> None:
    assert [
        mistake.symptom for mistake in catalogue.MISTAKES if not exists(mistake.reference)
    ] == []


@pytest.mark.parametrize(
    "reference",
    [
        check("env-check", "joints.counted"),
        check("carry", "joints.count"),
        reflex("torque.sideways"),
        refusal("too_slow"),
        fault("lost_leg"),
        episode_fault("file_lost"),
        message("there is no such message anywhere"),
        command("minidual doctor --cure"),
        command("make coffee"),
        setting("train.batches"),
    ],
    ids=str,
)
def test_a_name_that_does_not_exist_is_found(reference: Reference) -> None:
    assert not exists(reference)


def test_a_row_is_probed_if_doctor_looks_at_a_check_or_an_episode() -> None:
    row = catalogue.TROUBLES["joint-order"]
    assert row.probed == "here"
    assert replace(row, references=(check("deploy", "trials"),)).probed == "in a run"
    assert replace(row, references=(episode_fault("not_finite"),)).probed == "in a run"
    explained = (reflex("emergency_stop"), setting("seed"), command("make all"))
    assert replace(row, references=explained).probed == ""


def test_doctor_runs_the_stages_that_count_as_live() -> None:
    for stage in STAGES:
        assert check(stage, "x").is_live == (stage in STAGES.until("carry"))
    with pytest.raises(ValueError, match="without blanks"):
        Check("two words", 1)  # a check's name never holds the blank that parts it from its stage


def test_the_page_is_that_of_the_catalogue() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m scripts.troubleshooting_page"
    numbers = [row.probed for row in catalogue.TROUBLES.values()]
    here, in_run = numbers.count("here"), numbers.count("in a run")
    text = re.sub(r"\s+", " ", page())
    assert f"probes {here + in_run} of them: {here} on any machine" in text
    assert here + in_run >= 35


def test_levels_that_name_commands_name_real_ones() -> None:
    assert [level.command for level in LEVELS.values() if not is_command(level.command)] == []


def test_a_wrong_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="no trouble 'joint-ordr'") as caught:
        catalogue.trouble("joint-ordr")
    assert caught.value.remedy == "did you mean 'joint-order'?"
    with pytest.raises(UsageError, match="--list") as caught:
        catalogue.trouble("xyzzy")
    assert caught.value.remedy == "minidual doctor --list"
    with pytest.raises(UsageError, match="1 to 52"):
        catalogue.trouble("53")
    assert catalogue.trouble("4") is catalogue.trouble("joint-order")


def doctor_command(capsys: pytest.CaptureFixture[str], **words: object) -> str:
    from minidual.cli.commands.doctor import doctor

    json = bool(words.pop("json", False))
    assert (
        doctor(**words, session=Session(CommonOptions(json=json), STAGES, TOOLS)) == ExitCode.PASS
    )  # type: ignore[arg-type]
    return capsys.readouterr().out


def test_the_command_explains_one_row_and_lists_all(capsys: pytest.CaptureFixture[str]) -> None:
    told = doctor_command(capsys, explain="joint-order")
    assert told.startswith("joint-order (row 4, level simulation and joints)\n")
    assert "check     env-check joints.mapped" in told
    assert "probed by `minidual doctor` on this machine" in told
    listed = doctor_command(capsys, listing=True)
    assert all(f" {name} " in listed for name in catalogue.TROUBLES)
    assert max(map(len, listed.splitlines())) <= 80
    assert '"number": 4' in doctor_command(capsys, explain="4", json=True)
    with pytest.raises(UsageError, match="exclude each other"):
        doctor_command(capsys, explain="4", listing=True)
