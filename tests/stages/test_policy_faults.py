"""Faults of a policy and of a sensor: each makes its own checks of `deploy` and `benchmark` say no."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from minidual.config.learning import DeployConfig
from minidual.config.root import Config
from minidual.demos.rig import PURPOSE
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.plant.world import World
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Array
from minidual.stages import deploy as deploy_stage
from minidual.stages.benchmark import benchmark_checks, condition_checks
from minidual.stages.deploy_checks import HIDDEN, InferenceRates, deploy_checks, set_checks
from minidual.tasks.catalogue import make_task
from minidual.trials import benchmark
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import Bench
from minidual.trials.trial_table import Series
from tests.support.trial_results import failing

CONFIG = Config()
SEED = 7
FAST = InferenceRates(processor_hz=200.0, wall_hz=200.0)
_INFERENCE_S = 0.04
DEPLOY = DeployConfig(trials=1, condition_rate_min={"room": 0.85})


def summary_of(result: TrialMetrics) -> MethodSummary:
    return summarise([result], np.random.default_rng(0))


@pytest.fixture(scope="module")
def resting() -> TrialMetrics:
    """A trial of arms that never move."""
    trial = make_task(CONFIG).trial(SEED, "deploy", 0)
    return Bench("hold", MethodInputs(CONFIG, SEED)).run(trial)[0]


def test_a_policy_that_never_moves_the_arms(resting: TrialMetrics) -> None:
    summary = summary_of(resting)
    assert failing(deploy_checks(summary, 0, FAST, DEPLOY)) == {"success_rate"}
    in_the_room = summary_of(replace(resting, condition="room"))
    assert failing(set_checks("room", in_the_room, [0.0], DEPLOY)) == {"room_success_rate"}
    checks = benchmark_checks([summary], {"hold": 0.5}, 1, {"hold": 1})
    assert failing(checks) == {"hold.success_rate"}


def test_a_policy_that_knows_the_place_by_heart() -> None:
    """It succeeds on the demonstrated start with an object that no camera sees."""
    trial = make_task(CONFIG).trial(SEED, PURPOSE, 0, widen=CONFIG.teleop.widen)
    result, _ = Bench("replay", MethodInputs(CONFIG, SEED), HIDDEN).run(trial)
    assert result.success, result.text
    checks = set_checks(HIDDEN, summary_of(result), [1.0], DEPLOY)
    assert failing(checks) == {"hidden_success_rate"}


class SlowPolicy(ChunkPolicy):
    """Computes 40 ms for a chunk, or waits as long for a busy machine."""

    cameras: Mapping[str, tuple[int, int]] = MappingProxyType({"high": (12, 16)})
    chunk_size = 25
    dim = 16
    waits = False

    def predict(self, images: Mapping[str, Image], state: Array) -> Array:
        """Return a chunk late."""
        if self.waits:
            time.sleep(_INFERENCE_S)
        else:
            until_s = time.process_time() + _INFERENCE_S
            while time.process_time() < until_s:
                pass
        return np.zeros((self.chunk_size, self.dim))


def inference_checks(
    waits: bool,
    resting: TrialMetrics,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> list[Check]:
    """Return the checks of successful trials with a policy that is slow."""
    policy = SlowPolicy()
    policy.waits = waits
    monkeypatch.setattr(deploy_stage, "load_runtime", lambda *_, **_options: PolicyRuntime(policy))
    context = StageContext(folder=tmp_path, config=CONFIG, seed=SEED, profile="standard")
    rates = deploy_stage.measure_inference(tmp_path, context)
    success = replace(resting, success=True, duration_s=5.0)
    return deploy_checks(summary_of(success), 0, rates, DEPLOY)


def test_a_policy_that_is_slower_than_the_arms(
    resting: TrialMetrics,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    checks = inference_checks(False, resting, monkeypatch, tmp_path)
    assert failing(checks) == {"inference_hz"}


def test_a_policy_that_waits_for_a_busy_machine(
    resting: TrialMetrics,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """The gate measures processor time: waiting lowers the reported wall rate alone."""
    checks = inference_checks(True, resting, monkeypatch, tmp_path)
    assert failing(checks) == set()
    observed = {check.name: check.observed for check in checks}
    assert observed["inference_wall_hz"] < 1.0 / _INFERENCE_S
    assert observed["inference_hz"] > 4.0 / _INFERENCE_S


def test_a_torque_sensor_that_gives_nan(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = np.full(14, np.nan)
    monkeypatch.setattr(World, "tau", property(lambda _world: nothing.copy()))
    inputs = MethodInputs(CONFIG, SEED)
    cells, trials = benchmark.run_benchmark(("hold",), {CLEAN: 1}, inputs, workers=1)
    assert np.isnan(trials[0].torque_ratio_max)
    checks = condition_checks(cells, ("hold",), (CLEAN,), {Series("hold", CLEAN): 1})
    assert failing(checks) == {"cells_not_finite"}
    (check,) = [check for check in checks if check.name == "cells_not_finite"]
    assert "torque_ratio_max" in check.why
