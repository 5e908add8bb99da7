"""`env-check`, the five steps of the migration and a carry on two emulated Franka controllers.

Needs the extra `minidual[franka]`; the emulator is a process of its own.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import numpy as np
import pytest

from minidual.config.plant import PlantConfig
from minidual.config.root import Config
from minidual.plant.connect import connection
from minidual.plant.lifecycle import Connection
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.env_check.on_plant import measure_plant, plant_checks
from minidual.stages.migrate.measured import checks_of
from minidual.stages.migrate.steps import STEPS, Step, measure_step
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import run_trials
from minidual.trials.site import PlantSite
from tests.support.processes import running

pytest.importorskip("franky", reason="needs the extra minidual[franka] (franky-control)")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

HOSTS = "127.0.0.71,127.0.0.72"
PATIENCE_S = "0.5"
SCENE = make_task(Config()).scene


@pytest.fixture(scope="module")
def emulator() -> Iterator[subprocess.Popen[str]]:
    with running("-m", "tests.support.served_emulator", HOSTS, PATIENCE_S) as process:
        yield process


@pytest.fixture
def link(emulator: subprocess.Popen[str]) -> Iterator[Connection]:
    opened = connection(PlantConfig(address=f"franka://{HOSTS}"), DUAL_PANDA, SCENE).open()
    yield opened
    opened.close()


def test_env_check_passes(link: Connection) -> None:
    measured, rows = measure_plant(link, Config())
    checks = plant_checks(measured, Config(), DUAL_PANDA)
    assert [(check.name, check.observed) for check in checks if check.passed is False] == []
    assert len(rows) == DUAL_PANDA.dof


@pytest.mark.parametrize("step", STEPS, ids=[step.name for step in STEPS])
def test_each_step_of_the_migration_passes(link: Connection, step: Step) -> None:
    m, _ = measure_step(step, link, Config())
    checks = checks_of(m, step.rows)
    assert m.stops == []
    assert [(check.name, check.observed) for check in checks if check.passed is False] == []


def test_the_rod_is_carried_by_a_plan(link: Connection) -> None:
    task = make_task(Config())
    site = PlantSite(link, task.config, 1)
    inputs = MethodInputs(task.config, 1)
    trials = [task.trial(1, "emulated", 0)]
    (result,) = run_trials("moveit", inputs, trials, workers=1, site=site)
    assert result.success, result.text
    assert np.isfinite(result.internal_force_min_n)
