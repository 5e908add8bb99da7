"""`env-check --plant`: an external plant passes, and each fault of a plant is found by its check."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from minidual.config.plant import PlantConfig
from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.gate.stage import StageContext
from minidual.plant.lifecycle import Connection
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.config_checks import check_carry
from minidual.stages.env_check.on_plant import PlantMeasurements, measure_plant, plant_checks
from minidual.stages.env_check.stage import run
from minidual.stages.registry import STAGES
from tests.support.position_plant import Follower

ADDRESS = "tests.support.position_plant:Follower"
SOUND = PlantMeasurements(
    reached=[True] * 14,
    swing_rms_rad=0.001,
    stamp_age_s=0.001,
    arms_apart_s=0.001,
    late_share=0.0,
    rest_s=0.2,
    recovery="",
)


def failing(m: PlantMeasurements) -> set[str]:
    checks = plant_checks(m, Config(), DUAL_PANDA)
    return {check.name for check in checks if check.passed is False}


def test_an_external_plant_passes(tmp_path) -> None:
    config = Config(plant=PlantConfig(address=ADDRESS))
    result = run(
        StageContext(folder=tmp_path, config=config, seed=config.seed, profile="standard"),
    )
    assert [check.name for check in result.checks if check.passed is False] == []
    assert result.data["place"] == "test double"
    rows = list(csv.DictReader((tmp_path / "joints.csv").open()))
    assert len(rows) == 14


@pytest.mark.parametrize(
    ("change", "check"),
    [
        ({"faults": ["left: joint_reflex"]}, "plant.faults"),
        ({"stops": ["a reflex"]}, "control.stopped"),
        ({"stamp_age_s": 0.05}, "plant.stamp_age_max_s"),
        ({"stamp_age_s": float("nan")}, "plant.stamp_age_max_s"),
        ({"arms_apart_s": 0.03}, "plant.arms_apart_max_s"),
        ({"late_share": 0.2}, "plant.late_share"),
        ({"reached": [True] * 13}, "joints.reached"),
        ({"swing_rms_rad": 0.03}, "tracking.sine_rms_rad"),
        ({"rest_s": float("nan")}, "stop.rest_s"),
        ({"recovery": "the arms move"}, "stop.recovered"),
    ],
)
def test_each_fault_is_found_by_its_check(change: dict, check: str) -> None:
    assert failing(SOUND) == set()
    assert failing(replace(SOUND, **change)) == {check}


def test_a_joint_that_is_stuck_is_named() -> None:
    plant = Follower()
    plant.stuck[4] = True
    m, rows = measure_plant(Connection(ADDRESS, plant).open(), Config())
    assert m.reached[4] is False
    assert sum(m.reached[:4]) == 4
    assert rows[4]["joint"] == "left_panda_joint5"


def test_a_plant_that_is_ill_is_not_driven() -> None:
    plant = Follower()
    plant.faults = [("user_stopped",), ()]
    m, _ = measure_plant(Connection(ADDRESS, plant).open(), Config())
    assert m.faults == ["left: user_stopped"]
    assert len(plant.targets) == 1
    assert {"plant.faults", "joints.reached", "stop.recovered"} <= failing(m)


def test_a_reflex_on_the_way_is_a_stop() -> None:
    plant = Follower()
    step = plant.step

    def fail_later() -> None:
        step()
        if plant.time > 3.0:
            plant.faults = [(), ("communication_constraints_violation",)]

    plant.step = fail_later
    m, _ = measure_plant(Connection(ADDRESS, plant).open(), Config())
    assert "communication_constraints_violation" in m.stops[0]
    assert m.faults == ["right: communication_constraints_violation"]


def test_arms_whose_stamps_drift_apart_are_found() -> None:
    plant = Follower()
    plant.late_arm_s = 0.06
    m, _ = measure_plant(Connection(ADDRESS, plant).open(), Config())
    assert m.arms_apart_s == pytest.approx(0.06)
    assert m.later == "right"


def test_stages_that_need_the_simulator_refuse_other_plants_by_name() -> None:
    config = Config(plant=PlantConfig(address=ADDRESS))
    with pytest.raises(UsageError, match="carry runs on the simulator only") as error:
        check_carry(config)
    assert "env-check" in (error.value.remedy or "")
    with pytest.raises(UsageError, match="no plant 'simulater'"):
        STAGES["env-check"].resolved(Config(plant=PlantConfig(address="simulater")), checked=True)


def test_the_address_is_a_parameter_of_the_verdict() -> None:
    assert "plant" in STAGES["env-check"].reads
    assert np.isclose(Config().plant.rate_hz, 50.0)
