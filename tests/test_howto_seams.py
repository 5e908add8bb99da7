"""docs/howto-task.md, howto-method.md and howto-condition.md: their code runs, from outside the package."""

from __future__ import annotations

from pathlib import Path

import howto
import pytest

from minidual.errors import UsageError
from minidual.tasks.task import TASKS
from minidual.trials.conditions import CONDITIONS
from minidual.trials.methods import METHODS

TABLES = {"gentle_carry": TASKS, "open_loop": METHODS, "wind": CONDITIONS}


@pytest.fixture
def printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Return a function that installs a page's module, runs the page's program and returns the lines it prints."""

    def run_page(page: str, name: str) -> list[str]:
        module, program = howto.blocks(page)
        (toml,) = howto.blocks(page, "toml")
        with pytest.raises(UsageError, match=f"no .* '{name}'"):
            TABLES[name][name]
        with howto.installed(TABLES[name], tmp_path, name, {name: module}, toml):
            exec(compile(program, page, "exec"), {})
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
