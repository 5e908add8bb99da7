"""The file of a pair of GELLO arms: ports, ids, signs, offsets and grippers."""

import math
from pathlib import Path
from typing import Annotated, Self

import numpy as np
import yaml
from pydantic import Field, ValidationError, model_validator

from minidual import durable
from minidual.config.base import StrictModel
from minidual.errors import ConfigError
from minidual.robot.pair import SIDES, Array, Robot

_Id = Annotated[int, Field(ge=0, le=252)]
_Angle = Annotated[float, Field(ge=-1000.0, le=1000.0)]
REMEDY = "docs/teleoperation.md shows a whole file; minidual leader calibrate writes the offsets"


class GelloGripper(StrictModel):
    """The servo at the trigger, and its angles with the hand open and closed."""

    id: _Id
    open_rad: _Angle
    closed_rad: _Angle

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if math.isclose(self.open_rad, self.closed_rad, abs_tol=0.05):
            raise ValueError("open_rad and closed_rad are the same within 0.05 rad")
        return self

    def opening(self, angle_rad: float) -> float:
        """Return 0 closed to 1 open."""
        share = (angle_rad - self.closed_rad) / (self.open_rad - self.closed_rad)
        return min(max(share, 0.0), 1.0)


class GelloArm(StrictModel):
    """One chain: a joint of the arm is sign * (servo - offset)."""

    port: str = Field(min_length=1)
    ids: tuple[_Id, ...] = Field(min_length=1)
    signs: tuple[int, ...]
    offsets_rad: tuple[_Angle, ...]
    gripper: GelloGripper | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, values in (("signs", self.signs), ("offsets_rad", self.offsets_rad)):
            if len(values) != len(self.ids):
                raise ValueError(f"{name} has {len(values)} entries, ids has {len(self.ids)}")
        if any(sign not in (-1, 1) for sign in self.signs):
            raise ValueError("signs are 1 or -1")
        if len(set(self.servos)) < len(self.servos):
            raise ValueError(f"an id stands twice in {list(self.servos)}")
        return self

    @property
    def servos(self) -> tuple[int, ...]:
        """All ids, joints first."""
        return self.ids if self.gripper is None else (*self.ids, self.gripper.id)

    def joints(self, servos_rad: Array) -> Array:
        """Return the joints (k,) [rad] at angles of the servos (k or k + 1,)."""
        angles = servos_rad[: len(self.ids)]
        return np.array(self.signs) * (angles - np.array(self.offsets_rad))

    def opening(self, servos_rad: Array) -> float:
        """Return the opening; 1 without a gripper."""
        return 1.0 if self.gripper is None else self.gripper.opening(float(servos_rad[-1]))


class GelloFile(StrictModel):
    """A pair of arms."""

    baud_rate: int = Field(default=57_600, ge=9600, le=4_000_000)
    left: GelloArm
    right: GelloArm

    @property
    def arms(self) -> tuple[GelloArm, GelloArm]:
        """Left and right."""
        return self.left, self.right


def read_gello_file(path: Path, robot: Robot) -> GelloFile:
    """Return the arms of a file, for a robot.

    Raises:
        ConfigError: It cannot be read, or does not fit.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        gello = GelloFile.model_validate(content)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {error}", remedy=REMEDY) from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ConfigError(f"{path}, {place}: {first['msg']}", remedy=REMEDY) from error
    for side, arm, joints_n in zip(SIDES, gello.arms, robot.dofs, strict=True):
        if len(arm.ids) != joints_n:
            raise ConfigError(
                f"{path}, {side}: {len(arm.ids)} ids; the arm has {joints_n} joints",
                remedy=REMEDY,
            )
    return gello


def write_gello_file(path: Path, gello: GelloFile) -> None:
    """Replace the file."""
    text = yaml.safe_dump(gello.model_dump(mode="json"), sort_keys=False, default_flow_style=None)
    durable.write_text(path, text)
