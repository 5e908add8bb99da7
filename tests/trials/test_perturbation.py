"""The table of disturbances: what it compares with what, and that it can say no."""

import dataclasses

import pytest

from minidual.config.root import Config, changed
from minidual.errors import ExitCode, UsageError
from minidual.gate.stage import ToolContext
from minidual.stages.carry_tools import perturb
from minidual.trials import benchmark
from minidual.trials.benchmark import PERTURBED, promised
from minidual.trials.conditions import CONDITIONS
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.robustness import robustness


def trial_result(index: int, condition: str, *, success: bool) -> TrialMetrics:
    nan = float("nan")
    return TrialMetrics(
        "impedance",
        index,
        condition,
        success,
        "" if success else "held",
        "" if success else "lost it",
        nan if success else 3.0,
        7.0 if success else nan,
        0.7,
        20.0,
        0.001,
        1.4,
        39.0,
        60.0,
        0.001,
        disturbed=True if CONDITIONS[condition].act else None,
    )


@pytest.fixture
def outcomes(monkeypatch):
    """Trials that fail as often as the test says, {condition: failures}; and the trials run."""
    failures: dict[str, int] = {}
    asked: list = []

    def run_trials(method, inputs, trials, *, workers, condition, watch=None):
        asked.append((condition, inputs.config, [t.start for t in trials]))
        for trial in trials:
            failed = trial.index < failures.get(condition, 0)
            yield trial_result(trial.index, condition, success=not failed)

    monkeypatch.setattr(benchmark, "run_trials", run_trials)
    return failures, asked


def found(failures=(), trials_n=20):
    inputs = MethodInputs(Config(), 5)
    cells, trials = benchmark.run_benchmark(
        ["impedance"],
        promised(trials_n),
        inputs,
        workers=1,
        purpose=PERTURBED,
    )
    rows = robustness(cells, trials, inputs.config.carry.limits.success_rate_min)
    return {row.cell.condition: row for row in rows}


def test_every_condition_has_the_same_starts(outcomes):
    rows = found()
    _, asked = outcomes
    assert list(rows) == [name for name, row in CONDITIONS.items() if row.promised]
    assert "moved 20 mm" in rows
    assert "randomised" not in rows, "no carry promises that"
    assert rows["light -30 %"].row()["holds"] == "does not apply: impedance reads no picture"
    assert [name for name, _, _ in asked] == [name for name in rows if name != "light -30 %"]
    assert all(starts == asked[0][2] for _, _, starts in asked)


def test_nineteen_of_twenty_are_enough_and_eighteen_are_not(outcomes):
    failures, _ = outcomes
    failures.update({"friction 0.3": 2, "push +x": 1})
    rows = found()
    assert rows["friction 0.3"].drop == pytest.approx(0.1)
    assert not rows["friction 0.3"].holds
    assert rows["push +x"].holds
    assert "trial 0" in rows["push +x"].example
    assert "lost it" in rows["push +x"].example


def test_the_loss_is_counted_from_the_clean_rate(outcomes):
    failures, _ = outcomes
    failures.update({"clean": 4, "push +x": 4})
    assert found()["push +x"].drop == pytest.approx(0.0)


def test_what_never_succeeds_loses_nothing_and_still_fails(outcomes):
    failures, _ = outcomes
    failures.update(dict.fromkeys(CONDITIONS, 20))
    rows = found()
    assert rows["push +x"].drop == 0.0
    assert not any(row.holds for row in rows.values() if not row.cell.why_not)


def test_a_rate_that_is_no_number_does_not_hold(outcomes):
    row = found()["push +x"]
    assert row.holds
    numbers = {**row.cell.summary.numbers, "success_rate": float("nan")}
    cell = row.cell._replace(summary=dataclasses.replace(row.cell.summary, numbers=numbers))
    assert not row._replace(cell=cell).holds


def tool_context(config, folder, trials):
    options = {"trials": trials}
    return ToolContext(
        config=config,
        seed=5,
        profile="standard",
        run_folder=folder,
        name="perturb",
        options=options,
    )


def test_the_command_fails_when_a_condition_costs_too_much(outcomes, tmp_path):
    failures, _ = outcomes
    context = tool_context(Config(), tmp_path, 20)
    assert perturb(context).exit_code == ExitCode.PASS
    failures["mass +50 %"] = 10
    result = perturb(context)
    assert result.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert any("mass +50 %" in note for note in result.notes)
    assert any("| mass +50 % | 10 of 20 |" in line for line in result.lines)
    assert (context.output / "conditions.csv").read_text().count("\n") == 1 + sum(
        row.promised for row in CONDITIONS.values()
    )


def test_a_row_that_would_be_the_clean_one_says_so(outcomes, tmp_path):
    smooth = Config.model_validate({"carry": {"object": "box"}})
    context = tool_context(smooth, tmp_path, 2)
    result = perturb(context)
    assert result.exit_code == ExitCode.PASS
    assert "friction 0.3" not in [name for name, _, _ in outcomes[1]]
    (line,) = [line for line in result.lines if line.startswith("| friction 0.3 |")]
    assert "does not apply: without it too, scene.object.friction is 0.3" in line
    assert "| yes |" not in line
    (plain,) = [line for line in result.lines if line.startswith("| friction 0.7 |")]
    assert "| yes |" in plain
    assert not found()["friction 0.3"].cell.why_not


def test_noise_times_three_is_a_factor_of_the_noise_there_is():
    loud = changed(Config(), {"carry.sensing.pose_noise_m": 0.002})
    values = CONDITIONS["pose noise x3"].settings_under(loud)
    assert values["carry.sensing.pose_noise_m"] == pytest.approx(0.006)
    assert CONDITIONS["pose noise x3"].settings_under(Config())[
        "carry.sensing.pose_noise_m"
    ] == pytest.approx(0.0015)


def test_a_row_with_a_success_that_nothing_pushed_does_not_hold(outcomes, monkeypatch, tmp_path):
    run = benchmark.run_trials

    def missed(*given, condition, **other):
        for result in run(*given, condition=condition, **other):
            yield dataclasses.replace(result, disturbed=False) if condition == "push -y" else result

    monkeypatch.setattr(benchmark, "run_trials", missed)
    rows = found()
    assert [name for name, row in rows.items() if not row.holds] == ["push -y"]
    assert "never took place" in rows["push -y"].example
    context = tool_context(Config(), tmp_path, 2)
    assert perturb(context).exit_code == ExitCode.ACCEPTANCE_FAILED


def test_a_changed_configuration_is_validated():
    assert changed(Config(), {"carry.trials_n": 3}).carry.trials_n == 3
    assert Config().carry.trials_n != 3
    with pytest.raises(UsageError, match="trials_n"):
        changed(Config(), {"carry.trails_n": 3})
    with pytest.raises(UsageError, match="carry"):
        changed(Config(), {"cary.trials_n": 3})
    with pytest.raises(ValueError, match="greater than or equal to 1"):
        changed(Config(), {"carry.trials_n": 0})
