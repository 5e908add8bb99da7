"""Trials away from the simulator: what is judged there, and what is refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.plant import PlantConfig
from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.plant.connect import connection
from minidual.plant.lifecycle import Connection
from minidual.robot.pair import DUAL_PANDA
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.runner import Bench, run_trials
from minidual.trials.site import PlantSite, check_takes
from tests.support.position_plant import Follower


def test_a_carry_by_joint_targets_is_planned_driven_and_judged() -> None:
    """The rod is carried on a plant that takes joint targets at 50 Hz; the truth only judges."""
    task = make_task(Config())
    address = PlantConfig(address="sim-position")
    with connection(address, DUAL_PANDA, task.scene) as link:
        site = PlantSite(link, task.config, 1)
        trials = [task.trial(1, "site", 0)]
        inputs = MethodInputs(task.config, 1)
        (result,) = run_trials("moveit", inputs, trials, workers=1, site=site)
        assert result.success, result.text
        assert 3.0 < result.duration_s < task.time_limit_s
        assert result.pinch_force_min_n > 5.0
        assert np.isfinite(result.jerk_rms)
        T = site.world.object_pose()
        assert np.hypot(*(T[:2, 3] - trials[0].goal[task.carried][:2])) < 0.02


def test_a_method_gets_the_plant_and_its_senses_not_the_world() -> None:
    task = make_task(Config())
    with connection(PlantConfig(address="sim-position"), DUAL_PANDA, task.scene) as link:
        bench = Bench("hold", MethodInputs(task.config, 1), site=PlantSite(link, task.config, 1))
        assert bench.plant is link.plant
        assert not hasattr(bench.plant, "truth")
        result, log = bench.run(task.trial(1, "site", 0))
    assert not result.success
    assert log.rate_hz == pytest.approx(50.0)
    assert len(log.t) == pytest.approx(100, abs=15)
    assert log.t[0] < 0.05, "a trial's time begins with its method"


def test_nothing_can_judge_where_no_truth_is() -> None:
    link = Connection("tests:arms", Follower()).open()
    with pytest.raises(UsageError, match=r"nothing can judge .* 'tests:arms' \(test double\)"):
        PlantSite(link, Config(), 1)


def test_a_torque_law_is_refused_by_name_where_joint_targets_are_taken() -> None:
    link = Connection("tests:arms", Follower())
    with pytest.raises(UsageError, match="'impedance' gives torque commands") as refused:
        check_takes("impedance", link)
    assert "moveit" in str(refused.value.remedy)
    check_takes("moveit", link)
    assert METHODS["moveit"].kinds


def test_a_method_that_senses_says_so_when_nobody_gives_it_senses() -> None:
    with pytest.raises(UsageError, match="its inputs have no senses"):
        METHODS["moveit"].factory(MethodInputs(Config(), 1))
