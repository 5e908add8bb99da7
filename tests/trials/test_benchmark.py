"""Methods by conditions: the same starts for all, independent cells, and blanks with a reason."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.loader import load_config
from minidual.config.root import BenchmarkConfig, Config, changed
from minidual.durable import write_csv
from minidual.errors import UsageError
from minidual.gate.stage import StageContext, StageResult
from minidual.stages.benchmark import benchmark_checks, condition_checks
from minidual.stages.config_checks import check_benchmark
from minidual.stages.registry import STAGES
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials import benchmark, methods, runner
from minidual.trials.benchmark import (
    BenchmarkCell,
    conditions_data,
    count_trials,
    first_failures,
    run_benchmark,
    trials_asked,
)
from minidual.trials.conditions import CLEAN, CONDITIONS
from minidual.trials.methods import Factory, MethodInputs, TrainedPolicy
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench, run_trials
from minidual.trials.trial_table import Series
from tests.support.carry_trials import same_row, sample_trial

SEED = 7
METHODS = ("moveit", "impedance", "act")
INPUTS = MethodInputs(Config(), SEED, policies={"act": TrainedPolicy(Path("made up"))})
ASKED = {CLEAN: 6, "push +x": 4, "pose noise x3": 4, "delay 20 ms": 4, "light -30 %": 4}
BLANK = {
    ("act", "pose noise x3"),
    ("act", "delay 20 ms"),
    ("moveit", "delay 20 ms"),
    ("moveit", "light -30 %"),
    ("impedance", "light -30 %"),
}


def outcome(method: str, index: int, condition: str, *, success: bool = True) -> TrialMetrics:
    """Return a trial whose numbers depend on its name alone."""
    number = np.random.default_rng([index, *method.encode(), *condition.encode()]).uniform()
    return TrialMetrics(
        method,
        index,
        condition,
        success,
        "" if success else "held",
        "" if success else "lost it",
        math.nan if success else 3.0,
        6.0 + number if success else math.nan,
        0.7 + 0.1 * number,
        20.0 + number,
        0.001 * number,
        1.4,
        39.0,
        60.0,
        0.001,
        "" if success else "it slipped",
        disturbed=True if CONDITIONS[condition].act else None,
    )


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str, list[Any], Config]]:
    """Made-up trials; what they were asked to run."""
    calls: list[tuple[str, str, list[Any], Config]] = []

    def run_trials(
        method: str,
        inputs: MethodInputs,
        trials: list[Any],
        *,
        workers: int,
        condition: str,
        watch: Any = None,
    ) -> Iterator[TrialMetrics]:
        calls.append((method, condition, [t.start for t in trials], inputs.config))
        for trial in trials:
            yield outcome(
                method,
                trial.index,
                condition,
                success=(trial.index, method) != (1, "act"),
            )

    monkeypatch.setattr(benchmark, "run_trials", run_trials)
    monkeypatch.setattr(
        "minidual.stages.benchmark.draw_failures",
        lambda failed, path: path.touch(),
    )  # made up too
    return calls


def test_of_failures_the_first_of_each_kind_are_told_clean_ones_first() -> None:
    trials = [outcome("act", k, "push +x", success=k < 2) for k in range(4)]
    trials += [outcome("act", k, "clean", success=k != 1) for k in range(4)]
    trials += [
        dataclasses.replace(outcome("moveit", k, "clean", success=False), failure=f"kind {k}")
        for k in (5, 3, 4, 2)
    ]
    found = [(t.method, t.condition, t.index) for t in first_failures(trials)]
    assert found == [("act", "clean", 1), ("moveit", "clean", 5), ("moveit", "clean", 3)]
    assert first_failures([t for t in trials if t.success]) == []


def table(methods: tuple[str, ...] = METHODS, **other: Any) -> dict[tuple[str, str], BenchmarkCell]:
    cells, _ = run_benchmark(
        methods,
        other.get("trials_n", ASKED),
        INPUTS,
        workers=1,
    )
    return {(c.method, c.condition): c for c in cells}


def failing(cells: Any, conditions: tuple[str, ...] = tuple(ASKED)) -> set[str]:
    checks = condition_checks(list(cells), METHODS, conditions, read_back(cells))
    return {check.name for check in checks if check.passed is False}


def read_back(cells: Any) -> dict[Series, int]:
    """Return the results of a table that holds all trials of these cells."""
    return {Series(c.method, c.condition): c.summary.trials_n for c in cells if c.summary}


def test_all_methods_and_conditions_have_the_same_starts(asked: list[Any]) -> None:
    table()
    longest = max((starts for _, _, starts, _ in asked), key=len)
    assert all(starts == longest[: len(starts)] for _, _, starts, _ in asked)
    assert {(m, c) for m, c, _, _ in asked} == {(m, c) for m in METHODS for c in ASKED} - BLANK
    assert all(config == Config() for _, _, _, config in asked), (
        "a bench makes a condition's settings, and it alone"
    )


def test_the_first_start_is_a_setting(asked: list[Any]) -> None:
    """It moves the starts of the benchmark, and no others."""
    inputs = MethodInputs(changed(Config(), {"benchmark.first_start": 2}), SEED)
    _, of_two = run_benchmark(("moveit",), {CLEAN: 3}, inputs, workers=1)
    _, of_nought = run_benchmark(("moveit",), {CLEAN: 5}, MethodInputs(Config(), SEED), workers=1)
    assert [trial.index for trial in of_two] == [2, 3, 4]
    assert str(asked[0][2]) == str(asked[1][2][2:])
    assert [trial.index for trial in of_nought] == [0, 1, 2, 3, 4]
    _, perturbed = run_benchmark(
        ("moveit",),
        {CLEAN: 3},
        inputs,
        workers=1,
        purpose=benchmark.PERTURBED,
    )
    assert [trial.index for trial in perturbed] == [0, 1, 2]


def test_what_does_not_apply_is_not_run_and_says_why(asked: list[Any]) -> None:
    cells = table()
    assert {key for key, cell in cells.items() if cell.summary is None} == BLANK
    assert (
        cells["act", "delay 20 ms"].why_not
        == "act reads no pose or contact force during the motion"
    )
    assert cells["moveit", "light -30 %"].record() == {
        "applies": False,
        "why": "moveit reads no picture",
    }
    count = count_trials(METHODS, ASKED, INPUTS)
    assert count == sum(len(starts) for _, _, starts, _ in asked)


@pytest.mark.parametrize(
    ("settings", "name", "says"),
    [
        (
            {"scene.object.friction": 0.3},
            "friction 0.3",
            "without it too, scene.object.friction is 0.3",
        ),
        (
            {"carry.sensing.delay_s": 0.02},
            "delay 20 ms",
            "without it too, carry.sensing.delay_s is 0.02",
        ),
        (
            {"carry.sensing.pose_noise_m": 0.0, "carry.sensing.pose_noise_rad": 0.0},
            "pose noise x3",
            "without it too",
        ),
    ],
)
def test_what_would_be_the_clean_trials_is_not_run_under_another_name(
    asked: list[Any],
    settings: dict[str, float],
    name: str,
    says: str,
) -> None:
    inputs = MethodInputs(changed(Config(), settings), SEED)
    cells, _ = run_benchmark(("impedance",), {CLEAN: 2, name: 2}, inputs, workers=1)
    assert [call[1] for call in asked] == [CLEAN]
    assert says in cells[1].why_not
    assert cells[1].settled
    assert count_trials(("impedance",), {CLEAN: 2, name: 2}, inputs) == 2
    assert not CONDITIONS[name].why_not("impedance", Config()), "the standard configuration differs"


def test_a_cell_depends_on_neither_the_order_nor_the_company(asked: list[Any]) -> None:
    everything = table()
    backwards = table(METHODS[::-1], trials_n=dict(reversed(ASKED.items())))
    alone = table(("act",), trials_n={"push +x": 4})
    assert list(everything) == list(backwards)[::-1]
    assert all(everything[key] == backwards[key] for key in everything)
    assert alone["act", "push +x"] == everything["act", "push +x"]


def test_good_cells_pass_and_success_under_a_disturbance_is_reported(asked: list[Any]) -> None:
    cells = table().values()
    assert failing(cells) == set()
    checks = {
        c.name: c for c in condition_checks(list(cells), METHODS, tuple(ASKED), read_back(cells))
    }
    push = checks["act.push_+x.success_rate"]
    assert (push.observed, push.op) == (0.75, None)
    assert "3 of 4 trials, 95 % Wilson interval 0.301 to 0.954" in push.why
    assert len(checks) == 2 + 3 * 4 - len(BLANK)


def test_a_cell_with_too_few_trials_or_none_or_without_a_reason_fails(asked: list[Any]) -> None:
    cells = table()
    key = ("moveit", "push +x")
    assert failing([c for k, c in cells.items() if k != key]) == {"cells_settled"}
    assert failing({**cells, key: cells[key]._replace(asked_n=5)}.values()) == {"cells_settled"}
    for empty in (cells[key]._replace(summary=None), cells[key]._replace(why_not="tired")):
        assert failing({**cells, key: empty}.values()) == {"cells_settled"}
    assert failing([]) == {"cells_settled"}


@pytest.mark.parametrize("disturbed", [False, None])
def test_a_success_that_nothing_pushed_leaves_its_cell_open(
    asked: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    disturbed: bool | None,
) -> None:
    run = benchmark.run_trials

    def missed(*given: Any, condition: str, **other: Any) -> Iterator[TrialMetrics]:
        for result in run(*given, condition=condition, **other):
            if condition == "push +x" and result.index == 2:
                result = dataclasses.replace(result, disturbed=disturbed)
            yield result

    assert failing(table().values()) == set()
    monkeypatch.setattr(benchmark, "run_trials", missed)
    cells = table()
    assert failing(cells.values()) == {"cells_settled"}
    assert cells["act", "push +x"].undisturbed == (2,)
    results_n = read_back(cells.values())
    checks = {
        c.name: c for c in condition_checks(list(cells.values()), METHODS, tuple(ASKED), results_n)
    }
    assert "act under push +x (trial 2 succeeded undisturbed)" in checks["cells_settled"].why


@pytest.mark.parametrize(
    "name",
    ["torque_ratio_max", "jerk_rms_median", "tilt_low_rad", "duration_median_s"],
)
def test_a_number_that_is_none_fails(asked: list[Any], name: str) -> None:
    cells = table()
    key = ("impedance", "push +x")
    summary = cells[key].summary
    assert summary is not None
    bad = dataclasses.replace(summary, numbers={**summary.numbers, name: math.nan})
    broken = {**cells, key: cells[key]._replace(summary=bad)}
    assert failing(broken.values()) == {"cells_not_finite"}
    results_n = read_back(broken.values())
    checks = condition_checks(list(broken.values()), METHODS, tuple(ASKED), results_n)
    (check,) = [c for c in checks if not c.passed and c.op]
    assert f"impedance under push +x: {name}" in check.why


def test_who_never_succeeds_has_no_time_and_that_is_no_hole(asked: list[Any]) -> None:
    cells = table()
    key = ("act", "push +x")
    summary = cells[key].summary
    assert summary is not None
    none = {
        n: math.nan
        for n in summary.numbers
        if n.startswith(("duration", "path", "internal", "pinch"))
    }
    lost = dataclasses.replace(
        summary,
        successes_n=0,
        numbers={**summary.numbers, "success_rate": 0.0, **none},
    )
    cell = cells[key]._replace(summary=lost)
    assert failing({**cells, key: cell}.values()) == set()
    assert cell.record()["duration_median_s"] == "nan"


def test_limits_hold_on_clean_trials_alone(asked: list[Any]) -> None:
    clean = [c.summary for c in table().values() if c.condition == CLEAN and c.summary is not None]
    assert [(s.method, s.condition, s.trials_n) for s in clean] == [(m, CLEAN, 6) for m in METHODS]
    checks = benchmark_checks(
        clean,
        BenchmarkConfig().success_rate_min,
        6,
        dict.fromkeys(METHODS, 6),
    )
    assert {c.name for c in checks if c.op} == {
        *(f"{m}.success_rate" for m in METHODS),
        "trials_per_method",
    }


def test_the_files_hold_every_cell(asked: list[Any], tmp_path: Path) -> None:
    cells = list(table().values())
    path = write_csv(
        tmp_path / "conditions.csv",
        [c.row() for c in cells],
        missing="does not apply",
    )
    with path.open(newline="") as stream:
        rows = {(r["method"], r["condition"]): r for r in csv.DictReader(stream)}
    assert set(rows) == {(m, c) for m in METHODS for c in ASKED}
    assert rows["moveit", "light -30 %"]["applies"] == "no: moveit reads no picture"
    assert rows["moveit", "light -30 %"]["success_rate"] == "does not apply"
    assert rows["act", "push +x"]["success_rate"] == "0.75"
    data = conditions_data(cells)
    assert list(data) == [name for name in ASKED if name != CLEAN]
    assert data["push +x"]["methods"]["act"]["success_rate"] == 0.75
    assert data["push +x"]["methods"]["act"]["stopped_n"] == 1
    assert data["push +x"]["trials_n"] == 4


def test_the_stage_refuses_unknown_conditions_before_anything_runs() -> None:
    check_benchmark(Config.model_validate({"benchmark": {"conditions": ["all"]}}))
    for names, says in (
        (["clean", "storm"], "no condition 'storm'"),
        (["push +x"], "lack 'clean'"),
    ):
        with pytest.raises(UsageError, match=says):
            check_benchmark(Config.model_validate({"benchmark": {"conditions": names}}))
    loud = {"benchmark": {"conditions": ["all"]}, "carry": {"sensing": {"pose_noise_m": 0.01}}}
    with pytest.raises(
        UsageError,
        match=r"condition 'pose noise x3' sets carry.sensing.pose_noise_m = 0.03",
    ):
        check_benchmark(Config.model_validate(loud))
    one = Config()
    other = Config.model_validate({"benchmark": {"conditions": ["clean", "push +x"]}})
    assert STAGES["benchmark"].parameters(one) != STAGES["benchmark"].parameters(other)


def run_benchmark_stage(folder: Path, config: Config, recorded: str) -> StageResult:
    """Run the stage where demonstrations of this task were recorded."""
    (folder / "config.yaml").write_text(f"task: {recorded}\n", encoding="utf-8")
    (folder / "train.json").write_text("{}", encoding="utf-8")
    given = StageContext(
        folder=folder,
        config=STAGES["benchmark"].resolved(config),
        seed=SEED,
        profile="standard",
    )
    upstream = {"train-act": folder, "teleop-record": folder}
    return STAGES["benchmark"].load()(dataclasses.replace(given, upstream=upstream))


def test_a_policy_is_compared_on_the_task_that_it_was_trained_on(
    asked: list[Any],
    tmp_path: Path,
) -> None:
    """The task of the checkpoint counts, not the run's."""
    asked_of = {"tasks": ["rod_carry", "handover"], "methods": ["moveit", "act"], "trials_n": 2}
    config = Config.model_validate({"benchmark": {**asked_of, "conditions": ["clean"]}})
    result = run_benchmark_stage(tmp_path, config, "handover")
    rows = {
        task: result.data["tasks"][task]["methods"]["act"] for task in ("rod_carry", "handover")
    }
    assert rows["handover"]["trials"] == 2
    assert rows["rod_carry"] == {"applies": False, "why": "its policy is trained on 'handover'"}
    with pytest.raises(
        UsageError,
        match="'act' cannot do 'rod_carry': its policy is trained on 'handover'",
    ) as caught:
        run_benchmark_stage(
            tmp_path,
            changed(config, {"benchmark.tasks": ["rod_carry"]}),
            "handover",
        )
    assert "it can do handover" in str(caught.value.remedy)


