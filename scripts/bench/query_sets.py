"""What the hard planning sets draw: a shelf, a gate for a held rod, crossing hands, 20 boxes, tasks' scenes.

Each query draws one region for its start and one for its goal, by hand. `sets/` has the scenes, as
files for `minidual plan --scene`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.collision.shapes import Box, Shape
from minidual.registry import Registry
from minidual.robot.pair import Array, pose, rot_x, rot_z
from minidual.tasks.catalogue import TASKS

_FACING = {
    "down": rot_x(np.pi),
    "ahead": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "level": np.eye(3),
}

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Region:
    """Where poses are drawn.

    Attributes:
        low_m: Lower corner in the world, for the left hand; the right hand's is mirrored in y.
        high_m: Upper corner.
        facing: Where the hand points: "down", or "ahead" along x. A rod that is "level" lies along y.
        tilt_rad: Largest tilt about any axis across that.
        turn_rad: Largest turn about its own axis.
    """

    low_m: Point
    high_m: Point
    facing: str
    tilt_rad: float
    turn_rad: float = 3.1416

    def draw(self, rng: np.random.Generator, *, mirrored: bool) -> Array:
        """Return a pose (4, 4)."""
        position = rng.uniform(self.low_m, self.high_m)
        tilt_axis_rad = rng.uniform(-np.pi, np.pi)
        turn_rad = rng.uniform(-self.turn_rad, self.turn_rad)
        tilt_rad = rng.uniform(0.0, self.tilt_rad)
        lean = rot_z(tilt_axis_rad) @ rot_x(tilt_rad) @ rot_z(-tilt_axis_rad)
        if mirrored:
            position[1] = -position[1]
        return pose(_FACING[self.facing] @ lean @ rot_z(turn_rad), position)


@dataclass(frozen=True)
class Boxes:
    """Boxes of one size range.

    Attributes:
        standing_n: Number of boxes on the table.
        floating_n: Number of boxes in the air.
        size_m: Range of the edges.
        low_m: Lower corner of where they are centred.
        high_m: Upper corner.
    """

    standing_n: int
    floating_n: int
    size_m: tuple[float, float]
    low_m: Point
    high_m: Point

    def draw(self, rng: np.random.Generator) -> tuple[Shape, ...]:
        """Return the boxes of one query."""
        boxes = []
        for k in range(self.standing_n + self.floating_n):
            size = rng.uniform(*self.size_m, 3)
            centre = rng.uniform(self.low_m, self.high_m)
            half_yaw = rng.uniform(-np.pi / 4, np.pi / 4)
            if k < self.standing_n:
                centre[2] = 0.5 * size[2]
            quaternion = (float(np.cos(half_yaw)), 0.0, 0.0, float(np.sin(half_yaw)))
            boxes.append(
                Box(f"box{k}", tuple(centre.tolist()), quaternion, tuple(size.tolist())),
            )
        return tuple(boxes)


@dataclass(frozen=True)
class QuerySet:
    """What a set draws.

    Attributes:
        name: Of the set.
        start: Regions of the start.
        goal: Regions of the goal.
        boxes: Extra boxes in each query.
        rod: Whether both hands hold the rod; the regions are then the rod's.
        task: Task whose objects stand where a trial puts them; hands that take one first go over
            their grasps, the others to the region. Empty: `scene_file` stands there.
    """

    name: str
    start: tuple[Region, ...]
    goal: tuple[Region, ...]
    boxes: Boxes | None = None
    rod: bool = False
    task: str = ""

    @property
    def scene_file(self) -> Path:
        """What stands there in every query, but for `task`."""
        return Path(__file__).with_name("sets") / f"{self.name}.yaml"


_BEFORE_SHELF = Region((0.28, 0.1, 0.1), (0.42, 0.45, 0.4), "down", tilt_rad=0.4)
_LOWER_SHELF = Region((0.55, 0.05, 0.29), (0.68, 0.4, 0.41), "ahead", tilt_rad=0.3, turn_rad=0.6)
_UPPER_SHELF = Region((0.55, 0.05, 0.55), (0.68, 0.4, 0.67), "ahead", tilt_rad=0.3, turn_rad=0.6)
_OWN_SIDE = Region((0.35, 0.1, 0.12), (0.6, 0.4, 0.45), "down", tilt_rad=0.5)
_OTHER_SIDE = Region((0.35, -0.35, 0.12), (0.6, -0.05, 0.45), "down", tilt_rad=0.5)
_OVER_TABLE = Region((0.3, -0.15, 0.08), (0.65, 0.55, 0.45), "down", tilt_rad=0.6)
_BEFORE_GATE = Region((0.3, -0.1, 0.1), (0.4, 0.1, 0.4), "level", tilt_rad=0.25, turn_rad=0.6)
_BEHIND_GATE = Region((0.58, -0.1, 0.1), (0.68, 0.1, 0.4), "level", tilt_rad=0.25, turn_rad=0.6)

_TWENTY_BOXES = Boxes(
    standing_n=10,
    floating_n=10,
    size_m=(0.03, 0.1),
    low_m=(0.3, -0.6, 0.1),
    high_m=(0.8, 0.6, 0.7),
)

_OF_SCENES = (
    QuerySet(
        "shelf",
        start=(_BEFORE_SHELF, _LOWER_SHELF, _UPPER_SHELF),
        goal=(_LOWER_SHELF, _UPPER_SHELF),
    ),
    QuerySet("gate", start=(_BEFORE_GATE,), goal=(_BEHIND_GATE,), rod=True),
    QuerySet("crossing", start=(_OWN_SIDE,), goal=(_OTHER_SIDE,)),
    QuerySet("clutter", start=(_OVER_TABLE,), goal=(_OVER_TABLE,), boxes=_TWENTY_BOXES),
)
_OF_TASKS = tuple(
    QuerySet(task, start=(_OVER_TABLE,), goal=(_OVER_TABLE,), task=task)
    for task in TASKS
    if task != "rod_carry"  # its move is the gate's
)

SETS: Registry[QuerySet] = Registry(
    "query set",
    {query_set.name: query_set for query_set in (*_OF_SCENES, *_OF_TASKS)},
)
