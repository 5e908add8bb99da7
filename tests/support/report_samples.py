"""A made-up run for the report's tests: verdicts and artefacts of every stage, on disk as a run leaves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.durable import write_csv
from minidual.gate.check import Check
from minidual.gate.fingerprint import Fingerprint
from minidual.gate.stage import StageContext
from minidual.gate.verdict import Verdict, Waiver, build_manifest
from minidual.show.report.figures import Figure, TrialRow, benchmark_figures
from minidual.show.report.tables import Tables
from minidual.show.report.words import Words
from minidual.trials.benchmark import BenchmarkCell, conditions_data
from minidual.trials.comparisons import compare_all, compare_with_clean
from minidual.trials.contrasts import contrast_all
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise

METHODS = ("moveit", "impedance", "act")
TASK = "rod_carry"
STAGES = (
    (
        "env-check",
        "Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries",
    ),
    ("plan", "Plan collision-free motions for left_arm, right_arm and both_arms"),
    ("carry", "Carry an object with both arms under object impedance control"),
    ("teleop-record", "Teleoperate, record demonstrations, convert and grade the dataset"),
    ("train-act", "Train the policy on the recorded dataset"),
    ("deploy", "Let the policy drive the arms on seeds it never saw"),
    ("benchmark", "Compare the methods on the same task, seeds and success test"),
)
WAIVER = Waiver("carry", "the gripper is being repaired", {"plan": "fail"}, "2026-01-31T12:00:00Z")

_CHECKS: dict[str, list[Check]] = {
    "env-check": [
        Check("joints.count", 14, "==", 14, why="both arms have seven joints"),
        Check(
            "tracking.step_error_rad",
            0.0021,
            "<",
            0.05,
            "rad",
            "the controller reaches where it is sent",
        ),
        Check("control.step_median_us", 171.0, "<", 1000.0, "us", "1 kHz leaves 1000 us a step"),
    ],
    "plan": [
        Check("both_arms.success_rate", 1.0, ">=", 1.0, why="every query is solved"),
        Check("both_arms.time_max_s", 0.41, "<", 10.0, "s", "a person waits no longer"),
    ],
    "carry": [
        Check(
            "success_rate",
            1.0,
            ">",
            0.8,
            why="share of trials that carried the rod to its goal",
        ),
        Check("tilt_max_rad", 0.0436, "<", 0.08727, "rad", "a tilted rod slips or spills"),
        Check("internal_force_min_n", 36.2, ">", 20.0, "N", "below it the rod may slip"),
        Check("torque_ratio_max", 0.79, "<", 1.0, why="at 1 the drive saturates"),
    ],
    "teleop-record": [Check("jerk_rms_max", 14.1, "<", 200.0, "rad/s^3", "smooth demonstrations")],
    "train-act": [
        Check("loss_ratio", 0.11, "<", 0.5, why="it must have learned something"),
        Check("samples_per_s", 402.0, unit="1/s", why="training rate"),
    ],
    "deploy": [
        Check(
            "success_rate",
            0.78,
            ">",
            0.5,
            why="closed-loop success on starts held out from training",
        ),
        Check("success_low", 0.65, why="lower end of its 95 % Wilson interval"),
        Check("success_high", 0.87, why="upper end of its 95 % Wilson interval"),
        Check("training_success_rate", 0.95, why="the same on starts it was trained on"),
    ],
}


_DEPLOY = {
    "trials": 60,
    "successes_n": 47,
    "success_low": 0.65,
    "success_high": 0.87,
    "failures": {"arrived": 13},
}
_ROOM = {
    **_DEPLOY,
    "successes_n": 45,
    "success_low": 0.63,
    "failures": {"arrived": 15},
    "by_seed": [0.8, 0.65, 0.8],
}

_DRAWN: dict[str, list[Figure]] = {}


@pytest.fixture(autouse=True)
def figures_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw equal figures once in all tests: drawing takes most of a report's time."""

    def drawn(tables: Tables, trials: list[TrialRow], words: Words) -> list[Figure]:
        key = repr((tables, trials, words.language))
        if key not in _DRAWN:
            _DRAWN[key] = benchmark_figures(tables, trials, words)
        return _DRAWN[key]

    monkeypatch.setattr("minidual.show.report.page.benchmark_figures", drawn)


