"""The table of tasks refuses what a task cannot be made of."""

from __future__ import annotations

import pytest

from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.tasks.catalogue import make_task, tasks_of

BY_THE_MIDDLE = {"scene.object.grasp_offset_m": 0.0}
"""A rod may be held there; the pot would not go between the fingers."""


def test_values_that_do_not_go_together_in_a_task_are_a_message() -> None:
    config = changed(Config(), BY_THE_MIDDLE)
    assert make_task(config).name == "rod_carry"
    with pytest.raises(UsageError, match=r"task 'pot_lift' cannot .*: 0.17 m between the fingers"):
        make_task(changed(config, {"task": "pot_lift"}))


def test_so_they_are_in_a_task_that_the_benchmark_adds() -> None:
    values = {**BY_THE_MIDDLE, "benchmark.further_tasks": {"pot_lift": 2}}
    with pytest.raises(UsageError, match="task 'pot_lift' cannot"):
        tasks_of(changed(Config(), values))