def test_several_tasks_are_grouped_by_name(asked: list[Any], tmp_path: Path) -> None:
    asked_of = {"tasks": ["rod_carry", "handover"], "trials_n": 3, "perturbed_trials_n": 2}
    config = Config.model_validate(
        {"benchmark": {**asked_of, "conditions": ["clean", "mass +50 %"]}},
    )
    check_benchmark(config)
    result = run_benchmark_stage(tmp_path, config, "rod_carry")
    assert all(check.passed is not False for check in result.checks)
    names = {check.name for check in result.checks}
    assert {
        "rod_carry.moveit.success_rate",
        "handover.moveit.success_rate",
        "handover.cells_settled",
    } <= names
    handed = result.data["tasks"]["handover"]["methods"]
    assert handed["moveit"]["trials"] == 3
    assert handed["impedance"]["trials"] == 3
    assert handed["act"] == {"applies": False, "why": "its policy is trained on 'rod_carry'"}
    assert {config.scene.object.name for *_, config in asked} == {"rod", "bottle"}
    with (tmp_path / "benchmark.csv").open(newline="") as stream:
        rows = [(row["task"], row["method"]) for row in csv.DictReader(stream)]
    shared = [("handover", m) for m in ("moveit", "impedance") for _ in range(5)]
    assert rows == [("rod_carry", m) for m in METHODS for _ in range(5)] + shared


