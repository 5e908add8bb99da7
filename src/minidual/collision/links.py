"""Links of both arms; locked fingers are rigid with the last link."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from minidual.robot.description import arm_links
from minidual.robot.pair import SIDES, Robot


@dataclass(frozen=True)
class Link:
    """One link, named with its side's prefix; `joints_before` joints of its arm move it."""

    name: str
    side: str
    joints_before: int
    collides: bool


@functools.cache
def links_of(robot: Robot) -> dict[str, Link]:
    """Return all links, left arm first, base to tip."""
    return {
        f"{side}_{link.name}": Link(f"{side}_{link.name}", side, link.joints_before, link.collides)
        for side in SIDES
        for link in arm_links(robot.arm)
    }


@functools.cache
def collision_links(robot: Robot) -> tuple[str, ...]:
    """Return the names of links with collision geometry."""
    return tuple(link.name for link in links_of(robot).values() if link.collides)
