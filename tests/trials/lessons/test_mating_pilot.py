"""The learned mating: zeros are the straight push, any policy stays within limits, others are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.environments.mating import ACTION, RelativePose, mating_size, mating_terms
from minidual.errors import UsageError
from minidual.policies.rl.lesson import LESSONS, title_of
from minidual.policies.rl.network import Description, Layers, Normalisation, RlNetwork
from minidual.tasks.catalogue import make_task
from minidual.tasks.insertion import BREAKS_N, PEG, SOCKET
from minidual.tasks.judge import begin
from minidual.trials.lessons.mating_pilot import (
    BEGINS_M,
    RATE_HZ,
    LearnedInsertion,
    check_fits,
    learned_insertions,
)
from minidual.trials.methods import METHODS, MethodInputs, shown_as
from minidual.trials.reinforced import suited
from minidual.trials.runner import Bench

TERMS = mating_terms()
PUSHED_S = 2.0
"""Time of a push that is watched after the policy has taken over."""


def network(**changes: Any) -> RlNetwork:
    """Return a network that gives the same action whatever it reads."""
    size = changes.pop("size", mating_size(TERMS))
    gives = changes.pop("gives", len(RelativePose.names))
    description = Description("insertion", TERMS, ACTION, RATE_HZ)._replace(**changes)
    layers = Layers((np.zeros((gives, size), np.float32),), (np.zeros(gives, np.float32),))
    normalisation = Normalisation(np.zeros(size, np.float32), np.ones(size, np.float32))
    return RlNetwork(description, normalisation, layers)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size": 40}, r"reads 40 numbers and gives 5; its observation has 41 and its action 5"),
        ({"gives": 6}, "gives 6"),
        ({"observation": ("relativ",)}, "no observation of a mating 'relativ'"),
        ({"action": "pair_increments"}, "gives 'pair_increments' at 10.0 Hz"),
        ({"rate_hz": 25.0}, "at 25.0 Hz"),
    ],
)
def test_policies_that_do_not_fit_are_refused(changes: Any, message: str) -> None:
    check_fits(network())
    with pytest.raises(UsageError, match=message):
        check_fits(network(**changes))


def test_it_is_named_by_what_drives() -> None:
    assert title_of("insertion") == "planner + learned insertion"
    assert shown_as("rl", "insertion") == "rl (planner + learned insertion)"
    assert shown_as("rl", "pot_lift") == "rl"
    assert shown_as("moveit", "insertion") == "moveit"
    assert METHODS["rl"].title("sort") == ""


def test_the_lesson_prefers_settings_and_what_is_set_stays() -> None:
    own = suited(Config(task="insertion"))
    assert own.methods.rl.worlds_n == 16
    assert own.methods.rl.discount == Config().methods.rl.discount
    given = Config.model_validate({"task": "insertion", "methods": {"rl": {"worlds_n": 64}}})
    assert suited(given).methods.rl.worlds_n == 64
    assert suited(Config(task="pot_lift")).methods.rl.demonstrations_n == 600


def test_a_policy_without_force_says_so_in_its_description() -> None:
    blind = Config.model_validate({"task": "insertion", "methods": {"rl": {"senses_force": False}}})
    lesson = LESSONS["insertion"]
    assert "wrenches" in lesson.describe(Config(task="insertion")).observation
    assert "wrenches" not in lesson.describe(blind).observation


# Whole trials ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bench() -> Bench:
    config = make_task(Config(task="insertion")).config
    return Bench("impedance", MethodInputs(config, config.seed), "randomised")


class Driven:
    """A trial that is driven to some time after the policy has taken over."""

    def __init__(self, bench: Bench, policy: Any) -> None:
        trial = bench.task.trial(bench.seed, "mating-pilot", 40_000)
        rng = stream(bench.seed, "mating-pilot", 0)
        world = bench.world
        self.q: list[Any] = []
        self.force_n = 0.0
        self.observed: list[Any] = []
        with bench.condition.applied(world.model, bench.task, trial, rng):
            judge = begin(world, bench.task, trial)
            factory = learned_insertions(bench.inputs, lambda: policy)
            method = factory(world, bench.kinematics, trial)
            assert isinstance(method, LearnedInsertion)
            self.method = method
            inserting = False
            began_s = 0.0
            while not inserting or world.time < began_s + PUSHED_S:
                assert world.time < bench.task.time_limit_s
                method.step()
                judge.observe(world)
                if not inserting and method.phase == "insert":
                    inserting = True
                    began_s = world.time + (0.045 - BEGINS_M) / 0.015
                if inserting:
                    self.q.append(world.q.copy())
                    self._feel(judge)
        self.failures = set(judge.failures)

    def _feel(self, judge: Any) -> None:
        for hand, name in enumerate((SOCKET, PEG)):
            force = np.linalg.norm(judge.truth[name].hand_forces[hand])
            self.force_n = max(self.force_n, float(force))


@pytest.mark.slow
def test_zeros_are_the_straight_push(bench: Bench) -> None:
    """To the last bit; and a policy that moves something does not equal it."""
    calls: list[Any] = []

    def zeros(sensed: Any) -> Any:
        calls.append(sensed)
        return np.zeros(5)

    straight = Driven(bench, None)
    driven = Driven(bench, zeros)
    assert len(calls) == pytest.approx(RATE_HZ * PUSHED_S, abs=2)
    assert calls[0].relative[1] == pytest.approx(-BEGINS_M, abs=0.006)
    assert np.array_equal(straight.q, driven.q)
    moved = Driven(bench, lambda sensed: np.array([1.0, 0.0, 0.0, 0.0, 0.0]))
    assert not np.allclose(straight.q, moved.q, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_random_policy_stays_within_limits(bench: Bench, seed: int) -> None:
    """It breaks nothing, and its increments sum up to no more than their bounds."""
    rng = stream(seed, "random-policy")
    driven = Driven(bench, lambda sensed: rng.uniform(-3.0, 3.0, 5))
    mating = driven.method.mating
    assert mating is not None
    assert np.all(mating.actions.value <= RelativePose.high)
    assert np.all(mating.actions.value >= RelativePose.low)
    assert driven.force_n < BREAKS_N
    assert "whole" not in driven.failures


@pytest.mark.slow
def test_a_reading_that_is_not_finite_stops_the_arms(bench: Bench, tmp_path: Path) -> None:
    from minidual.errors import DataError

    def broken(sensed: Any) -> Any:
        raise DataError("the policy reads 41 finite numbers; given are 41")

    driven = Driven(bench, broken)
    assert driven.method.aborted is not None
    assert "finite numbers" in driven.method.aborted
