"""README and docs: every Python block runs, every command parses, and what they name exists."""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from minidual.cli.app import build_app
from minidual.cli.options import CommonOptions, GateOptions
from minidual.stages.registry import STAGES, TOOLS
from tests.support import howto
from tests.support.documents import PAGES, ROOT, printed_commands
from tests.support.typed_commands import parse

OWN_STAGES = {"steadiness"}
"""Stages that a how-to adds; its own test types their commands."""


@pytest.mark.parametrize(
    ("page", "command"),
    printed_commands(),
    ids=lambda value: value.replace("/", "."),
)
def test_printed_commands_parse_and_name_files_that_exist(page: str, command: str) -> None:
    words = shlex.split(command)[1:]
    if words[0] in OWN_STAGES or words[:2] == ["explain", "steadiness"]:
        return
    parse(words)
    missing = [
        word for word in words if word.startswith("examples/") and not (ROOT / word).is_file()
    ]
    assert not missing


def test_a_command_with_a_wrong_option_does_not_parse() -> None:
    with pytest.raises(Exception, match="No such option"):
        parse(["plan", "--towards", "ready"])


def test_there_are_commands_to_try() -> None:
    commands = {command.split()[1] for _, command in printed_commands()}
    assert set(STAGES) <= commands | {"report"}


def run_blocks(page: str, folder: Path) -> dict:
    """Run a page's Python blocks one after the other in an empty folder; return their names."""
    names: dict = {}
    here = Path.cwd()
    os.chdir(folder)
    try:
        for block in howto.blocks(page):
            exec(compile(block, page, "exec"), names)
    finally:
        os.chdir(here)
    return names


def test_readme_plans_with_proof(tmp_path: Path) -> None:
    plan = run_blocks("../README.md", tmp_path)["plan"]
    assert plan.proven
    assert plan.duration_s > 0.1


def test_control_page_reaches_its_goal(tmp_path: Path) -> None:
    names = run_blocks("control.md", tmp_path)
    assert np.abs(names["world"].q - names["goal"]).max() < 2e-3


def test_supervisor_page_stops_and_dumps(tmp_path: Path) -> None:
    names = run_blocks("supervisor.md", tmp_path)
    assert names["supervisor"].reflex.label == "torque.range"
    assert np.all(np.abs(names["tau"]) < 90.0)
    assert len(list((tmp_path / "dumps").glob("torque.range-*.npz"))) == 1


def test_data_page_writes_and_reads_an_episode(tmp_path: Path) -> None:
    episode = run_blocks("data.md", tmp_path)["episode"]
    assert episode.action.shape == (3, 14)
    assert [path.name for path in tmp_path.iterdir()] == ["episode_000000.hdf5"]


def test_scenes_page_goes_straight_down(tmp_path: Path) -> None:
    assert run_blocks("planning-scenes.md", tmp_path)["plan"].verification.ok


def test_closed_chain_page_moves_the_rod(tmp_path: Path) -> None:
    names = run_blocks("closed-chain.md", tmp_path)
    assert names["plan"].verification.ok
    assert np.abs(names["plan"].Ts_world_object[-1] - names["T_world_goal"]).max() < 1e-3
    assert names["plan"].residual_m < 1e-3


def test_task_page_solves_the_carry(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = run_blocks("task-pipeline.md", tmp_path)
    carried = next(
        s.trajectory.Ts_world_object for s in names["solution"].segments if s.phase == "carry"
    )
    assert np.abs(carried[-1][:2, 3] - names["trial"].goal["rod"][:2]).max() < 1e-9
    assert "rod_carry: solved" in capsys.readouterr().out


def test_gymnasium_page_opens_the_environment(tmp_path: Path) -> None:
    names = run_blocks("gymnasium.md", tmp_path)
    assert names["env"].observation_space.contains(names["observation"])
    names["env"].close()
    assert names["envs"].observation_space.contains(names["observations"])
    assert names["rewards"].shape == (4,)


@pytest.mark.slow
@pytest.mark.torch
def test_python_page_plans_tries_records_and_acts(tmp_path: Path) -> None:
    names = run_blocks("python.md", tmp_path)
    assert names["plan"].proven
    assert names["up"].duration_s > 0.05
    assert len(names["planned"]) == len(names["soft"]) == 3
    assert names["episode"].meta.success
    assert names["env"].action_space.contains(names["action"].astype(np.float32))


TESTED = {
    "control",
    "supervisor",
    "data",
    "planning-scenes",
    "closed-chain",
    "task-pipeline",
    "gymnasium",
    "python",
}


def test_no_page_has_untested_python() -> None:
    with_code = {page.stem for page in PAGES if "```python" in page.read_text(encoding="utf-8")}
    howtos = {name for name in with_code if name.startswith("howto-")}
    assert with_code - howtos == TESTED | {"README"}
    tests = "".join(
        path.read_text(encoding="utf-8")
        for path in (ROOT / "tests" / "howto").glob("test_howto_*.py")
    )
    assert [name for name in sorted(howtos) if f"{name}.md" not in tests] == []


def test_every_planning_option_is_documented() -> None:
    text = "".join(
        (ROOT / "docs" / name).read_text() for name in ("planning-scenes.md", "task-pipeline.md")
    )
    group = typer.main.get_command(build_app(STAGES, TOOLS))
    options = {name: parameter.opts for name, parameter in parameters(group, "plan").items()}
    shared = {field.name for kind in (CommonOptions, GateOptions) for field in fields(kind)}
    own = {name for key, names in options.items() if key not in shared for name in names}
    assert {"--to", "--from", "--scene", "--video", "--queries"} <= own
    undocumented = {"--queries", "--view-host", "--view-port"}
    assert own - undocumented <= set(re.findall(r"--[a-z][a-z-]*", text))


def parameters(group: Any, command: str) -> dict[str, Any]:
    return {parameter.name: parameter for parameter in group.commands[command].params}
