"""Pot: both hands lift it by its handles and stand it on a plate."""

from minidual.config.root import Config, preset
from minidual.registry import rows_beside
from minidual.tasks.objects import with_pinch
from minidual.tasks.rod_carry import carry_task
from minidual.tasks.task import Task

_VALUES = with_pinch(rows_beside(__file__))


def pot_lift(config: Config) -> Task:
    """Return the task."""
    text = "Lift the pot by both handles and put it on the green plate."
    return carry_task("pot_lift", text, preset(config, _VALUES), "pot-trial")
