"""The links that can collide, and which of them move together.

The fingers are locked in planning, so link 7, the hand and the fingers are one rigid piece.
"""

from __future__ import annotations

from minidual.robot.constants import ARMS, DOF_PER_ARM

_ARM_LINKS: tuple[str, ...] = (
    *(f"panda_link{i}" for i in range(8)),
    "panda_hand",
    "panda_leftfinger",
    "panda_rightfinger",
)
_END_LINKS = ("panda_link8", "panda_hand_tcp")

LINKS: tuple[str, ...] = tuple(f"{arm}_{link}" for arm in ARMS for link in _ARM_LINKS)
"""Every link with collision geometry, left arm first."""


def links_of(arm: str) -> tuple[str, ...]:
    """Return the collision links of one arm, from the base out."""
    return tuple(f"{arm}_{link}" for link in _ARM_LINKS)


def arm_of(link: str) -> str | None:
    """Return "left" or "right" for a link of an arm, None for anything else."""
    arm = link.split("_", 1)[0]
    return arm if arm in ARMS and (link in LINKS or link.removeprefix(f"{arm}_") in _END_LINKS) else None


def joints_before(link: str) -> int:
    """Return how many joints of its arm move a link: 0 for the base, 7 for the hand."""
    suffix = link.split("_", 1)[1]
    digits = suffix.removeprefix("panda_link")
    return min(int(digits), DOF_PER_ARM) if digits.isdigit() else DOF_PER_ARM
