"""Faults in the world and in a motor: each makes its own checks of `carry` say no."""

from collections.abc import Callable

import numpy as np
import pytest

from minidual.config.control import CarryLimits
from minidual.config.root import Config
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.stages.carry import METHOD, carry_checks
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench
from tests.support.carry_trials import sample_trial
from tests.support.trial_results import failing

CONFIG = Config()
TRIAL = sample_trial(CONFIG.scene, 3, "faults", 0)
Fault = Callable[[World, Method], None]


@pytest.fixture(scope="module")
def bench() -> Bench:
    """A bench that the tests share."""
    return Bench(METHOD, MethodInputs(CONFIG, 3))


def failing_under(bench: Bench, fault: Fault) -> set[str]:
    """Return the checks that one trial fails under a fault."""
    result, _ = bench.run(TRIAL, on_step=fault)
    return failing(carry_checks([result], CarryLimits(), CONFIG.scene.task))


def test_something_that_turns_the_rod_out_of_the_hands(bench: Bench) -> None:
    rod = bench.world.model.body("rod").id

    def turn(world: World, method: Method) -> None:
        world.data.xfrc_applied[rod, 3] = 30.0 if method.phase == "carry" else 0.0

    names = failing_under(bench, turn)
    bench.world.data.xfrc_applied[:] = 0.0
    assert names == {"success_rate", "tilt_max_rad", "internal_force_min_n", "duration_max_s"}


def test_a_motor_that_runs_away(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    world = bench.world
    command = world.command
    begins_s = 0.5

    def run_away(tau: Array, fingers: Array) -> None:
        stuck = np.array(tau)
        if world.time > begins_s:
            stuck[5] = world.robot.tau_max[5]
        command(stuck, fingers)

    monkeypatch.setattr(world, "command", run_away)
    names = failing_under(bench, lambda _world, _method: None)
    assert {"torque_ratio_max", "saturated_max_s"} <= names
