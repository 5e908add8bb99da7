"""The links of a pair of arms, and what moves each.

The fingers are locked in planning, so what hangs on the last joint is one rigid piece.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

from minidual.robot.description import arm_links
from minidual.robot.pair import SIDES, Robot


@dataclass(frozen=True)
class Link:
    """A link of one of the two arms.

    Attributes:
        name: With the side's prefix.
        side: "left" or "right".
        joints_before: How many joints of its arm move it: 0 for the base.
        collides: Whether it has collision geometry.
    """

    name: str
    side: str
    joints_before: int
    collides: bool


@functools.cache
def links_of(robot: Robot) -> dict[str, Link]:
    """Return every link by name, left arm first, from the base out."""
    return {
        f"{side}_{link.name}": Link(f"{side}_{link.name}", side, link.joints_before, link.collides)
        for side in SIDES
        for link in arm_links(robot.arm)
    }


@functools.cache
def collision_links(robot: Robot) -> tuple[str, ...]:
    """Return the names of the links with collision geometry, left arm first."""
    return tuple(link.name for link in links_of(robot).values() if link.collides)
