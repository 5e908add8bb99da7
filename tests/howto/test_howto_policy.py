"""docs/howto-policy.md: its code runs, and its kind of policy is trained, graded and driven."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import DeployConfig, TrainConfig
from minidual.config.root import Config
from minidual.errors import DataError, UsageError
from minidual.policies.kinds import POLICIES, load_policy, write_loss_csv
from minidual.policies.pilot import load_runtime
from minidual.policies.policy import exercise_checkpoint
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.show.figures.training import draw_loss
from minidual.stages.config_checks import check_policy
from minidual.stages.train_act import train_checks
from tests.support import howto


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with howto.program("howto-policy.md", POLICIES, tmp_path_factory.mktemp("nearest")) as names:
        yield names


def test_it_answers_with_what_followed(page: dict[str, Any]) -> None:
    np.testing.assert_allclose(page["action"], page["ticks"][31], atol=1e-6)
    assert page["result"].loss_ratio < 1e-6


def test_the_stage_grades_it_like_any_other(page: dict[str, Any], tmp_path: Path) -> None:
    config = Config(train=TrainConfig(policy="nearest"))
    check_policy(config)
    emitted = exercise_checkpoint(page["checkpoint"], page["demos"], DUAL_PANDA)
    checks = train_checks(page["result"], emitted, config.train, DUAL_PANDA)
    assert [c.name for c in checks if c.passed is False] == []
    write_loss_csv(page["result"].curve, tmp_path / "loss.csv")
    draw_loss(page["result"], tmp_path / "loss.svg")
    assert ">training, action L1</text>" in (tmp_path / "loss.svg").read_text(encoding="utf-8")


def test_the_checkpoint_says_of_which_kind_it_is(page: dict[str, Any]) -> None:
    assert isinstance(load_policy(page["checkpoint"]), page["module"].Replay)
    assert load_runtime(page["checkpoint"], DeployConfig(), DUAL_PANDA).joints_n == 14
    with pytest.raises(UsageError, match="drives 14 joints"):
        load_runtime(page["checkpoint"], DeployConfig(), Robot(ARM_MODELS["ur5"]))


def test_a_kind_that_is_not_there_is_named(page: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"(?s)no policy 'nearset'.*did you mean 'nearest'"):
        check_policy(Config(train=TrainConfig(policy="nearset")))
    (tmp_path / "config.json").write_text('{"type": "nearset"}')
    with pytest.raises(DataError, match=r"(?s)no policy 'nearset'.*did you mean 'nearest'"):
        load_policy(tmp_path)
