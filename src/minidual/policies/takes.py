"""Names of a policy's inputs and outputs: `takes.json` beside its weights."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from minidual import durable
from minidual.config.base import StrictModel
from minidual.demos.lerobot_features import camera_key, camera_name, state_names
from minidual.durable import read_json
from minidual.errors import DataError, UsageError, shortened
from minidual.robot.pair import Robot

FILE = "takes.json"
_GRIPPER = "gripper"
_RATE_SHARE_MAX = 0.02
"""Largest relative difference of two rates that count as one."""
_OTHER_ROBOT = (
    "it drives the robot that it was trained on. For these arms: minidual teleop-record, then "
    "minidual train-act; arms of another model: --set robot.arm=NAME"
)


class Takes(StrictModel):
    """Names of a policy's inputs and outputs.

    Attributes:
        state, action: Entries of a state and of an action.
        inputs: {recorded signal: entries} that the policy reads behind the state, in this order.
        instructions: Of a policy for several tasks, which reads behind the inputs the one that
            holds (`policies.instructed`); else none.
        cameras: (H, W) by feature, such as "observation.images.cam_high".
        rate_hz: Of its ticks.
        robot: Type of the robot, or "".
        radians: Whether joints are known to be in radians, and openings from 0 to 1.
    """

    state: tuple[str, ...] = Field(min_length=1)
    action: tuple[str, ...] = Field(min_length=1)
    inputs: dict[str, Annotated[int, Field(ge=1, le=4096)]] = Field(default={})
    instructions: tuple[str, ...] = ()
    cameras: dict[str, tuple[int, int]] = Field(default={})
    rate_hz: float = Field(gt=0.0)
    robot: str = ""
    radians: bool = False

    def with_cameras(self, sizes: Mapping[str, tuple[int, int]]) -> "Takes":
        """Return the same with pictures of these sizes (H, W) by camera."""
        cameras = {camera_key(name): size for name, size in sizes.items()}
        return self.model_copy(update={"cameras": cameras})

    def text(self) -> list[str]:
        """Return a line for each input and output."""
        pictures = [f"{key} {height} x {width}" for key, (height, width) in self.cameras.items()]
        inputs = [f"{name} ({entries})" for name, entries in self.inputs.items()]
        return [
            f"state of {len(self.state)}: {shortened(self.state)}",
            *([f"inputs: {', '.join(inputs)}"] if inputs else []),
            *([f"instructions: {'; '.join(self.instructions)}"] if self.instructions else []),
            f"action of {len(self.action)}: {shortened(self.action)}",
            f"pictures: {', '.join(pictures) or 'none'}",
            f"rate: {self.rate_hz:g} Hz",
        ]


def gripper_columns(names: Sequence[str]) -> list[int]:
    """Return which entries are openings of a gripper."""
    return [k for k, name in enumerate(names) if _GRIPPER in name.casefold()]


def write_takes(takes: Takes, folder: Path) -> None:
    """Write the file into a checkpoint folder."""
    text = takes.model_dump_json(indent=1)
    (folder / FILE).write_text(text + "\n", encoding="utf-8")


def read_takes(checkpoint: Path) -> Takes | None:
    """Return the inputs and outputs of a checkpoint's policy, None if they are not recorded.

    Raises:
        DataError: The file is damaged.
    """
    path = checkpoint / FILE
    if not path.is_file():
        return None
    with durable.reading(path, "train the policy again"):
        try:
            return Takes.model_validate(read_json(path), strict=False)
        except ValidationError as error:
            first = error.errors()[0]
            raise DataError(
                f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}"
            ) from error


def require_arms(takes: Takes, checkpoint: Path, robot: Robot, cameras: Sequence[str]) -> None:
    """Refuse a policy of other joints than the robot's, or of cameras that do not exist here.

    Raises:
        UsageError: With the names that differ.
    """
    expected = state_names(robot)
    for word, names in (("state", takes.state), ("action", takes.action)):
        if names == expected:
            continue
        if sorted(names) == sorted(expected):
            difference = "in another order"
        else:
            difference = f"not {shortened(expected)}"
        raise UsageError(
            f"the policy {checkpoint} has another {word} than two {robot.name} arms: "
            f"{shortened(names)} ({len(names)}), {difference} ({len(expected)})",
            remedy=_OTHER_ROBOT,
        )
    for key in takes.cameras:
        if camera_name(key) not in cameras:
            raise UsageError(
                f"the policy {checkpoint} looks through the camera '{camera_name(key)}'; "
                f"there are {', '.join(cameras)}",
                remedy="train with pictures of cameras that are here: train-act --cameras NAMES",
            )


def require_scene(
    takes: Takes,
    checkpoint: Path,
    size: tuple[int, int],
    rate_hz: float,
) -> None:
    """Refuse a policy of other pictures or of another rate than the scene's.

    Args:
        takes: What the policy takes.
        checkpoint: For messages.
        size: Height and width of the scene's pictures.
        rate_hz: Rate of its ticks.

    Raises:
        UsageError: With both values.
    """
    for key, own in takes.cameras.items():
        if own != size:
            raise UsageError(
                f"the policy {checkpoint} was trained on pictures of {own[0]} x {own[1]} from "
                f"'{camera_name(key)}'; here they are {size[0]} x {size[1]}",
                remedy=f"--set scene.camera.height_px={own[0]} --set scene.camera.width_px={own[1]}",
            )
    if not np.isclose(takes.rate_hz, rate_hz, rtol=_RATE_SHARE_MAX):
        raise UsageError(
            f"the policy {checkpoint} was trained at {takes.rate_hz:g} Hz; "
            f"the arms are commanded at {rate_hz:g} Hz",
            remedy=f"--set teleop.rate_hz={takes.rate_hz:g} (40 to 100), or record at that rate",
        )