def drop(rows: list[Any]) -> list[Any]:
    return rows[:-1]


def repeat(rows: list[Any]) -> list[Any]:
    return [*rows, rows[-1]]


def repeat_another(rows: list[Any]) -> list[Any]:
    return [*rows[:-1], rows[-2]]


@pytest.mark.parametrize("fault", [drop, repeat, repeat_another])
@pytest.mark.parametrize(
    ("condition", "names"),
    [
        ("clean", {"handover.trials_per_method", "handover.cells_settled"}),
        ("mass +50 %", {"handover.cells_settled"}),
    ],
)
def test_the_stage_fails_if_its_table_loses_or_repeats_a_trial(
    asked: list[Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: Callable[[list[Any]], list[Any]],
    condition: str,
    names: set[str],
) -> None:
    """The fault is in benchmark.csv, in the rows of one method, task and condition."""
    damaged = ("handover", "moveit", condition)

    def write(path: Path, rows: list[Any], **options: Any) -> Path:
        if path.name != "benchmark.csv":
            return write_csv(path, rows, **options)
        mine = [r for r in rows if (r["task"], r["method"], r["condition"]) == damaged]
        others = [r for r in rows if (r["task"], r["method"], r["condition"]) != damaged]
        return write_csv(path, [*others, *fault(mine)], **options)

    monkeypatch.setattr("minidual.stages.benchmark.write_csv", write)
    few = {"methods": ["moveit", "impedance"], "trials_n": 3, "perturbed_trials_n": 2}
    conditions = ["clean", "mass +50 %"]
    tasks = ["rod_carry", "handover"]
    config = Config.model_validate({"benchmark": {**few, "tasks": tasks, "conditions": conditions}})
    result = run_benchmark_stage(tmp_path, config, "rod_carry")
    assert {c.name for c in result.checks if c.passed is False} == names


def test_planned_methods_are_compared_without_a_policy(asked: list[Any], tmp_path: Path) -> None:
    few = {"methods": ["moveit", "impedance"], "conditions": ["clean"], "trials_n": 2}
    config = STAGES["benchmark"].resolved(Config.model_validate({"benchmark": few}))
    given = StageContext(folder=tmp_path, config=config, seed=SEED, profile="standard")
    result = STAGES["benchmark"].load()(given)
    assert set(result.data["tasks"]["rod_carry"]["methods"]) == {"moveit", "impedance"}
    with pytest.raises(UsageError, match="needs a checkpoint"):
        methods.METHODS["act"].factory(MethodInputs(config, SEED))


def test_further_tasks_run_undisturbed_beside_the_runs_own(
    asked: list[Any],
    tmp_path: Path,
) -> None:
    few = {
        "further_tasks": {"handover": 2, "pot_lift": 50, "rod_carry": 7},
        "trials_n": 3,
        "perturbed_trials_n": 2,
    }
    config = Config.model_validate({"benchmark": {**few, "conditions": ["clean", "mass +50 %"]}})
    check_benchmark(config)
    own = {"clean": 3, "mass +50 %": 2}
    assert trials_asked(config) == {
        "rod_carry": own,
        "handover": {"clean": 2},
        "pot_lift": {"clean": 3},
    }
    assert trials_asked(changed(config, {"benchmark.tasks": ("insertion",)})) == {"insertion": own}
    result = run_benchmark_stage(tmp_path, config, "rod_carry")
    assert all(check.passed is not False for check in result.checks)
    assert list(result.data["tasks"]) == ["rod_carry", "handover", "pot_lift"]
    assert {config.scene.object.name for *_, config in asked} == {"rod", "bottle", "pot"}
    assert list(result.data["tasks"]["rod_carry"]["conditions"]) == ["mass +50 %"]
    assert result.data["tasks"]["handover"]["conditions"] == {}
    one_less = [cell for cell in table().values() if cell.summary][:1]
    assert one_less[0].summary is not None
    checks = benchmark_checks([one_less[0].summary], {}, 7, {"moveit": 6}, "handover.")
    assert [c.name for c in checks if c.passed is False] == ["handover.trials_per_method"]
    with pytest.raises(UsageError, match="no task 'potlift'"):
        check_benchmark(changed(config, {"benchmark.further_tasks": {"potlift": 2}}))


def test_a_condition_that_tells_methods_apart_has_trials_of_its_own_in_each_task() -> None:
    benchmark = {
        "conditions": ["clean", "randomised", "push +y"],
        "condition_trials": {"randomised": {"rod_carry": 9, "handover": 4}},
        "further_tasks": {"handover": 2, "sort": 1},
        "trials_n": 3,
        "perturbed_trials_n": 5,
    }
    config = Config.model_validate({"benchmark": benchmark})
    assert trials_asked(config) == {
        "rod_carry": {"clean": 3, "randomised": 9, "push +y": 5},
        "handover": {"clean": 2, "randomised": 4},
        "sort": {"clean": 1},
    }
    named = changed(config, {"benchmark.tasks": ("handover",)})
    assert trials_asked(named) == {"handover": {"clean": 3, "randomised": 5, "push +y": 5}}
    undisturbed = changed(config, {"benchmark.conditions": ("clean",)})
    assert trials_asked(undisturbed) == {
        "rod_carry": {"clean": 3},
        "handover": {"clean": 2},
        "sort": {"clean": 1},
    }


@pytest.mark.parametrize(
    ("condition_trials", "says"),
    [
        ({"randomized": {"rod_carry": 1}}, "no condition 'randomized'"),
        ({"randomised": {"potlift": 1}}, "no task 'potlift'"),
        ({"clean": {"rod_carry": 1}}, "benchmark.condition_trials names 'clean'"),
    ],
)
def test_trials_of_no_condition_or_task_are_refused(
    condition_trials: dict[str, dict[str, int]],
    says: str,
) -> None:
    config = Config.model_validate({"benchmark": {"condition_trials": condition_trials}})
    with pytest.raises(UsageError, match=says):
        check_benchmark(config)


def test_the_standard_profile_compares_every_task_where_methods_differ() -> None:
    asked = trials_asked(load_config("standard").config)
    assert len(asked) == 5
    for trials_n in asked.values():
        assert trials_n["clean"] >= 5
        assert trials_n["randomised"] >= 10
    methods_n = {task: 3 if task == "rod_carry" else 2 for task in asked}
    trials = sum(methods_n[task] * sum(trials_n.values()) for task, trials_n in asked.items())
    assert trials < 750


@pytest.mark.parametrize(
    ("tasks", "methods", "says"),
    [
        (
            ["handover"],
            ["impedance_world"],
            "'impedance_world' cannot do 'handover': the hands hold no object together",
        ),
        (["handovr"], ["moveit"], "no task 'handovr'; there are handover, "),
        (["handover", "handover"], ["moveit"], "task 'handover' is named twice"),
    ],
)
def test_a_method_that_can_do_none_of_the_tasks_is_refused_by_name(
    tasks: list[str],
    methods: list[str],
    says: str,
) -> None:
    with pytest.raises(UsageError, match=says) as caught:
        check_benchmark(Config.model_validate({"benchmark": {"tasks": tasks, "methods": methods}}))
    if "cannot" in says:
        assert "it can do pot_lift, rod_carry" in str(caught.value.remedy)


def carried(method: str, condition: str, steps: int) -> Iterator[np.ndarray]:
    """Yield the joints after each of the first steps of a real trial under a condition."""
    bench = Bench(method, MethodInputs(Config(), SEED), condition)
    trial = sample_trial(bench.task.scene, SEED, "benchmark", 0)
    with CONDITIONS[condition].applied(
        bench.world.model,
        bench.task,
        trial,
        np.random.default_rng(0),
    ):
        bench.world.reset(poses=trial.start)
        run = bench.factory(bench.world, bench.kinematics, trial)
        for _ in range(steps):
            run.step()
            yield bench.world.q


@pytest.mark.parametrize(
    ("method", "steps", "touched", "spared"),
    [
        ("moveit", 300, ("pose noise x3",), ("delay 20 ms", "light -30 %")),
        (
            "impedance",
            3000,
            ("pose noise x3", "delay 20 ms", "joint friction x2"),
            ("light -30 %",),
        ),
    ],
)
def test_a_condition_touches_a_method_exactly_if_the_table_says_so(
    method: str,
    steps: int,
    touched: tuple[str, ...],
    spared: tuple[str, ...],
) -> None:
    clean = list(carried(method, CLEAN, steps))
    for name in spared:
        assert CONDITIONS[name].why_not(method, Config())
        np.testing.assert_array_equal(list(carried(method, name, steps)), clean, err_msg=name)
    for name in touched:
        assert not CONDITIONS[name].why_not(method, Config())
        assert any(
            (q != known).any()
            for q, known in zip(carried(method, name, steps), clean, strict=False)
        ), name


def test_planning_starts_from_the_reading_that_impedance_starts_from() -> None:
    seen = []
    for method in ("moveit", "impedance"):
        bench = Bench(method, MethodInputs(Config(), SEED))
        trial = sample_trial(Config().scene, SEED, "benchmark", 0)
        bench.world.reset(poses=trial.start)
        truth = bench.world.object_pose()
        run: Any = bench.factory(bench.world, bench.kinematics, trial)
        seen.append(run.poses["rod"] if method == "moveit" else run.watch.estimate.T_world_object)
    np.testing.assert_array_equal(seen[0], seen[1])
    assert 1e-5 < np.linalg.norm((seen[0] - truth)[:3, 3]) < 0.003, "nobody is told the truth"


@pytest.mark.parametrize("name", TASKS)
def test_an_object_that_somebody_moved_was_not_pushed_by_the_hands(name: str) -> None:
    """20 mm is as far as `stood` lets an object slide."""
    config = make_task(Config(task=name)).config
    scene = config.scene.model_copy(
        update={"task": config.scene.task.model_copy(update={"time_limit_s": 1.2})},
    )
    bench = Bench(
        "hold",
        MethodInputs(config.model_copy(update={"scene": scene}), SEED),
        "moved 20 mm",
    )
    for index in range(4):
        result, _ = bench.run(bench.task.trial(SEED, "benchmark", index))
        assert result.disturbed
        assert "stood" not in result.text
        assert result.measured["impulse_max_ns"] < 0.1, "the jump, 20 mm in 4 ms, is no contact"


def test_a_method_that_stops_itself_says_so_in_its_metrics() -> None:
    hasty = changed(Config(), {"carry.faults.grasp_timeout_s": 0.15})
    bench = Bench("impedance", MethodInputs(hasty, SEED), "moved 20 mm")
    result, _ = bench.run(sample_trial(hasty.scene, SEED, "benchmark", 0))
    assert not result.success
    assert "missed_grasp" in result.aborted
    assert result.disturbed is True
    assert result.to_row()["disturbed"] is True


@pytest.mark.parametrize(
    ("typed", "stops_s", "disturbed"),
    [
        ("push_+x", 0.2, False),
        ("moved_20_mm", 0.4, False),
        ("moved_20_mm", 0.6, True),
        (CLEAN, 0.2, None),
    ],
)
def test_a_trial_says_whether_its_disturbance_took_place_and_by_its_own_name(
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
    stops_s: float,
    disturbed: bool | None,
) -> None:
    bench = Bench("impedance", MethodInputs(Config(), SEED), typed)
    build = bench.factory

    def short(*given: Any) -> Any:
        run: Any = build(*given)
        kind = type(
            "Short",
            (type(run),),
            {"done": property(lambda _: bench.plant.time >= stops_s - 1e-9)},
        )
        run.__class__ = kind
        return run

    bench.factory = short
    streams: list[str] = []
    draw = runner.stream
    monkeypatch.setattr(
        runner,
        "stream",
        lambda seed, name, index: streams.append(name) or draw(seed, name, index),
    )
    result, _ = bench.run(sample_trial(Config().scene, SEED, "benchmark", 0))
    assert result.disturbed is disturbed
    assert result.condition == CONDITIONS[typed.replace("_", " ")].name
    assert f"disturbance/benchmark/{result.condition}" in streams


@pytest.mark.parametrize(
    "condition",
    ["moved 20 mm", pytest.param("mass +50 %", marks=pytest.mark.slow)],
)
def test_a_disturbed_trial_does_not_depend_on_those_before_it(condition: str) -> None:
    """What another split over processes changes: which trials a bench has run before."""
    first, second = (sample_trial(Config().scene, SEED, "benchmark", i) for i in range(2))
    used, fresh = (Bench("impedance", MethodInputs(Config(), SEED), condition) for _ in range(2))
    used.run(first)
    rows = [same_row(bench.run(second)[0]) for bench in (used, fresh)]
    assert rows[0] == rows[1]


def test_a_trial_under_a_condition_has_its_settings_however_it_is_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The bench sets them: no caller has to."""
    told: list[tuple[float, float]] = []
    hold = methods.HOLD

    def build(inputs: MethodInputs) -> Factory:
        sensing = inputs.config.carry.sensing
        told.append((sensing.pose_bias_m, sensing.pose_noise_m))
        return hold.build(inputs)

    monkeypatch.setitem(methods.METHODS._rows, "hold", hold._replace(build=build))
    inputs = MethodInputs(Config(), SEED)
    trial = sample_trial(Config().scene, SEED, "benchmark", 0)
    usual = Config().carry.sensing
    names = (CLEAN, "randomised", "pose noise x3")
    for name in names:
        list(run_trials("hold", inputs, [trial], workers=1, condition=name))
    run_benchmark(["hold"], dict.fromkeys(names, 1), inputs, workers=1)
    wanted = [
        (0.0, usual.pose_noise_m),
        (0.010, usual.pose_noise_m),
        (0.0, 3.0 * usual.pose_noise_m),
    ]
    assert told == [*wanted, *wanted[:2]], (
        "nothing reads a pose in `hold`, so the benchmark leaves the last one out"
    )


@pytest.mark.slow
def test_trials_under_a_condition_do_not_depend_on_workers() -> None:
    config = Config()
    trials = [sample_trial(config.scene, SEED, "benchmark", i) for i in range(2)]
    inputs = MethodInputs(config, SEED)
    one, two = (
        [
            same_row(r)
            for r in run_trials("impedance", inputs, trials, workers=n, condition="moved 20 mm")
        ]
        for n in (1, 2)
    )
    assert one == two
    assert one[0]["condition"] == "moved 20 mm"


def test_counterfactuals_of_force_change_one_setting_and_need_one_object_in_both_hands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = {"impedance_open": ("force_gain", 0.0), "impedance_world": ("squeeze_axes", "world")}
    given: list[Config] = []
    for method, (name, value) in settings.items():
        given.clear()
        row = methods.METHODS[method]._replace(build=lambda inputs: given.append(inputs.config))
        monkeypatch.setitem(methods.METHODS._rows, method, row)
        methods.METHODS[method].factory(MethodInputs(Config(), SEED))
        (config,) = given
        usual = Config().carry.impedance
        assert config.carry.impedance == usual.model_copy(update={name: value}) != usual
        assert "together" in methods.METHODS[method].cannot(make_task(Config(task="handover")), "")
        assert not methods.METHODS[method].cannot(make_task(Config()), "")


def test_the_floor_rests_or_drives_one_plan_wherever_the_object_is() -> None:
    bench = Bench("hold", MethodInputs(Config(), SEED))
    result, log = bench.run(sample_trial(Config().scene, SEED, "benchmark", 0))
    assert not result.success
    assert np.abs(log.q - log.q[0]).max() < 0.01
    assert np.isfinite(result.jerk_rms)
    replay = Bench("replay", MethodInputs(Config(), SEED))
    plans = []
    for index in range(2):
        trial = sample_trial(Config().scene, SEED, "benchmark", index)
        replay.world.reset(poses=trial.start)
        run: Any = replay.factory(replay.world, replay.kinematics, trial)
        assert run.solution is not None
        plans.append(np.vstack([segment.trajectory.q for segment in run.solution.segments]))
    np.testing.assert_array_equal(*plans)
    shown = replay.task.trial(SEED, "demonstrations", 0, widen=Config().teleop.widen).start["rod"]
    assert run.poses["rod"][:2, 3] == pytest.approx(shown[:2]), (
        "where the object was in the demonstration"
    )
    for name in ("pose noise x3", "delay 20 ms", "light -30 %"):
        assert all(CONDITIONS[name].why_not(method, Config()) for method in ("hold", "replay"))
        assert not CONDITIONS["mass +50 %"].why_not("replay", Config())


def test_a_method_gets_the_settings_of_its_task_even_from_a_plain_configuration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[Config] = []
    row = methods.HOLD._replace(build=lambda inputs: given.append(inputs.config))
    monkeypatch.setitem(methods.METHODS._rows, "hold", row)
    Bench("hold", MethodInputs(Config(task="handover"), SEED))
    assert given[0] == make_task(Config(task="handover")).config
    assert given[0].plan.planner.padding_m != Config().plan.planner.padding_m