def make_trials(n: int = 20) -> list[TrialMetrics]:
    """Return `n` trials a method: impedance always succeeds, moveit fails once, act every fourth time."""
    rng = np.random.default_rng(3)
    spread = {
        "moveit": (10.2, 0.71, 55.0, 0.021),
        "impedance": (8.9, 0.76, 38.0, 0.035),
        "act": (9.6, 0.88, 120.0, 0.03),
    }
    rows = []
    for method, (time_s, torque, jerk, tilt) in spread.items():
        for index in range(n):
            failed = (method == "act" and index % 4 == 1) or (method == "moveit" and index == 7)
            slack = rng.normal(size=5)
            rows.append(
                TrialMetrics(
                    method=method,
                    index=index,
                    condition="clean",
                    success=not failed,
                    failure=("arrived" if index % 8 == 1 else "held") if failed else "",
                    reason="it missed" if failed else "",
                    failed_at_s=6.0 + slack[0] if failed else float("nan"),
                    duration_s=float("nan") if failed else time_s + 0.3 * slack[1],
                    torque_ratio_max=torque + 0.02 * slack[2],
                    jerk_rms=jerk * (1 + 0.08 * slack[3]),
                    tilt_max_rad=tilt * (1 + 0.2 * abs(slack[4])),
                    path_length_m=1.62 + 0.05 * slack[0],
                    internal_force_min_n=36.0,
                    pinch_force_min_n=41.0,
                    goal_error_m=0.004,
                ),
            )
    return rows


_SUMMARIES: dict[str, MethodSummary] = {}


def _summary(trials: Sequence[TrialMetrics]) -> MethodSummary:
    """Return the summary of `trials`; the same trials are summarised once."""
    key = repr(trials)
    if key not in _SUMMARIES:
        _SUMMARIES[key] = summarise(trials, np.random.default_rng(0))
    return _SUMMARIES[key]


def methods_data(trials: Sequence[TrialMetrics]) -> dict[str, dict[str, Any]]:
    """Return data["methods"] of the benchmark's verdict for `trials`."""
    table = {}
    for method in METHODS:
        table[method] = _summary([trial for trial in trials if trial.method == method]).record()
    return table


CONDITIONS = ("clean", "push +x", "delay 20 ms")
_WHY_NOT = {
    ("moveit", "delay 20 ms"): "moveit reads no force",
    ("act", "delay 20 ms"): "act reads no force",
}


def disturbed_trials(n: int = 20) -> list[TrialMetrics]:
    """Return `make_trials` and the same under two conditions: a push costs act every trial, and the others none."""
    clean = make_trials(n)
    rows = list(clean)
    for condition in CONDITIONS[1:]:
        for trial in clean:
            if (trial.method, condition) in _WHY_NOT:
                continue
            lost = trial.method == "act"
            rows.append(
                replace(
                    trial,
                    condition=condition,
                    success=trial.success and not lost,
                    failure="held" if lost else trial.failure,
                    reason="lost it" if lost else trial.reason,
                    aborted="it let go" if lost else "",
                    failed_at_s=4.0 if lost else trial.failed_at_s,
                    duration_s=float("nan") if lost else trial.duration_s + 0.5,
                ),
            )
    return rows


