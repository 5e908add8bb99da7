"""The commands of the pipeline ask for what they use, and run again what has changed."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.config.loader import load_config
from minidual.errors import UsageError
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageTable
from minidual.stages.registry import STAGES
from tests.support.pipeline_toys import Toy


class Pipeline:
    """Toys under the names, options, parameters and inputs of the real stages.

    A run of the standard profile is finished up to `carry`.
    """

    def __init__(self, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.root = root
        self.toys = {name: Toy(name) for name in STAGES}
        self.table = StageTable(
            [
                dataclasses.replace(entry, target=self.toys[name], resolve=None, check=None)
                for name, entry in STAGES.items()
            ],
        )
        self._capsys = capsys

    def __call__(self, *words: str) -> tuple[int, str]:
        code = run_command_line([*words, "--runs-dir", str(self.root)], self.table)
        return code, self._capsys.readouterr().err

    @property
    def ran(self) -> dict[str, int]:
        return {name: len(toy.contexts) for name, toy in self.toys.items() if toy.contexts}


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    root = tmp_path_factory.mktemp("carried")
    table = StageTable(
        [
            dataclasses.replace(entry, target=Toy(name), resolve=None, check=None)
            for name, entry in STAGES.items()
        ],
    )
    runner = Runner(table, RunStore(root, "standard"), load_config("standard"))
    for _ in runner.run_until("carry"):
        pass
    return root


@pytest.fixture
def pipeline(carried, tmp_path, capsys):
    shutil.copytree(carried, tmp_path / "runs")
    return Pipeline(tmp_path / "runs", capsys)


METHODS = ["--methods", "moveit,impedance"], ["--set", "benchmark.methods=[moveit, impedance]"]


@pytest.mark.parametrize("words", METHODS)
def test_a_benchmark_without_a_policy_needs_none(pipeline, words):
    code, err = pipeline("benchmark", *words)
    assert code == 0, err
    assert pipeline.ran == {"benchmark": 1}
    assert "NO ACCEPTANCE" in err
    assert "benchmark.methods is moveit, impedance, the profile asks for moveit" in err
    assert "next: minidual teleop-record" in err


@pytest.mark.parametrize("words", [[], ["--methods", "moveit,act"]])
def test_a_benchmark_with_a_policy_needs_it(pipeline, words):
    code, err = pipeline("benchmark", *words)
    assert code == 3
    assert "the gate of benchmark is closed: teleop-record has not run" in err
    assert "minidual run --until deploy" in err
    assert pipeline.ran == {}


def test_a_benchmark_without_a_policy_needs_the_carry(pipeline):
    pipeline.toys["carry"].observed = 0.0
    pipeline("carry", "--force")
    code, err = pipeline("benchmark", "--methods", "moveit,impedance")
    assert code == 3
    assert "the gate of benchmark is closed: carry failed" in err


def test_run_until_the_benchmark_trains_no_policy_that_it_does_not_use(pipeline):
    code, err = pipeline("run", "--until", "benchmark", *METHODS[1])
    assert code == 0, err
    assert pipeline.ran == {"benchmark": 1}


def test_a_table_of_carry_made_again_does_not_cost_the_recording(pipeline):
    assert pipeline("run", "--until", "teleop-record")[0] == 0
    (pipeline.root / "standard" / "carry" / "out" / "numbers.txt").unlink()
    code, err = pipeline("run", "--until", "teleop-record")
    assert code == 0
    assert "teleop-record: pass, fresh" in err
    assert pipeline.ran == {"carry": 1, "teleop-record": 1}


def test_another_result_of_carry_does(pipeline):
    pipeline("run", "--until", "teleop-record")
    pipeline.toys["carry"].observed = 1.5
    pipeline("carry", "--force")
    assert pipeline("run", "--until", "teleop-record")[0] == 0
    assert pipeline.ran == {"carry": 1, "teleop-record": 2}


def test_a_value_by_which_only_trials_are_judged_plans_nothing_again(pipeline):
    code, err = pipeline("carry", "--set", "scene.task.goal_tolerance_m=0.01")
    assert code == 0, err
    assert pipeline.ran == {"carry": 1}
    assert {path.name for path in pipeline.root.iterdir()} == {
        "standard",
        "standard-scene.task.goal_tolerance_m-0.01",
    }


def test_a_value_that_planning_reads_closes_the_gate_of_the_carry(pipeline):
    code, err = pipeline("carry", "--set", "scene.task.lift_height_m=0.2")
    assert code == 3
    assert "the gate of carry is closed: plan is stale" in err or "plan has not run" in err
    assert pipeline.ran == {}


def test_a_wrong_method_is_named_before_the_gate(pipeline):
    def refuse(config):
        raise UsageError(f"no method in {config.benchmark.methods}")

    entry = dataclasses.replace(pipeline.table["benchmark"], check=refuse)
    pipeline.table = StageTable([*list(pipeline.table.values())[:6], entry])
    code, err = pipeline("benchmark", "--methods", "mooveit")
    assert code == 2
    assert "no method in ('mooveit',)" in err
