"""docs/howto-task.md, howto-method.md and howto-condition.md: their code runs, from outside the package."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import howto


def run_page(page: str, name: str, folder: Path) -> str:
    """Install the page's module as a distribution, run its program, and return what it prints."""
    module, program = howto.blocks(page)
    (toml,) = howto.blocks(page, "toml")
    environment = howto.distribution(folder, name, {name: module}, toml)
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_task_of_another_distribution_is_carried_and_judged_by_its_own_condition(tmp_path: Path) -> None:
    first, second = run_page("howto-task.md", "gentle_carry", tmp_path).splitlines()
    assert first == "success"
    assert 0.2 < float(second.split()[0]) < 0.45
    assert second.endswith("100%")


def test_a_method_of_another_distribution_runs_its_trials(tmp_path: Path) -> None:
    lines = run_page("howto-method.md", "open_loop", tmp_path).splitlines()
    assert [line.split()[:2] for line in lines] == [["open_loop", "0"], ["open_loop", "1"]]
    assert all(line.endswith("success") for line in lines)


def test_a_condition_of_another_distribution_acts_on_the_tasks_object(tmp_path: Path) -> None:
    assert run_page("howto-condition.md", "wind", tmp_path).strip() == "wind success disturbed: True"
