"""`minidual try` on plants that only a person can judge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from minidual.config.plant import PlantConfig
from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext
from minidual.plant.lifecycle import Connection
from minidual.stages.try_out import try_out
from minidual.stages.try_plant import check_placed, drive_unscored, opened
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from tests.support.position_plant import Follower
from tests.support.tool_contexts import tool_context

TASK = make_task(Config())
TRIALS = [TASK.trial(1, "try", index) for index in range(2)]
ARMS = "tests.support.position_plant:Follower"


def link() -> Connection:
    return Connection("tests:arms", Follower())


def test_where_nothing_scores_a_person_is_told_where_the_objects_go() -> None:
    with pytest.raises(UsageError, match=r"rod at x 0\.\d+ m, y -?0\.\d+ m, yaw") as asked:
        check_placed("", link(), TASK, TRIALS[:1])
    assert asked.value.remedy is not None
    assert "--first 0 --trials 1 --placed-by NAME" in asked.value.remedy
    with pytest.raises(UsageError, match=r"--trials is 2; .* one a call"):
        check_placed("Ada", link(), TASK, TRIALS)
    check_placed("Ada", link(), TASK, TRIALS[:1])


def test_an_unscored_trial_names_what_a_person_confirms() -> None:
    inputs = MethodInputs(TASK.config, 1)
    driven = drive_unscored(link().open(), "hold", TASK, inputs, TRIALS[0])
    assert driven.ended == "ended by itself"
    names = [condition.name for condition in TASK.success(TASK, TRIALS[0])]
    assert list(driven.confirm) == names
    assert names


def test_a_method_with_torques_is_refused_before_anything_moves() -> None:
    with pytest.raises(UsageError, match="'impedance' gives torque commands"):
        drive_unscored(link().open(), "impedance", TASK, MethodInputs(TASK.config, 1), TRIALS[0])


def test_conditions_are_the_simulators() -> None:
    config = Config(plant=PlantConfig(address=ARMS))
    refused = pytest.raises(UsageError, match="condition 'randomised' changes the simulation")
    with refused, opened(config, "randomised"):
        pass


def test_the_command_asks_and_then_does_not_score(tmp_path: Path) -> None:
    options: dict[str, Any] = {"method": "hold", "trials": 1}
    with pytest.raises(UsageError, match="nothing can score there"):
        try_out(_on_arms(tool_context(tmp_path / "a", "try", "rod_carry", **options)))
    options["placed-by"] = "Ada"
    result = try_out(_on_arms(tool_context(tmp_path / "b", "try", "rod_carry", **options)))
    assert result.data["scored"] is False
    assert result.data["placed_by"] == "Ada"
    assert result.data["place"] == "test double"
    assert "a person has to look" in result.notes[0]


def _on_arms(context: ToolContext) -> ToolContext:
    config = changed(context.config, {"plant.address": ARMS})
    return replace(context, config=config)