def benchmark_data(trials: Sequence[TrialMetrics]) -> dict[str, Any]:
    """Return the data of the benchmark's verdict for `trials`, as the stage leaves them."""
    cells = []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        for method in METHODS:
            mine = [t for t in trials if (t.method, t.condition) == (method, condition)]
            summary = _summary(mine) if mine else None
            why = "" if mine else _WHY_NOT[method, condition]
            cells.append(BenchmarkCell(method, condition, len(mine), summary, why))
    clean = [trial for trial in trials if trial.condition == "clean"]
    return {
        "methods": methods_data(clean),
        "conditions": conditions_data(cells),
        "comparisons": compare_all(trials),
        "contrasts": [contrast.to_row() for contrast in contrast_all(trials)],
        "losses": compare_with_clean(trials),
    }


def make_verdict(
    stage: str,
    folder: Path,
    checks: Sequence[Check],
    data: Mapping[str, Any],
    **other: Any,
) -> Verdict:
    """Return a verdict over the files in `folder`."""
    number = [name for name, _ in STAGES].index(stage)
    fingerprint = Fingerprint(
        parameters={},
        options={},
        inputs={},
        upstream={},
        seed=20260,
        profile="standard",
        version="0.1.0",
        commit="0123456789abcdef0123456789abcdef01234567",
        machine={
            "system": "Linux",
            "architecture": "x86_64",
            "processor": "Some CPU",
            "cores": 2,
            "python": "3.12.1",
        },
        libraries={"numpy": "2.2.6", "mujoco": "4.0.0", "torch": "2.11.0"},
    )
    return replace(
        Verdict(
            stage=stage,
            run="standard",
            fingerprint=fingerprint,
            checks=tuple(checks),
            artefacts=build_manifest(folder),
            acceptance_profile=True,
            started_at=f"2026-01-31T12:{number:02d}:00Z",
            finished_at=f"2026-01-31T12:{number:02d}:50Z",
            duration_s=31.0 * (number + 1) ** 1.6,
            data=dict(data),
        ),
        **other,
    )


def make_run(root: Path, trials: Sequence[TrialMetrics] | None = None) -> StageContext:
    """Write a run under `root` and return what the report is built from."""
    trials = make_trials() if trials is None else trials
    verdicts = {}
    folders = {}
    for stage, _summary in STAGES:
        folder = root / stage
        folder.mkdir(parents=True)
        checks = _CHECKS.get(stage, [])
        data = {**_DEPLOY, "room": _ROOM} if stage == "deploy" else {}
        if stage == "train-act":
            data = {"architecture": "keyframe_act"}
        if stage == "benchmark":
            write_csv(folder / "benchmark.csv", [{"task": TASK, **t.to_row()} for t in trials])
            data = {"tasks": {TASK: benchmark_data(trials)}}
            checks = [
                Check(f"{method}.success_rate", row["success_rate"], ">", 0.5, why="it works")
                for method, row in data["tasks"][TASK]["methods"].items()
            ]
        verdicts[stage] = make_verdict(stage, folder, checks, data)
        folders[stage] = folder
    conditions = list(dict.fromkeys(trial.condition for trial in trials))
    config = Config.model_validate(
        {
            "acceptance": True,
            "report": {"title": "A made-up run"},
            "benchmark": {"methods": METHODS, "conditions": conditions},
        },
    )
    return StageContext(
        folder=root,
        config=config,
        seed=20260,
        profile="standard",
        upstream=folders,
        verdicts=verdicts,
        summaries=dict(STAGES),
    )


def with_methods(given: StageContext, table: Mapping[str, Any]) -> StageContext:
    """Return the run with another table of methods in the benchmark's verdict."""
    return with_data(
        given,
        {**given.verdicts["benchmark"].data["tasks"][TASK], "methods": dict(table)},
    )


def with_data(given: StageContext, data: Mapping[str, Any]) -> StageContext:
    """Return the run with other data of the task in the benchmark's verdict."""
    benchmark = replace(given.verdicts["benchmark"], data={"tasks": {TASK: dict(data)}})
    return replace(given, verdicts={**given.verdicts, "benchmark": benchmark})
