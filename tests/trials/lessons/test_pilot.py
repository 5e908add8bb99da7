"""The pilot of learned policies: it acts through the arbiter on what a sensor gives, as the worlds did."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.environments.actions import ACTIONS
from minidual.environments.observations import LIFT
from minidual.errors import UsageError
from minidual.policies.rl.network import Description, Layers, Normalisation, RlNetwork
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench

SIZE = 40
ACTIONS_N = 10


def network(action: Any = None, **changes: Any) -> RlNetwork:
    """Return a network that gives the same action whatever it reads."""
    size = changes.pop("size", SIZE)
    bias = np.zeros(ACTIONS_N, np.float32) if action is None else np.asarray(action, np.float32)
    description = Description("pot_lift", LIFT, "pair_increments", 10.0)._replace(**changes)
    layers = Layers((np.zeros((len(bias), size), np.float32),), (bias,))
    normalisation = Normalisation(np.zeros(size, np.float32), np.ones(size, np.float32))
    return RlNetwork(description, normalisation, layers)


def bench(tmp_path: Path, policy: RlNetwork, task: str = "pot_lift") -> Bench:
    policy.write(tmp_path / "checkpoint")
    config = make_task(Config(task=task)).config
    return Bench("rl", MethodInputs(config, config.seed, tmp_path / "checkpoint"))


def test_an_action_moves_both_hands_by_its_increments(tmp_path: Path) -> None:
    action = np.zeros(ACTIONS_N)
    action[1] = 0.2  # both hands along y, 10 mm an action, 0.1 m/s
    action[8:] = 1.0
    own = bench(tmp_path, network(action))
    trial = own.task.trial(own.seed, "pilot", 0)
    places: list[Any] = []

    def look(world: Any, method: Any) -> None:
        if method.phase == "active":
            own.hands.update(world.q)
            places.append([p.copy() for p in own.hands.p])

    method: Any = own.factory(own.world, own.kinematics, _begun(own, trial))
    for _ in range(1500):
        method.step()
        look(own.world, method)
    way = np.array(places[-1]) - np.array(places[len(places) // 2])
    seconds = (len(places) - len(places) // 2) * own.world.dt
    assert np.allclose(way[:, 1] / seconds, 0.1, atol=0.01)
    assert np.allclose(way[:, [0, 2]], 0.0, atol=0.01)
    assert method.aborted is None
    assert method.inference_s > 0.0


def _begun(own: Bench, trial: Any) -> Any:
    own.world.reset(poses=trial.start)
    return trial


@pytest.mark.parametrize("actions", ["zero", "random"])
def test_policies_that_know_nothing_fail(tmp_path: Path, actions: str) -> None:
    action = np.zeros(ACTIONS_N) if actions == "zero" else np.linspace(-1.0, 1.0, ACTIONS_N)
    own = bench(tmp_path, network(action))
    result, _ = own.run(own.task.trial(own.seed, "pilot", 1))
    assert not result.success


def test_a_policy_of_other_sizes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"reads 39 numbers and gives 10; .* have 40 and 10"):
        bench(tmp_path, network(size=39))


def test_a_policy_that_reads_the_truth_is_refused(tmp_path: Path) -> None:
    terms = ("privileged_pinch", *LIFT)
    with pytest.raises(UsageError, match="reads privileged_pinch, which no sensor gives"):
        bench(tmp_path, network(observation=terms))


def test_a_policy_of_another_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is trained on 'rod_carry', not on 'pot_lift'"):
        bench(tmp_path, network(task="rod_carry"))


def test_tasks_without_a_lesson_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nobody has written a lesson for it; there are pot_lift"):
        bench(tmp_path, network(task="sort"), "sort")


def test_the_hands_wrenches_are_those_of_the_supervisor(tmp_path: Path) -> None:
    """At rest nothing pushes; the term has its size."""
    own = bench(tmp_path, network(observation=("hand_wrenches",), size=12))
    method: Any = own.factory(own.world, own.kinematics, _begun(own, own.task.trial(1, "pilot", 2)))
    for _ in range(200):
        method.step()
    felt = method._wrenches()
    assert felt.shape == (1, 2, 6)
    assert np.linalg.norm(felt[0, :, :3], axis=1).max() < 5.0
    assert "pair_increments" in ACTIONS
