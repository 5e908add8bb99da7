"""`make results`: where its numbers come from, what it refuses, and what the pages quote of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from minidual.config.loader import load_config
from minidual.config.root import changed
from minidual.errors import DataError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.check import Check
from minidual.gate.code import Code
from minidual.gate.verdict import Verdict
from minidual.show.report.bench import BenchRecord, BenchRow, BenchTable, read_bench, write_bench
from minidual.tasks.task import Trial
from minidual.trials.metrics import TrialMetrics
from scripts.results import __main__ as results
from scripts.results import benches, five_tasks, standard, trainings, trials
from scripts.results.blocks import blocks, with_blocks
from scripts.results.markdown import Origin, origin, origin_line, table
from scripts.results.quotes import stale_quotes
from scripts.results.trials import Cell, Plan, StoredTrial, run_cell, stored_trials
from tests.support.report_samples import make_verdict
from tests.support.trial_results import BAD, result

MADE = Origin("0123abcd", "Some CPU, 2 cores", "2026-01-31")
PAGE = """# Results

## Tasks

<!-- results: tasks -->

Starts 2000 to 2099: 87 of 100.

<!-- /results -->

## Policies

8 of 100, 1,234 steps.
"""
PAGE_OF_ONE = f"{PAGE}\n<!-- results: tasks-rod_carry -->\n<!-- /results -->\n"


def plan(folder: Path, **changes: Any) -> Plan:
    """Return a plan of two methods on the rod, three starts each."""
    settings: dict[str, Any] = {
        "config": load_config().config,
        "tasks": ("rod_carry",),
        "methods": ("moveit", "impedance", "act"),
        "first": 2000,
        "trials_n": 3,
        "policies": {},
        "folder": folder,
    }
    return Plan(**{**settings, **changes})


CELL = Cell("rod_carry", "moveit", "clean")
_REAL_PAGES = results.PAGES


@pytest.fixture(autouse=True)
def real_pages_stay() -> Iterator[None]:
    """Fail a test that writes its toys into README or docs."""
    before = [page.read_bytes() for page in _REAL_PAGES]
    yield
    assert [page.read_bytes() for page in _REAL_PAGES] == before


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Replace the trials by toys, of which start 2001 fails; return the starts that ran."""
    starts: list[int] = []

    def toys(_method: str, _inputs: object, rows: Sequence[Trial], **_: Any) -> Iterator[Any]:
        for trial in rows:
            starts.append(trial.index)
            yield result(trial.index, **(BAD if trial.index == 2001 else {}))

    monkeypatch.setattr(trials, "run_trials", toys)
    return starts


def nothing(_: TrialMetrics) -> None:
    """Ignore a result."""


# Blocks


def test_a_block_is_filled_and_the_rest_of_the_page_stays() -> None:
    filled = with_blocks(PAGE, {"tasks": "| a |", "other": "b"})
    assert blocks(filled) == {"tasks": "| a |"}
    assert filled.partition("## Policies")[2] == PAGE.partition("## Policies")[2]
    assert with_blocks(PAGE, {"other": "b"}) == PAGE


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (PAGE + PAGE, "stands twice"),
        (PAGE.replace("<!-- /results -->", ""), "no other end"),
        (PAGE.replace("<!-- results: tasks -->\n", ""), "no other end"),
    ],
)
def test_damaged_marks_are_refused(text: str, reason: str) -> None:
    with pytest.raises(DataError, match=reason):
        blocks(text)


def test_a_table_refuses_a_row_of_another_length() -> None:
    assert table(["", "n"], [["a", "1"]]) == "| | n |\n|---|---|\n| a | 1 |"
    with pytest.raises(ValueError, match="1 cells under 2 headers"):
        table(["", "n"], [["a"]])


