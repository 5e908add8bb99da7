"""The debug ladder: `minidual explain` points at the lowest level that does not hold, whatever fails above it."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from pipeline_toys import Bench, Toy

from minidual.cli import run_command_line
from minidual.config.loader import load_config
from minidual.gate.check import Check
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageEntry, StageTable
from minidual.stages.ladder import LADDER, owner
from minidual.stages.registry import STAGES

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
"""A few real names of each stage; all observed as 1.0 against >= 1.0 until a test says otherwise."""


class Pipeline:
    """Toys under the names of the real stages, on the real graph, behind the real command line."""

    def __init__(self, root, capsys) -> None:
        self.root, self._capsys = root, capsys
        self.observed = {(stage, check): 1.0 for stage, names in CHECKS.items() for check in names}
        self.toys = {name: self._toy(name) for name in CHECKS}
        self.table = StageTable([StageEntry(t.name, t, t.requires, t.summary) for t in self.toys.values()])

    def _toy(self, name):
        toy = Toy(name, STAGES[name].requires)
        toy.behaviour = lambda _context: [
            Check(check, self.observed[name, check], ">=", 1.0, "", f"{check} protects us", f"mend {check}")
            for check in CHECKS[name]
        ]
        return toy

    def run(self, profile="standard"):
        runner = Runner(self.table, RunStore(self.root, "r"), load_config(profile))
        for _ in runner.run_until():
            pass

    def explain(self, *words):
        code = run_command_line(["explain", *words, "--run", "r", "--runs-dir", str(self.root)], self.table)
        out = self._capsys.readouterr().out
        assert code == 0
        return out

    def document(self, *words):
        return json.loads(self.explain("--json", *words))


@pytest.fixture
def pipeline(tmp_path, capsys):
    return Pipeline(tmp_path, capsys)


def standings(document):
    return [level["standing"] for level in document["levels"]]


def test_all_levels_hold(pipeline):
    pipeline.run()
    assert "every level holds" in pipeline.explain()
    document = pipeline.document()
    assert standings(document) == ["holds"] * 6
    assert (document["lowest"], document["next"]) == (None, None)


@pytest.mark.parametrize(
    ("stage", "check", "level"),
    [
        ("env-check", "tracking.sine_rms_rad", 0),
        ("plan", "right_arm.time_max_s", 1),
        ("plan", "both_arms.success_rate", 2),
        ("carry", "tilt_max_rad", 2),
        ("teleop-record", "latency_p99_s", 3),
        ("teleop-record", "jerk_rms_max", 4),
        ("train-act", "loss_ratio", 5),
        ("deploy", "success_low", 5),
    ],
)
def test_each_level_can_fail(pipeline, stage, check, level):
    pipeline.observed[stage, check] = 0.5
    pipeline.run()
    text = pipeline.explain()
    assert f"look at level {level}, {LADDER[level].name}: the lowest that does not hold" in text
    assert f"{stage}: {check} is 0.5, limit >= 1" in text
    assert f"why: {check} protects us" in text
    assert f"remedy: mend {check}" in text
    assert f"next: minidual {stage} --run r --runs-dir {pipeline.root}" in text
    document = pipeline.document()
    assert document["lowest"] == level
    assert standings(document)[:level] == ["holds"] * level
    assert standings(document)[level] == "fails"


def test_a_nan_fails_its_level(pipeline):
    pipeline.observed["carry", "tilt_max_rad"] = float("nan")
    pipeline.run()
    assert pipeline.document()["lowest"] == 2


def test_the_lower_of_two_levels_of_one_stage_comes_first(pipeline):
    pipeline.observed["plan", "left_arm.success_rate"] = pipeline.observed["plan", "both_arms.success_rate"] = 0.9
    pipeline.run()
    document = pipeline.document()
    assert document["lowest"] == 1
    assert standings(document)[:3] == ["holds", "fails", "fails"]
    assert "left_arm.success_rate" in document["because"][0]


def test_nothing_has_run(pipeline):
    document = pipeline.document()
    assert standings(document) == ["unproven"] * 6
    assert document["lowest"] == 0
    assert "it has not run" in document["because"][1]
    assert document["next"].startswith("minidual env-check")


def test_what_went_stale_below_is_looked_at_first(pipeline):
    pipeline.observed["deploy", "success_low"] = 0.1
    pipeline.run()
    out = pipeline.root / "r" / "plan" / "out" / "numbers.txt"
    out.write_text("tampered")
    document = pipeline.document()
    assert document["lowest"] == 1
    assert "plan is stale" in document["because"][0]
    assert document["next"].startswith("minidual plan")


def test_a_blocked_level_names_what_blocks_it(pipeline):
    pipeline.run()
    (pipeline.root / "r" / "teleop-record" / "out" / "numbers.txt").write_text("tampered")
    document = pipeline.document()
    assert document["lowest"] == 3
    deploy = document["levels"][5]["proofs"][1]
    assert deploy["state"] == "stale"
    assert document["next"].startswith("minidual teleop-record")


def test_a_level_without_checks_is_not_proved(pipeline, monkeypatch):
    monkeypatch.setitem(CHECKS, "teleop-record", ["schema_ok", "jerk_rms_max"])
    pipeline.run()
    document = pipeline.document()
    assert document["lowest"] == 3
    assert document["because"] == ["teleop-record: its verdict holds no check for this level"]


def test_a_smoke_run_is_marked(pipeline):
    pipeline.run("smoke")
    assert "wiring only" in pipeline.explain("--profile", "smoke")


def test_a_failing_stage_is_explained_with_the_level_to_look_at(pipeline):
    pipeline.observed["carry", "tilt_max_rad"] = 0.5
    pipeline.run()
    text = pipeline.explain("deploy")
    assert "deploy is blocked" in text
    assert "look at level 2, both arms" in text
    assert pipeline.document("deploy")["ladder"]["lowest"] == 2
    assert "look at level" not in pipeline.explain("plan")  # it passes


def test_stages_that_are_not_on_the_ladder_ask_for_a_name(tmp_path, capsys):
    code = run_command_line(["explain", "--runs-dir", str(tmp_path)], Bench(tmp_path).table)
    assert code == 2
    assert "name a stage; there are first, second, third" in capsys.readouterr().err


class TestTable:
    def test_levels_are_numbered_from_the_bottom_and_their_stages_exist(self):
        assert [level.number for level in LADDER] == list(range(6))
        proofs = [(level.number, proof.stage) for level in LADDER for proof in level.proofs]
        order = [STAGES.names.index(stage) for _, stage in proofs]
        assert order == sorted(order)  # a level never rests on a later stage than the level above it

    def test_every_stage_but_those_that_compare_and_report_is_on_it(self):
        on_ladder = {proof.stage for level in LADDER for proof in level.proofs}
        core = {"env-check", "plan", "carry", "teleop-record", "train-act", "deploy"}
        assert on_ladder == core

    def test_every_check_of_a_stage_has_one_level_whatever_its_name(self):
        for level in LADDER:
            for proof in level.proofs:
                assert owner(proof.stage, "a_check_of_tomorrow") is not None
        found = Counter(owner(stage, check) for stage, names in CHECKS.items() for check in names)
        assert set(found) == set(range(6))
        assert owner("report", "anything") is None
