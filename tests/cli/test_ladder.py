"""The debug ladder: `minidual explain` points at the lowest stage that does not pass.

It does so whatever fails above that stage.
"""

from __future__ import annotations

import json

import pytest

from minidual.cli.app import run_command_line
from minidual.config.loader import load_config
from minidual.gate.check import Check
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageEntry, StageTable
from minidual.stages.registry import STAGES
from tests.support.pipeline_toys import Toy

CHECKS = {
    "env-check": ["joints.count", "tracking.sine_rms_rad"],
    "plan": [
        "left_arm.success_rate",
        "right_arm.time_max_s",
        "second_seed.right_arm.time_p99_s",
        "both_arms.success_rate",
        "engines.agreement",
    ],
    "carry": ["success_rate", "tilt_max_rad"],
    "teleop-record": ["latency_p99_s", "episodes_per_min", "schema_ok", "jerk_rms_max"],
    "train-act": ["loss_ratio"],
    "deploy": ["success_low"],
}
"""A few real checks of each stage; all observe 1.0 against >= 1.0 unless a test changes them."""


class Pipeline:
    """Toys under the names of the real stages, on the real graph, behind the real command line."""

    def __init__(self, root, capsys) -> None:
        self.root = root
        self._capsys = capsys
        self.observed = {(stage, check): 1.0 for stage, names in CHECKS.items() for check in names}
        self.toys = {name: self._toy(name) for name in CHECKS}
        self.table = StageTable(
            [StageEntry(t.name, t, t.requires, f"Toy {t.name}") for t in self.toys.values()],
        )

    def _toy(self, name):
        toy = Toy(name, STAGES[name].requires)
        toy.behaviour = lambda _context: [
            Check(
                check,
                self.observed[name, check],
                ">=",
                1.0,
                "",
                f"{check} protects us",
                f"mend {check}",
            )
            for check in CHECKS[name]
        ]
        return toy

    def run(self, profile="standard"):
        runner = Runner(self.table, RunStore(self.root, "r"), load_config(profile))
        for _ in runner.run_until():
            pass

    def explain(self, *words):
        code = run_command_line(
            ["explain", *words, "--run", "r", "--runs-dir", str(self.root)],
            self.table,
        )
        out = self._capsys.readouterr().out
        assert code == 0
        return out

    def document(self, *words):
        return json.loads(self.explain("--json", *words))


@pytest.fixture
def pipeline(tmp_path, capsys):
    return Pipeline(tmp_path, capsys)


def states(document):
    return [level["state"] for level in document["stages"]]


def test_all_stages_hold(pipeline):
    pipeline.run()
    assert "every stage passes and is fresh" in pipeline.explain()
    document = pipeline.document()
    assert states(document) == ["pass"] * 6
    assert (document["lowest"], document["because"]) == (None, [])


@pytest.mark.parametrize("stage", list(CHECKS))
def test_each_stage_can_be_the_lowest(pipeline, stage):
    check = CHECKS[stage][-1]
    pipeline.observed[stage, check] = 0.5
    pipeline.run()
    text = pipeline.explain()
    assert f"look at {stage} first: the lowest stage that does not pass" in text
    assert f"{stage}: {check} is 0.5, limit >= 1" in text
    assert f"why: {check} protects us" in text
    assert f"remedy: mend {check}" in text
    assert f"next: minidual {stage} --run r --runs-dir {pipeline.root}" in text
    document = pipeline.document()
    place = list(CHECKS).index(stage)
    assert document["lowest"] == stage
    assert states(document)[: place + 1] == ["pass"] * place + ["fail"]


def test_a_nan_fails_its_stage(pipeline):
    pipeline.observed["carry", "tilt_max_rad"] = float("nan")
    pipeline.run()
    assert pipeline.document()["lowest"] == "carry"


def test_nothing_has_run(pipeline):
    (pipeline.root / "r").mkdir(parents=True)
    document = pipeline.document()
    assert states(document) == ["missing"] + ["blocked"] * 5
    assert document["lowest"] == "env-check"
    assert "it has not run" in document["because"][1]
    assert document["next"].startswith("next: minidual env-check")


def test_what_went_stale_below_is_looked_at_first(pipeline):
    pipeline.observed["deploy", "success_low"] = 0.1
    pipeline.run()
    (pipeline.root / "r" / "plan" / "out" / "numbers.txt").write_text("tampered")
    document = pipeline.document()
    assert document["lowest"] == "plan"
    assert "plan is stale" in document["because"][0]
    assert document["next"].startswith("next: minidual plan")


def test_a_smoke_run_is_marked(pipeline):
    pipeline.run("smoke")
    assert pipeline.explain("--profile", "smoke").count("a quick test") == 1


def test_a_stage_that_does_not_pass_is_explained_with_the_one_to_look_at(pipeline):
    pipeline.observed["carry", "tilt_max_rad"] = 0.5
    pipeline.run()
    text = pipeline.explain("deploy")
    assert "deploy is blocked" in text
    assert "look at carry first" in text
    assert pipeline.document("deploy")["lowest"] == "carry"
    assert "first: the lowest" not in pipeline.explain("plan")  # it passes
