"""docs/howto-task, -method and -condition.md: their code runs, from outside the package."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from minidual import tasks
from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials.conditions import CONDITIONS
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.runner import Bench
from tests.support import howto

TABLES = {"gentle_carry": TASKS, "open_loop": METHODS, "wind": CONDITIONS}


@pytest.fixture
def printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Return a function that installs a page's module, runs its program and returns its lines."""

    def run_page(page: str, name: str) -> list[str]:
        with pytest.raises(UsageError, match=f"no .* '{name}'"):
            TABLES[name][name]
        with howto.program(page, TABLES[name], tmp_path):
            return capsys.readouterr().out.splitlines()

    return run_page


def test_a_task_of_another_distribution_is_carried_and_judged_by_its_own_condition(printed) -> None:
    first, second = printed("howto-task.md", "gentle_carry")
    assert first == "success"
    assert 0.2 < float(second.split()[0]) < 0.45
    assert second.endswith("100%")


def test_a_method_of_another_distribution_runs_its_trials(printed) -> None:
    lines = printed("howto-method.md", "open_loop")
    assert [line.split()[:2] for line in lines] == [["open_loop", "0"], ["open_loop", "1"]]
    assert all(line.endswith("success") for line in lines)


def test_a_condition_of_another_distribution_acts_on_the_tasks_object(printed) -> None:
    assert printed("howto-condition.md", "wind") == ["wind success disturbed: True"]


@pytest.mark.parametrize(
    "name",
    [
        "pot_lift",
        "handover",
        pytest.param("insertion", marks=pytest.mark.slow),
        pytest.param("sort", marks=pytest.mark.slow),
    ],
)
def test_a_task_of_the_package_is_its_own_files(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Installed from outside instead, it is found, and its trial has the same result."""
    inputs = MethodInputs(make_task(Config(task=name)).config, 20261)
    usual, _ = Bench("impedance", inputs).run(
        make_task(inputs.config).trial(inputs.seed, "bench", 0),
    )
    outside = f"{name}_outside"
    folder = Path(tasks.__path__[0])
    monkeypatch.setattr(
        TASKS,
        "_rows",
        {other: row for other, row in TASKS._rows.items() if other != name},
    )
    monkeypatch.setitem(sys.modules, f"minidual.tasks.{name}", None)  # whoever imports it now fails
    with pytest.raises(UsageError, match=f"no task '{name}'"):
        make_task(Config(task=name))
    source = {outside: (folder / f"{name}.py").read_text(encoding="utf-8")}
    toml = f'[project.entry-points."minidual.tasks"]\n{name} = "{outside}:{name}"\n'
    with howto.installed(TASKS, tmp_path, outside, source, toml):
        task = make_task(Config(task=name))
        assert task.success.__module__.startswith((outside, "minidual.tasks.rod_carry"))
        result, _ = Bench("impedance", MethodInputs(task.config, inputs.seed)).run(
            task.trial(inputs.seed, "bench", 0),
        )
    assert result.success, result.text
    assert result == usual


class Paced:
    """The how-to's learned method, installed from outside.

    Attributes:
        page: The how-to.
    """

    def __init__(self, folder: Path) -> None:
        (module,) = howto.blocks("howto-trainer.md")
        (toml,) = howto.blocks("howto-trainer.md", "toml")
        self.page = (howto.DOCS / "howto-trainer.md").read_text(encoding="utf-8")
        self.runs = folder / "runs"
        site = folder / "site"
        site.mkdir()
        self._environment = howto.distribution(site, "paced", {"paced": module}, toml)

    def minidual(self, words: str) -> subprocess.CompletedProcess[str]:
        """Type a command beside the distribution."""
        command = [sys.executable, "-m", "minidual.cli", *shlex.split(words)]
        command += ["--runs-dir", str(self.runs)]
        return subprocess.run(command, env=self._environment, capture_output=True, text=True)


def test_settings_of_a_method_of_another_distribution_are_checked(tmp_path: Path) -> None:
    paced = Paced(tmp_path)
    shown = paced.minidual("config show --set methods.paced.trials=3")
    assert shown.returncode == 0, shown.stderr
    wrong = paced.minidual("config show --set methods.paced.trials=0")
    assert wrong.returncode == 2
    assert "methods.paced.trials: must be greater than or equal to 1" in wrong.stderr


@pytest.mark.slow
def test_a_learned_method_of_another_distribution_is_trained_and_tried(tmp_path: Path) -> None:
    paced = Paced(tmp_path)
    train, compare = re.findall(r"^minidual (.*)$", paced.page, re.MULTILINE)
    trained = paced.minidual(train)
    assert trained.returncode == 0, trained.stderr
    assert "2 of 2" in trained.stdout
    checkpoint = paced.runs / "standard" / "train" / "paced" / "rod_carry" / "checkpoint"
    assert json.loads((checkpoint / "config.json").read_text())["pace"] == 1.0
    tried = paced.minidual(compare)
    assert tried.returncode == 0, tried.stderr
    assert "paced" in tried.stdout
