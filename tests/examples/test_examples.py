"""The scripts and the notebook of examples/ run, and stay short."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
from minidual.robot.pair import DUAL_PANDA

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
LINES_MAX = 60

type Run = Callable[..., str]


@pytest.fixture
def run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Run:
    """Return what runs a script in an empty folder and returns what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")

    def run_script(name: str, *words: str) -> str:
        monkeypatch.setattr("sys.argv", [name, *words])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run_script


def test_both_arms_are_planned_and_proven(run: Run) -> None:
    said = run("plan_both_arms.py")
    assert "proven free of collisions: True" in said
    assert "refused: the left hand cannot reach (2.000" in said


@pytest.mark.slow
def test_two_methods_are_compared(run: Run, tmp_path: Path) -> None:
    said = run("compare_methods.py", "--task", "pot_lift", "--trials", "2")
    assert said.count("pot_lift") == 2, "one sentence for each comparison"
    assert "soft impedance: 2 of 2 succeed" in said
    assert (tmp_path / "trials.csv").read_text(encoding="utf-8").count("\n") == 3


def write_episode(path: Path) -> None:
    """Write an episode of one second in which the arms sway."""
    meta = EpisodeMeta(fps=50.0, task="sway", seed=7, cameras=("high",))
    with EpisodeWriter(path, meta) as writer:
        for tick in range(51):
            q = DUAL_PANDA.home + 0.05 * np.sin(0.06 * tick)
            writer.append(
                qpos=q,
                action=q + 0.01,
                gripper=np.ones(2),
                action_gripper=np.ones(2),
                timestamps=tick / meta.fps,
                images={"high": np.full((12, 16, 3), tick, np.uint8)},
            )
        writer.finish(success=True, extra={"trial": 0})
        writer.publish()


def test_an_episode_is_described_and_drawn(run: Run, tmp_path: Path) -> None:
    write_episode(tmp_path / "episode_000000.hdf5")
    said = run("read_episode.py", "episode_000000.hdf5")
    assert "joints (51, 14) [rad]" in said
    assert "rms_jerk_rad_s3" in said
    assert (tmp_path / "episode.png").stat().st_size > 1000


def test_a_random_policy_steps_the_environment(run: Run) -> None:
    said = run("random_policy.py", "--steps", "110")
    assert "2.00 s: return" in said
    assert "110 steps of 20 ms, success False" in said


@pytest.mark.slow
@pytest.mark.torch
def test_the_policy_of_the_package_carries_the_rod(run: Run) -> None:
    said = run("run_policy.py", "--trials", "1")
    assert "start 100: success" in said
    assert "environment: success True" in said


def cells(notebook: Path) -> list[str]:
    """Return the code cells of a notebook."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
def test_the_cells_of_the_notebook_run_in_order(
    run: Run,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run is not None, "an empty folder, and a backend without windows"
    names: dict = {"__name__": "__main__"}
    for number, cell in enumerate(cells(EXAMPLES / "first_steps.ipynb")):
        exec(compile(cell, f"cell {number}", "exec"), names)
    said = capsys.readouterr().out
    assert "proven: True" in said
    assert len(names["planned"]) == len(names["compliant"]) == 1


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_holds_no_results(notebook: Path) -> None:
    content = json.loads(notebook.read_text(encoding="utf-8"))
    code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    assert code
    assert [cell["outputs"] for cell in code] == [[]] * len(code)
    assert {cell["execution_count"] for cell in code} == {None}


ELSEWHERE = {
    "lead_over_udp.py": "demos/leaders/test_network.py",
    "lead_over_websocket.py": "demos/leaders/test_network_websocket.py",
    "policy_server.py": "policies/test_server.py",
    "serve_checkpoint.py": "policies/test_server.py",
}
"""Scripts that the tests of what they lead run."""


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_is_short_and_runs_in_a_test(script: Path) -> None:
    assert len(script.read_text(encoding="utf-8").splitlines()) < LINES_MAX
    if script.name in ELSEWHERE:
        place = Path(__file__).parents[1] / ELSEWHERE[script.name]
        assert script.name in place.read_text(encoding="utf-8")
        return
    assert f'run("{script.name}"' in Path(__file__).read_text(encoding="utf-8")


def test_there_are_five_scripts_and_a_notebook() -> None:
    assert len(SCRIPTS) >= 5
    assert len(NOTEBOOKS) >= 1
