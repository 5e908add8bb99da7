"""The carry stage: its checks, what it refuses, and what its result depends on.

The number of processes does not change the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from minidual import emergency
from minidual.config.control import CarryLimits
from minidual.config.loader import load_config
from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.gate.canonical import digest
from minidual.gate.check import Check
from minidual.gate.progress import Progress
from minidual.gate.stage import StageContext
from minidual.plant.world import World
from minidual.show.figures import side_by_side
from minidual.show.figures.film import film_trial
from minidual.stages import carry as carry_stage
from minidual.stages.carry import carry_checks, record_trials
from minidual.stages.registry import STAGES
from minidual.tasks.task import Trial
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench, Judged, StepHook, run_trials
from tests.support.carry_trials import same_row, sample_trial
from tests.support.trial_results import BAD, failing, missed, results


@pytest.mark.parametrize("setting", ["carry.object=glas", "carry.motion=overr"])
def test_an_unknown_object_or_motion_is_refused_before_anything_runs(setting: str) -> None:
    with pytest.raises(UsageError, match="there are"):
        STAGES["carry"].resolved(load_config("smoke", [setting]).config, checked=True)


def test_the_parameters_are_those_that_the_object_stands_for() -> None:
    glass = STAGES["carry"].parameters(load_config("standard", ["carry.object=glass"]).config)
    assert glass["scene"].task.internal_force_min_n == 10.0
    assert glass["carry"].impedance.internal_force_n == 13.0
    digests = {
        digest(STAGES["carry"].parameters(load_config("standard", [f"carry.{what}"]).config))
        for what in ("object=rod", "object=glass", "motion=rotate", "sensing.delay_s=0.02")
    }
    assert len(digests) == 4


def test_the_standard_profile_asks_for_the_goal_and_smoke_for_the_baseline() -> None:
    goal, baseline = (load_config(name).config.carry for name in ("standard", "smoke"))
    assert (goal.limits.success_rate_min, goal.limits.duration_max_s) == (0.99, 8.0)
    assert goal.limits.tilt_max_rad < 0.0350
    assert goal.trials_n >= 200
    assert baseline.limits.success_rate_min > 0.8
    assert (baseline.limits.tilt_max_rad, baseline.limits.duration_max_s) == (0.08727, 10.0)
    assert goal.sensing.delay_s == baseline.sensing.delay_s == 0.01
    assert goal.sensing.pose_noise_m == 0.0005


@pytest.mark.slow
def test_results_do_not_depend_on_the_processes_and_a_recording_is_the_same_trial(
    tmp_path: Path,
) -> None:
    config = Config()
    inputs = MethodInputs(config, 3)
    trials = [sample_trial(config.scene, 3, "workers", i) for i in range(3)]
    alone, shared = (list(run_trials("impedance", inputs, trials, workers=n)) for n in (1, 3))
    assert [repr(same_row(m)) for m in alone] == [repr(same_row(m)) for m in shared]
    again, _ = Bench("impedance", inputs).record(trials[1], tmp_path / "trial.npz")
    assert repr(same_row(again)) == repr(same_row(alone[1]))
    assert (tmp_path / "trial.npz").stat().st_size > 10_000


@pytest.mark.parametrize("pictures", [True, False])
def test_pictures_and_recordings_can_be_left_out_and_the_checks_stay(
    pictures: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`doctor` needs the numbers alone."""
    drawn: list[str] = []
    monkeypatch.setattr(carry_stage, "_run_trials", lambda *_: results(2))
    monkeypatch.setattr(carry_stage, "record_trials", lambda *_: {"median": None, "worst": None})
    monkeypatch.setattr(carry_stage, "_show_trial", lambda _context, label, *_: drawn.append(label))
    config = load_config("smoke").config
    context = StageContext(
        config=config, seed=3, profile="smoke", folder=tmp_path, pictures=pictures
    )
    checks = carry_stage.run(context).checks
    assert drawn == (["median", "worst"] if pictures else [])
    assert {check.name for check in checks} >= {"success_rate", "tilt_max_rad", "jerk_rms_median"}


