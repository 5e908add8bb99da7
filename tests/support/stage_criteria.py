"""The criteria that each stage declares."""

from __future__ import annotations

from types import ModuleType

from minidual.gate.criterion import Criterion
from minidual.stages import (
    benchmark,
    carry,
    deploy_checks,
    plan_criteria,
    teleop_record,
    train_act,
)
from minidual.stages.env_check import criteria as env_check_criteria

MODULES = {
    "env-check": env_check_criteria,
    "plan": plan_criteria,
    "carry": carry,
    "teleop-record": teleop_record,
    "train-act": train_act,
    "deploy": deploy_checks,
    "benchmark": benchmark,
}


def criteria_of(module: ModuleType) -> list[Criterion]:
    """Return the criteria that a module declares, alone or in a tuple."""
    values = list(vars(module).values())
    values += [item for value in values if isinstance(value, tuple) for item in value]
    return [value for value in values if isinstance(value, Criterion)]