def test_an_origin_says_commit_machine_date_and_command() -> None:
    machine = {"processor": "Some CPU", "cores": 2}
    made = origin("0123abcdef+changes", machine, "2026-01-31T12:00:00Z")
    assert made == Origin("0123abcd+changes", "Some CPU, 2 cores", "2026-01-31")
    later = MADE._replace(commit="4567abcd", date="2026-02-01")
    line = origin_line([MADE, later, MADE], "make results")
    assert " ".join(line.split()) == (
        "0123abcd and 4567abcd; Some CPU, 2 cores; 2026-01-31 to 2026-02-01; `make results`"
    )


# The five-task table


@pytest.mark.parametrize("first", [-1, 0, 999])
def test_starts_that_development_has_seen_are_refused(first: int, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="seen by development"):
        plan(tmp_path, first=first)


def test_no_trials_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="at least 1"):
        plan(tmp_path, trials_n=0)


def test_a_policy_has_cells_only_in_its_task(tmp_path: Path) -> None:
    without = plan(tmp_path, tasks=("rod_carry", "sort"))
    assert {cell.method for cell in without.cells} == {"moveit", "impedance"}
    trained = replace(without, policies={"sort": tmp_path})
    assert {cell.task for cell in trained.cells if cell.method == "act"} == {"sort"}


def test_an_interrupted_cell_goes_on(tmp_path: Path, drawn: list[int]) -> None:
    """Finished trials stay; a line that was cut short is run again."""
    asked = plan(tmp_path)

    def interrupt(last: TrialMetrics) -> None:
        if last.index == 2001:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cell(asked, CELL, 1, interrupt)
    path = asked.path(CELL)
    with path.open("a", encoding="utf-8") as file:
        file.write('{"index": 2002, "succ')
    assert [trial.index for trial in stored_trials(path)] == [2000, 2001]
    run_cell(asked, CELL, 1, nothing)
    assert drawn == [2000, 2001, 2002]
    stored = stored_trials(path)
    assert [(trial.index, trial.success) for trial in stored] == [
        (2000, True),
        (2001, False),
        (2002, True),
    ]
    assert stored[1].failure == "held"
    run_cell(asked, CELL, 1, nothing)
    assert len(drawn) == 3


