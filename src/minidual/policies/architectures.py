"""Descriptions of policies' networks, by the name that tables and reports print.

The command `train-act`, the method `act` and the keys of JSON files keep their names.
"""

from typing import NamedTuple


class Architecture(NamedTuple):
    """A network in words.

    Attributes:
        name: As tables print it.
        summary: What sees the pictures, and what the transformer gets.
        beside: What was measured of it beside another network, or "".
    """

    name: str
    summary: str
    beside: str = ""


KEYFRAME_ACT = Architecture(
    "keyframe_act",
    "a supervised head reads the next grasp and release postures from the picture; "
    "ACT's transformer gets these and the joints, and no image feature",
    "LeRobot's stock ACT, trained for an equal time on the same pictures, carried 8 of 100 rods, "
    "and 5 of 100 in a changed room",
)
KEYPOINT_ACT = Architecture(
    "keypoint_act",
    "ACT's transformer gets image keypoints and the joints; the demonstrations have no keyframes",
)
STOCK_ACT = Architecture("stock_act", "LeRobot's ACT with a resnet18 for each picture")
KEYFRAME_DIFFUSION = Architecture(
    "keyframe_diffusion",
    "the head of keyframe_act reads the next grasp and release postures; the UNet of LeRobot's "
    "diffusion policy gets these and the joints, and denoises chunks of actions",
)
KEYPOINT_DIFFUSION = Architecture(
    "keypoint_diffusion",
    "the UNet of LeRobot's diffusion policy gets image keypoints and the joints; the demonstrations "
    "have no keyframes",
)
STOCK_DIFFUSION = Architecture(
    "diffusion",
    "LeRobot's diffusion policy: a small one-dimensional UNet denoises chunks of actions, given the "
    "keypoints of a resnet18 for each picture and the joints",
)
_ROWS = (
    KEYFRAME_ACT,
    KEYPOINT_ACT,
    STOCK_ACT,
    KEYFRAME_DIFFUSION,
    KEYPOINT_DIFFUSION,
    STOCK_DIFFUSION,
)
_ARCHITECTURES = {row.name: row for row in _ROWS}


def architecture(name: str) -> Architecture:
    """Return the description of a network; of another distribution's, only its name."""
    return _ARCHITECTURES.get(name, Architecture(name, ""))
