"""Functions of the sticks, triggers and buttons of a gamepad: a table that people edit."""

from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field, ValidationError, field_validator

from minidual.config.base import StrictModel
from minidual.demos.station import Button
from minidual.errors import ConfigError

Motion = Literal["x", "y", "z", "roll", "pitch", "yaw", "close"]
MOTIONS: tuple[Motion, ...] = ("x", "y", "z", "roll", "pitch", "yaw")
CLUTCH = "clutch"
STOP = "stop"
SHIFTS = ("left_shift", "right_shift")
ACTIONS = (*Button, CLUTCH, STOP, *SHIFTS)


class AxisRow(StrictModel):
    """Function of a stick or trigger; see gamepad.yaml."""

    hand: Literal["left", "right"]
    moves: Motion
    sign: Literal[-1, 1] = 1
    shifted: Motion | None = None
    shifted_sign: Literal[-1, 1] = 1


class GamepadMapping(StrictModel):
    """Names of evdev, such as ABS_X and BTN_SOUTH, with their functions."""

    axes: dict[str, AxisRow] = Field(min_length=1)
    buttons: dict[str, str] = Field(default={})

    @field_validator("buttons")
    @classmethod
    def _actions(cls, buttons: dict[str, str]) -> dict[str, str]:
        for code, text in buttons.items():
            for action in text.split():
                if action not in ACTIONS:
                    raise ValueError(
                        f"{code}: no action '{action}'; there are {', '.join(ACTIONS)}"
                    )
        return buttons


def read_mapping(path: Path) -> GamepadMapping:
    """Return the mapping of a file.

    Raises:
        ConfigError: It cannot be read, or a row is wrong.
    """
    remedy = "copy demos/leaders/gamepad.yaml of the package and edit the copy"
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return GamepadMapping.model_validate(content)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {error}", remedy=remedy) from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{path}, {place}: {first['msg']}", remedy=remedy) from error
