"""The table of arms, from arms.yaml."""

from typing import Any

from minidual.config.scene import RobotConfig
from minidual.registry import Registry, rows_beside
from minidual.robot.pair import ArmModel, HandModel, Robot


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


_ROWS = _frozen(rows_beside(__file__))
HANDS = {name: HandModel(name, **row) for name, row in _ROWS["hands"].items()}
ARM_MODELS: Registry[ArmModel] = Registry("arm", group="minidual.arms")
for _name, _row in _ROWS["arms"].items():
    _row["hand"] = HANDS[_row["hand"]]
    ARM_MODELS.add(_name, ArmModel(name=_name, **_row))
PANDA, PANDA_HAND = ARM_MODELS["panda"], HANDS["panda_hand"]
DUAL_PANDA = Robot(PANDA)


def robot_from(config: RobotConfig) -> Robot:
    """Return the configured robot; UsageError for unknown arms."""
    return Robot(ARM_MODELS[config.arm])