def test_a_trial_that_is_both_median_and_worst_is_recorded_as_both(tmp_path: Path) -> None:
    written: list[tuple[int, str]] = []
    success = SimpleNamespace(text="success", success=True)
    failure = SimpleNamespace(text="held at 2.00 s", success=False)
    results: list[Any] = [success, failure, failure]

    class Records:
        def record(self, trial: Any, path: Path) -> Any:
            written.append((trial, path.name))
            return results[trial], trial

    context: Any = SimpleNamespace(folder=tmp_path, progress=Progress())
    trials: list[Any] = [0, 1, 2]
    bench: Any = Records()
    record_trials(context, bench, trials, results, {"median": 0, "worst": 0})
    assert written == [
        (1, "trial001.npz"),
        (2, "trial002.npz"),
        (0, "median.npz"),
        (0, "worst.npz"),
    ]
    written.clear()
    record_trials(context, bench, trials, results, {"median": 1, "worst": 2})
    assert written == [(1, "median.npz"), (2, "worst.npz")]


class PressedBench(Bench):
    """Someone presses the emergency stop while the trial runs."""

    def run(self, trial: Trial, *, on_step: StepHook = lambda world, method: None) -> Judged:
        """Press after 0.3 s of the trial."""
        del on_step
        return super().run(trial, on_step=press_after_a_while)


def press_after_a_while(world: World, _method: object = None) -> None:
    """Press the emergency stop after 0.3 simulated seconds."""
    if world.time > 0.3:
        emergency.press("test")


@pytest.fixture
def released() -> Iterator[None]:
    """Release the emergency stop after the test."""
    yield
    emergency.release()


@pytest.mark.usefixtures("released")
class TestEmergencyStop:
    """A trial that it cut short has no result: the command ends as interrupted."""

    CONFIG = Config()
    INPUTS = MethodInputs(CONFIG, 3)
    TRIAL = sample_trial(CONFIG.scene, 3, "stopped", 0)

    def test_while_a_trial_is_recorded(self, tmp_path: Path) -> None:
        context: Any = SimpleNamespace(folder=tmp_path, progress=Progress())
        first_result: Any = SimpleNamespace(text="success", success=True)
        shown = {"median": 0, "worst": 0}
        with pytest.raises(emergency.EmergencyStop, match="test"):
            record_trials(
                context,
                PressedBench("impedance", self.INPUTS),
                [self.TRIAL],
                [first_result],
                shown,
            )

    def test_while_a_trial_is_filmed(
        self,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(side_by_side, "Bench", PressedBench)
        with pytest.raises(emergency.EmergencyStop, match="test"):
            film_trial("impedance", self.INPUTS, self.TRIAL, tmp_path / "film.mp4")


TASK = Config().scene.task


def carry(rows: list[TrialMetrics]) -> list[Check]:
    return carry_checks(rows, CarryLimits(), TASK)


def test_good_carries_pass_every_check() -> None:
    checks = carry(results())
    assert failing(checks) == set()
    assert all(check.op for check in checks)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"tilt_max_rad": 0.036}, {"tilt_max_rad"}),
        ({"tilt_max_rad": math.nan}, {"tilt_max_rad"}),
        ({"internal_force_min_n": 19.0}, {"internal_force_min_n"}),
        ({"duration_s": 8.1}, {"duration_max_s"}),
        ({"torque_ratio_max": 1.0}, {"torque_ratio_max"}),
        (BAD, {"success_rate", "duration_max_s"}),
    ],
)
def test_one_bad_carry_fails_the_check_it_should(change: dict[str, Any], names: set[str]) -> None:
    assert failing(carry(results(**change))) == names


def test_two_lost_rods_of_two_hundred_are_allowed_and_three_are_not() -> None:
    assert "success_rate" not in failing(carry(missed(2, 200)))
    assert "success_rate" in failing(carry(missed(3, 200)))


@pytest.mark.parametrize(
    ("saturated_s", "names"),
    [(0.02, set()), (0.021, {"saturated_max_s"}), (math.nan, {"saturated_max_s"})],
)
def test_a_motor_that_stands_at_its_limit_fails_the_stage(
    saturated_s: float,
    names: set[str],
) -> None:
    assert failing(carry(results(saturated_max_s=saturated_s))) == names
