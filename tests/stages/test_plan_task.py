"""`minidual plan --task`: a whole task planned, driven and judged; right exit codes, no verdict."""

import json

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.stages import plan_task
from minidual.stages.registry import STAGES


@pytest.fixture
def run(tmp_path, capsys):
    def call(*words):
        code = run_command_line(
            ["plan", *map(str, words), "--runs-dir", str(tmp_path / "runs")],
            STAGES,
        )
        out = capsys.readouterr()
        assert not list(tmp_path.rglob("verdict.json"))
        return code, out.out, out.err

    return call


def test_a_task_is_planned_driven_and_filmed(run, tmp_path, monkeypatch):
    filmed = []
    monkeypatch.setattr(plan_task, "film_postures", lambda model, qpos, path: filmed.append(qpos))
    code, out, err = run("--task", "rod_carry", "--video", tmp_path / "rod.mp4")
    assert code == 0, out + err
    assert "rod_carry: solved" in out
    assert "driven in the simulator: success" in out
    assert "rod.mp4" in err
    (qpos,) = filmed  # rendering them is tested with `minidual replay`
    assert len(qpos) > 25
    assert np.abs(qpos[-1] - qpos[0]).max() > 0.1


def test_a_task_that_is_not_solved_says_where_and_exits_1(run):
    code, out, _ = run("--task", "rod_carry", "--json", "--set", "scene.task.goal_xy_m=[0.5,-1.2]")
    assert code == 1
    document = json.loads(out)
    assert (document["solved"], document["success"]) == (False, False)
    stages = {row["stage"]: row for row in document["record"]["stages"]}
    assert stages["carry"]["solved_n"] == 0
    assert stages["carry"]["failures"][0]["reason"] == "ik_unreachable"


def test_an_unknown_task_and_a_wrong_ending_exit_2(run, tmp_path):
    code, _, err = run("--task", "rod_cary")
    assert code == 2
    assert "did you mean 'rod_carry'?" in err
    code, _, err = run("--task", "rod_carry", "--video", tmp_path / "rod.gif")
    assert code == 2
    assert "must end in .mp4" in err
