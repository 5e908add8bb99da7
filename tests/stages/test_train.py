"""`minidual train METHOD` trains any method that has a trainer, and tries it on fresh starts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from minidual.config.base import StrictModel
from minidual.errors import ExitCode, UsageError
from minidual.gate.stage import ToolContext
from minidual.registry import Deferred
from minidual.stages import train as train_module
from minidual.stages.train import CURVE, FIGURE, RECORD, train
from minidual.trials.methods import METHODS, MethodSpec
from minidual.trials.trainer import TrainingJob, TrainingSummary
from tests.support import trial_results
from tests.support.tool_contexts import tool_context

STEPS = 40


class Scholar:
    """Writes a policy that names its seed."""

    jobs: list[TrainingJob]

    def __init__(self) -> None:
        self.jobs = []

    def check(self, config: Any) -> None:
        if config.task == "sort":
            raise UsageError("it cannot learn to sort")

    def steps(self, config: Any) -> int:
        return STEPS

    def train(self, job: TrainingJob) -> TrainingSummary:
        self.jobs.append(job)
        job.advance(STEPS, "done")
        checkpoint = job.folder / "checkpoint"
        checkpoint.mkdir()
        (checkpoint / "config.json").write_text(json.dumps({"seed": job.seed}))
        curve = [{"step": 0.0, "rate": 0.1}, {"step": float(STEPS)}]
        numbers = {"steps": STEPS, "processor_s": 6.0, "loss": float("nan")}
        return TrainingSummary(STEPS, 0, numbers, curve, {"rate": "success"})


@pytest.fixture
def scholar(monkeypatch: pytest.MonkeyPatch) -> Scholar:
    """A method that learns; its trials succeed where the start is even."""
    trainer = Scholar()
    row = MethodSpec(
        METHODS["hold"].build,
        "learns",
        config=StrictModel,
        learned=True,
        trainer=Deferred(lambda: trainer),
    )
    monkeypatch.setattr(METHODS, "_rows", {**METHODS._rows, "scholar": row})

    def run(method: str, inputs: Any, trials: Any, **_: Any) -> Any:
        assert (inputs.checkpoint / "config.json").is_file()
        for trial in trials:
            yield trial_results.result(trial.index, success=trial.index % 2 == 0, method=method)

    monkeypatch.setattr(train_module, "run_trials", run)
    return trainer


def context(tmp_path: Path, task: str = "pot_lift", **options: Any) -> ToolContext:
    return tool_context(tmp_path, "train", task, **options)


def test_a_training_leaves_policy_curve_figure_and_record(
    tmp_path: Path,
    scholar: Scholar,
) -> None:
    result = train(context(tmp_path, method="scholar", trials=5))
    folder = tmp_path / "run" / "train" / "scholar" / "pot_lift"
    record = json.loads((folder / RECORD).read_text())
    assert record["success"] == {"clean": {"successes": 3, "trials": 5}}
    assert record["loss"] is None
    assert (folder / "checkpoint" / "config.json").is_file()
    assert (folder / CURVE).read_text().splitlines()[0] == "step,rate"
    assert (folder / FIGURE).read_text().startswith("<?xml")
    assert any("3 of 5" in line for line in result.lines)
    assert any("minidual try pot_lift --method moveit,impedance,scholar" in x for x in result.lines)
    assert result.exit_code is ExitCode.PASS


def test_each_seed_has_a_training_of_its_own(tmp_path: Path, scholar: Scholar) -> None:
    result = train(context(tmp_path, method="scholar", seeds=3, trials=2))
    seeds = [job.seed for job in scholar.jobs]
    assert len(set(seeds)) == 3
    folder = tmp_path / "run" / "train" / "scholar" / "pot_lift"
    for k, place in enumerate((folder, folder / "seed-2", folder / "seed-3")):
        policy = json.loads((place / "checkpoint" / "config.json").read_text())
        assert policy["seed"] == seeds[k]
    assert len(result.data["trainings"]) == 3
    assert len({job.progress for job in scholar.jobs}) == 3


def test_a_policy_of_another_task_stays(tmp_path: Path, scholar: Scholar) -> None:
    train(context(tmp_path, method="scholar", trials=0))
    train(context(tmp_path, "rod_carry", method="scholar", trials=0))
    for task in ("pot_lift", "rod_carry"):
        folder = tmp_path / "run" / "train" / "scholar" / task
        assert (folder / "checkpoint" / "config.json").is_file()


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        ("pot_lift", {"method": "moveit"}, "the method 'moveit' learns nothing; there are act,"),
        ("pot_lift", {"method": "scholarr"}, "no method 'scholarr'"),
        ("sort", {"method": "scholar"}, "it cannot learn to sort"),
        ("pot_lift", {"method": "scholar", "seeds": 0}, "--seeds is 0; 1 <= value <= 10"),
        ("pot_lift", {"method": "scholar", "trials": -1}, "--trials is -1; 0 <= value"),
        ("pot_lift", {"method": "scholar", "conditions": "cleen"}, "no condition 'cleen'"),
    ],
)
def test_what_cannot_be_trained_is_refused(
    tmp_path: Path,
    scholar: Scholar,
    task: str,
    options: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises(UsageError, match=message):
        train(context(tmp_path, task, **options))
    assert not scholar.jobs
