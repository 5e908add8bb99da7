"""A trial depends on its start and seed, not on the machine's speed or load."""

import hashlib

import pytest

from minidual.config.root import Config, changed
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench
from tests.support.clocks import hurry


def driven(method: str, task: str) -> tuple[bool, str]:
    """Return whether a trial succeeds, and the hash of all positions of its world."""
    bench = Bench(method, MethodInputs(changed(Config(), {"task": task}), 0))
    digest = hashlib.sha256()
    result, _ = bench.run(
        bench.task.trial(0, "racing-clock", 0),
        on_step=lambda world, _: digest.update(world.data.qpos.tobytes()),
    )
    return result.success, digest.hexdigest()


@pytest.mark.parametrize(
    ("method", "task"),
    [
        ("moveit", "rod_carry"),
        pytest.param("impedance", "handover", marks=pytest.mark.slow),
    ],
)
def test_a_trial_is_driven_alike_while_the_clock_races(
    method: str,
    task: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its plan, its control and its verdict, with an hour between two looks at any clock."""
    calm = driven(method, task)
    assert calm[0]
    hurry(monkeypatch)
    assert driven(method, task) == calm