def test_trials_of_other_code_or_settings_are_not_continued(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = plan(tmp_path)
    path = asked.path(CELL)
    other_seed = replace(asked, config=changed(asked.config, {"seed": 7}))
    assert other_seed.path(CELL) != path
    assert plan(tmp_path).path(CELL) == path

    other = Code({"minidual.trials.runner": "changed"})
    monkeypatch.setattr(trials, "code_of", lambda _: other)
    assert asked.path(CELL) != path


def test_the_task_table_waits_for_every_cell(tmp_path: Path, drawn: list[int]) -> None:
    asked = plan(tmp_path)
    *others, last = asked.cells
    for cell in others:
        run_cell(asked, cell, 1, nothing)
    run_cell(replace(asked, trials_n=2), last, 1, nothing)
    assert five_tasks.block(asked) is None
    run_cell(asked, last, 1, nothing)
    block = five_tasks.block(asked) or ""
    assert "Starts 2000 to 2002, successes of 3." in block
    command = 'make results ARGS="--only tasks --first 2000 --trials 3 --tasks rod_carry"'
    assert command in " ".join(block.split())
    rates = "2 (21-94 %) | 2 (21-94 %) | 2 (21-94 %) | 2 (21-94 %)"
    assert block.splitlines()[-1] == f"| `rod_carry` | {rates} | 0, 0 (p = 1) |"


def test_a_policy_is_named_with_its_network(tmp_path: Path, drawn: list[int]) -> None:
    checkpoint = tmp_path / "run" / "train-act" / "checkpoint"
    checkpoint.mkdir(parents=True)
    (checkpoint / "model.safetensors").write_bytes(b"weights")
    (checkpoint.parent / "train.json").write_text('{"architecture": "keyframe_act"}')
    asked = plan(tmp_path, methods=("act",), policies={"rod_carry": checkpoint})
    for cell in asked.cells:
        run_cell(asked, cell, 1, nothing)
    block = five_tasks.block(asked) or ""
    assert "| `act` (`keyframe_act`) clean |" in block
    assert "only `moveit`" not in block


def test_pairs_are_counted_on_shared_starts() -> None:
    def stored(*successes: bool) -> list[StoredTrial]:
        return [StoredTrial(k, success, "", "", MADE) for k, success in enumerate(successes)]

    pair = five_tasks.pair_text(stored(True, True, False), stored(False, True, False))
    assert pair == "1, 0 (p = 1)"
    many = five_tasks.pair_text(stored(*[True] * 20), stored(*[False] * 20))
    assert many == "20, 0 (p < 0.0001)"
    assert five_tasks.rate_text([]) == ""


def test_published_starts_are_not_measured_again(tmp_path: Path, drawn: list[int]) -> None:
    """Those of this measurement may be continued, and published again."""
    for first in (1950, 2000, 2099):
        with pytest.raises(UsageError, match="2000 to 2099 are published") as error:
            five_tasks.check_fresh(plan(tmp_path, first=first, trials_n=60), PAGE)
        assert error.value.remedy == "--first 2100"
    five_tasks.check_fresh(plan(tmp_path, first=2100), PAGE)
    run_cell(plan(tmp_path), CELL, 1, nothing)
    five_tasks.check_fresh(plan(tmp_path), PAGE)
    assert drawn == [2000, 2001, 2002]


def test_one_task_alone_has_a_block_of_its_own(tmp_path: Path) -> None:
    """Its starts are published ones as well."""
    alone = plan(tmp_path, tasks=("sort",), first=2150)
    both = plan(tmp_path, tasks=("rod_carry", "sort"), first=2150)
    assert five_tasks.block_name(alone) == "tasks-sort"
    assert five_tasks.block_name(both) == "tasks"
    published = with_blocks(
        f"{PAGE}\n<!-- results: tasks-sort -->\n<!-- /results -->\n",
        {"tasks-sort": "Starts 2150 to 2169, successes of 20."},
    )
    with pytest.raises(UsageError, match="2150 to 2169 are published"):
        five_tasks.check_fresh(both, published)


# A standard run


def record(**changes: Any) -> dict[str, Any]:
    """Return the record of a cell of the benchmark."""
    return {
        "applies": True,
        "successes_n": 50,
        "trials": 50,
        "duration_median_s": 5.754,
        "torque_ratio_max": 0.687,
        "jerk_rms_median": 46.2,
        "tilt_max_rad": 0.0007,
        "path_length_m": 1.391,
        **changes,
    }


_CHECKS: dict[str, dict[str, Any]] = {
    "env-check": {
        "joints.mapped": 14,
        "tracking.step_error_rad": 3e-14,
        "tracking.sine_rms_rad": 0.0004,
    },
    "plan": {
        "both_arms.success_rate": 1.0,
        "left_arm.success_rate": 0.995,
        "closed_chain.success_rate": 1.0,
        "closed_chain.driven_n": 6,
        "closed_chain.executed_error_max_m": 0.0013,
        "proof.audit_states": 884986,
        "proof.audit_collisions": 0,
    },
    "carry": {
        "tilt_max_rad": 0.0007,
        "internal_force_min_n": 39.61,
        "duration_median_s": 6.7,
        "duration_max_s": 7.1,
        "torque_ratio_max": 0.94,
    },
    "teleop-record": {
        "episodes": 150,
        "attempts": 150,
        "jerk_rms_max": 24.0,
        "latency_p99_s": 0.0044,
        "episodes_per_min": 43.0,
    },
    "train-act": {"steps_done": 7000, "validation_keyframe_rad": 0.0068},
    "deploy": {"inference_hz": 463.0},
    "benchmark": {"rod_carry.trials_per_method": 50},
    "report": {"missing_cells": 0},
}
_SET = {"successes_n": 99, "trials": 100}
_DATA: dict[str, dict[str, Any]] = {
    "carry": {"successes_n": 200, "trials": 200},
    "train-act": {"architecture": "keyframe_act"},
    "deploy": {
        "successes_n": 100,
        "trials": 100,
        "room": _SET,
        "object hidden": {"successes_n": 0, "trials": 5},
    },
    "benchmark": {
        "tasks": {
            "rod_carry": {
                "methods": {"moveit": record(), "act": record()},
                "conditions": {
                    "moved 20 mm": {
                        "methods": {
                            "moveit": record(successes_n=19, trials=20),
                            "act": {"applies": False, "why": "it sees"},
                        },
                    },
                    "randomised": {
                        "methods": {
                            "moveit": record(successes_n=57, trials=60),
                            "act": record(successes_n=60, trials=60),
                        },
                    },
                },
            },
            "sort": {
                "methods": {
                    "moveit": record(successes_n=6, trials=6),
                    "act": {"applies": False, "why": "it has no policy for the task"},
                },
                "conditions": {},
            },
        },
    },
}


def write_stage(
    run: Path,
    stage: str,
    checks: list[Check],
    data: dict[str, Any],
    **other: Any,
) -> None:
    """Write the verdict of a stage."""
    folder = run / stage
    folder.mkdir(parents=True, exist_ok=True)
    verdict: Verdict = replace(make_verdict("deploy", folder, checks, data, **other), stage=stage)
    (folder / "verdict.json").write_text(dumps(verdict.to_json()), encoding="utf-8")
    starts = "deploy: {first_start: 4000}\nbenchmark: {first_start: 5000}\n"
    (folder / "config.yaml").write_text(starts, encoding="utf-8")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished standard run."""
    for stage, numbers in _CHECKS.items():
        checks = [Check(name, value, why="made up") for name, value in numbers.items()]
        checks.append(Check("holds", 1, "==", 1, why="made up"))
        write_stage(tmp_path / "run", stage, checks, _DATA.get(stage, {}))
    return tmp_path / "run"


def test_the_tables_of_a_standard_run_hold_its_numbers(run: Path) -> None:
    made = standard.blocks(run) or {}
    stages = made["standard"]
    for words in (
        "01234567; Some CPU, 2 cores; 2026-01-31; `make all`",
        "14 joints mapped and driven; step error 3e-14 rad",
        "99.5 % of queries proven; 884,986 audited states, 0 in collision",
        "6 of them driven, within 1.3 mm",
        "200 of 200; tilt at most 0.04 deg; internal force at least 39.6 N",
        "`keyframe_act`, 7,000 steps; keyframe error 0.0068 rad",
        "100 of 100 held-out starts from 4000, 99 of 100 in a changed room, 0 of 5 with the object hidden",
        "246 trials, starts from 5000",
    ):
        assert words in stages
    methods = made["standard-methods"]
    assert (
        "| `act` (`keyframe_act`) | 50 of 50 | 5.75 s | 69 % | 46 rad/s³ | 0.04 deg | 1.39 m |"
    ) in methods
    lost = "`moveit` under `moved 20 mm` 19 of 20; `moveit` under `randomised` 57 of 60."
    assert methods.endswith(f"with a failed trial: {lost}")
    tasks = made["standard-tasks"].splitlines()
    assert tasks[0] == "| | `moveit` clean | `moveit` randomised | `act` clean | `act` randomised |"
    assert tasks[2] == (
        "| `rod_carry` | 50 of 50 (93-100 %) | 57 of 60 (86-98 %) | 50 of 50 (93-100 %) "
        "| 60 of 60 (94-100 %) |"
    )
    assert tasks[3] == "| `sort` | 6 of 6 (61-100 %) | | | |"


def test_a_run_that_does_not_pass_fills_nothing(run: Path) -> None:
    write_stage(run, "carry", [Check("holds", 0, "==", 1, why="made up")], {})
    assert standard.blocks(run) is None
    assert standard.blocks(run / "nowhere") is None


def test_a_run_that_is_no_acceptance_is_refused(run: Path) -> None:
    holds = [Check("holds", 1, "==", 1, why="made up")]
    write_stage(run, "report", holds, {}, acceptance_profile=False)
    with pytest.raises(DataError, match="report counts not as acceptance"):
        standard.blocks(run)


def test_a_verdict_without_the_number_is_named(run: Path) -> None:
    write_stage(run, "carry", [Check("holds", 1, "==", 1, why="made up")], _DATA["carry"])
    with pytest.raises(DataError, match="verdict of carry has no check 'tilt_max_rad'"):
        standard.blocks(run)


def test_trainings_are_shown_by_seed(run: Path) -> None:
    assert trainings.block(run) is None
    deploy = {
        "successes_n": 296,
        "trials": 300,
        "by_seed": [0.98, 0.98, 1.0],
        "room": {"successes_n": 291, "trials": 300, "by_seed": [0.96, 0.96, 0.99]},
    }
    write_stage(run, "deploy", [Check("holds", 1, "==", 1, why="made up")], deploy)
    block = trainings.block(run) or ""
    assert block.startswith("Starts from 4000.")
    assert "| `keyframe_act` | seed 1 | seed 2 | seed 3 | together |" in block
    assert ("| room | 96 of 100 | 96 of 100 | 99 of 100 | 291 of 300 (94-98 %) |") in block


# Benches


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A record of the step and of the hard queries."""
    step = BenchTable(
        "step",
        ("median_us", "bare_us", "ratio"),
        (
            BenchRow("measurement and supervisor: joints", {"median_us": 3.0}, {}),
            BenchRow("sort, moveit", {"median_us": 62.0, "bare_us": 25.0, "ratio": 2.41}, {}),
            BenchRow("sort, moveit, while held", {"median_us": 63.0, "ratio": 2.5}, {}),
        ),
    )
    faults = {"colliding": 1, "over_jerk": 2}
    hard = BenchTable(
        "hard planning queries, WITHOUT roboplan",
        ("solved", "median_ms"),
        (
            BenchRow("shelf", {"drawn": 50, "infeasible": 30, "no_posture": 3}, {}),
            BenchRow("shelf: minidual", {"solved": 17, "median_ms": 87.0, **faults}, {}),
            BenchRow("shelf: OMPL", {"solved": 14, "median_ms": 1192.0, **faults}, {}),
            BenchRow("gate", {"drawn": 50, "infeasible": 14, "no_posture": 0}, {}),
            BenchRow("gate: minidual", {"solved": 35, "median_ms": 51.0, **faults}, {}),
        ),
    )
    path = tmp_path / "bench.json"
    machine = {"processor": "Some CPU", "cores": 2}
    made_at = "2026-01-31T12:00:00Z"
    tables = {"carry": step, "hard": hard}
    write_bench(path, BenchRecord(made_at, "0123abcdef", machine, {}, tables))
    return path


def test_the_step_table_has_whole_steps_only(bench: Path) -> None:
    block = benches.step_block(bench) or ""
    assert block.splitlines()[0].endswith("2026-01-31; `make bench ARGS=carry`")
    assert block.splitlines()[2:] == [
        "| | median_us | ratio |",
        "|---|---|---|",
        "| `sort`, `moveit` | 62.0 | 2.41 |",
    ]


def test_the_planning_table_has_a_column_for_each_planner(bench: Path) -> None:
    block = benches.planning_block(bench) or ""
    assert "| shelf | 17 | 17, 87.0 | 14, 1192 |" in block
    assert "| gate | 36 | 35, 51.0 | |" in block
    assert "minidual 2 colliding, 4 over_jerk of 52; OMPL 1 colliding, 2 over_jerk of 14." in block


def test_a_missing_planner_is_said_and_a_record_without_peers_refused(bench: Path) -> None:
    assert "queries, WITHOUT roboplan. Paths" in (benches.planning_block(bench) or "")
    made = read_bench(bench)
    assert made is not None
    hard = made.tables["hard"]
    own = replace(hard, rows=tuple(row for row in hard.rows if "OMPL" not in row.name))
    write_bench(bench, replace(made, tables={"hard": own}))
    assert benches.planning_block(bench) is None


def test_without_a_record_there_is_no_table(tmp_path: Path) -> None:
    assert benches.step_block(tmp_path / "none.json") is None
    assert benches.planning_block(tmp_path / "none.json") is None


# The command

type Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def own_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a page that stands for the results."""
    page = tmp_path / "results.md"
    page.write_text(PAGE_OF_ONE, encoding="utf-8")
    monkeypatch.setattr(results, "RESULTS", (page,))
    monkeypatch.setattr(results, "PAGES", (page,))
    monkeypatch.setattr(results, "FOLDER", tmp_path / "made")
    return page


@pytest.fixture
def call(own_page: Path, capsys: pytest.CaptureFixture[str]) -> Call:
    """Return what calls the command; it returns (code, page, stderr)."""

    def called(*words: str) -> tuple[int, str, str]:
        code = results.main(list(words))
        return code, own_page.read_text(encoding="utf-8"), capsys.readouterr().err

    return called


_TASK = ("--only", "tasks", "--tasks", "rod_carry", "--trials", "2")


def test_the_command_measures_what_is_missing_and_fills_the_page(
    call: Call,
    drawn: list[int],
) -> None:
    code, page, said = call(*_TASK, "--first", "3000")
    assert code == 0
    assert "Starts 3000 to 3001, successes of 2." in page
    assert drawn == [3000, 3001] * 4
    assert "cell 4 of 4, rod_carry, impedance, randomised, start 3001: success" in said
    assert call(*_TASK, "--first", "3000")[0] == 0
    assert len(drawn) == 8


def test_tables_can_be_printed(
    own_page: Path,
    bench: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A trial of the command with few trials must not replace what was published."""
    assert results.main(["--only", "step", "--step", str(bench), "--print"]) == 0
    assert "| `sort`, `moveit` | 62.0 | 2.41 |" in capsys.readouterr().out
    assert own_page.read_text(encoding="utf-8") == PAGE_OF_ONE


def test_a_missing_input_leaves_the_table(call: Call, drawn: list[int]) -> None:
    for words in ((*_TASK, "--first", "3000"), ("--only", "step", "--step", "nowhere.json")):
        code, page, said = call(*words, "--fill")
        assert code == 1
        assert page == PAGE_OF_ONE
        assert "kept, because there is no" in said
    assert drawn == []


def test_a_bench_is_run_where_its_record_is_missing(
    call: Call,
    bench: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    commands: list[tuple[str, ...]] = []
    monkeypatch.setattr(results, "_run", lambda *command: commands.append(command))
    assert call("--only", "planning", "--planning", str(bench))[0] == 0
    assert commands == []
    assert call("--only", "planning", "--planning", "nowhere.json")[0] == 1
    assert commands[0][1:] == ("-m", "scripts.bench", "--peers", "--json", "nowhere.json")


def test_a_missing_run_is_made_with_the_first_start(
    call: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    commands: list[str] = []
    monkeypatch.setattr(results, "_run", lambda *command: commands.append(" ".join(command)))
    learn = tmp_path / "runs" / "learn"
    assert call("--only", "trainings", "--learn", str(learn), "--first", "3000")[0] == 1
    assert "--run learn --set deploy.first_start=3000" in commands[0]
    assert commands[0].endswith("--until deploy --set train.seeds_n=3")
    assert call("--only", "standard", "--standard", str(learn))[0] == 1
    assert commands[1].endswith("--run learn")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((*_TASK, "--first", "3000", "--policy", "nowhere"), "has no train-act/checkpoint"),
        (("--only", "rates"), "no results 'rates'"),
        (("--only", "tasks"), "needs a first start"),
        ((*_TASK, "--first", "30"), "seen by development"),
        ((*_TASK, "--first", "2050"), "are published already"),
    ],
)
def test_a_wrong_request_is_refused(call: Call, words: tuple[str, ...], reason: str) -> None:
    code, page, said = call(*words)
    assert code == 2
    assert reason in said
    assert page == PAGE_OF_ONE


# Quotes


@pytest.mark.parametrize("page", results.PAGES, ids=lambda page: page.name)
def test_a_page_quotes_what_the_results_say(page: Path) -> None:
    stale = stale_quotes(page.read_text(encoding="utf-8"), results.published_pages())
    assert set(stale) <= results.NO_RESULTS


def test_every_exception_is_needed() -> None:
    published = results.published_pages()
    stale: list[str] = []
    for page in results.PAGES:
        stale += stale_quotes(page.read_text(encoding="utf-8"), published)
    assert set(stale) == results.NO_RESULTS


def test_the_report_quotes_what_the_results_say() -> None:
    from minidual.policies.architectures import KEYFRAME_ACT

    clean, room = "8 of 100", "5 of 100"
    assert f"carried {clean} rods, and {room} in a changed room" in KEYFRAME_ACT.beside
    link = f"[{clean} and {room}](results.md#policies)"
    assert stale_quotes(link, results.published_pages()) == []


def test_every_table_has_its_block_on_one_page_of_results() -> None:
    made = [standard.METHODS_BLOCK, standard.TASKS_BLOCK, "tasks-sort", *results.SOURCES]
    found = [name for text in results.published_pages().values() for name in blocks(text)]
    assert sorted(found) == sorted(made)


@pytest.mark.parametrize(
    ("page", "stale"),
    [
        ("It carries [8 of 100](docs/results.md#policies).", []),
        ("It carries [9 of 100](docs/results.md#policies).", ["9 of 100 (section policies)"]),
        ("It carries [8 of\n100](results.md#policies).", []),
        ("It carries [87 of 100](results.md#policies).", ["87 of 100 (section policies)"]),
        ("It carries [87 of 100](results.md#tasks).", []),
        ("After [1,234 steps](results.md).", []),
        ("After [234 steps](results.md).", ["234 (section any)"]),
        ("It carries 87 of 100.", []),
        ("It carries 7 of 100.", ["7 of 100"]),
        ("It tries 3 of 5.", []),
        ("    prints 7 of 100\n", []),
        ("[Results](results.md#nowhere) are there.", []),
        ("[8 of 100](results.md#nowhere)", ["8 of 100 (section nowhere)"]),
        ("It takes [5 ms](results-speed.md#planning).", []),
        ("It takes [6 ms](results-speed.md#planning).", ["6 (section planning)"]),
        ("It takes [5 ms](results.md#planning).", ["5 (section planning)"]),
        ("It takes [5 ms](results-none.md#planning).", ["5 (section planning)"]),
        ("It solves 40 of 41.", []),
        (with_blocks(PAGE, {"tasks": "88"}), ["block 'tasks'"]),
        (PAGE, []),
    ],
)
def test_another_number_is_found(page: str, stale: list[str]) -> None:
    speed = "# Speed\n\n## Planning\n\n5 ms, 40 of 41.\n"
    assert stale_quotes(page, {"results.md": PAGE, "results-speed.md": speed}) == stale


def test_the_results_quote_themselves() -> None:
    """A summary at the end of the page must follow its tables."""
    own = f"{PAGE}\n## Goals\n\n[87 of 100](#tasks), [8 of 100 (4-15 %)](#policies)\n"

    def stale(page: str) -> list[str]:
        return stale_quotes(page, {"results.md": page})

    assert stale(own) == ["8 of 100 (4-15 %) (section policies)"]
    assert stale(own.replace(" (4-15 %)", "")) == []
    assert "86 of 100 (section tasks)" in stale(own.replace("[87", "[86"))


def test_a_stale_quote_fails_the_command(
    call: Call,
    bench: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    page = tmp_path / "page.md"
    page.write_text("It carries [9 of 100](results.md#policies).", encoding="utf-8")
    monkeypatch.setattr(results, "PAGES", (*results.RESULTS, page))
    code, _, said = call("--only", "step", "--step", str(bench))
    assert code == 1
    assert "page.md quotes 9 of 100 (section policies)" in said


def test_stored_trials_are_lines_of_json(tmp_path: Path, drawn: list[int]) -> None:
    asked = plan(tmp_path)
    run_cell(asked, CELL, 1, nothing)
    lines = asked.path(CELL).read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["index"] for line in lines] == drawn
