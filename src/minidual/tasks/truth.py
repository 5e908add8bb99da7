"""True state of a task's objects: what the conditions of success read, and methods never do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from minidual.config.scene import ObjectConfig
from minidual.plant.bodies import HAND_FORCES, INTERNAL_FORCE, PINCHES, YAW, lie
from minidual.robot.pair import Array

if TYPE_CHECKING:  # reading a configuration must not import MuJoCo
    from minidual.config.scene import PartConfig
    from minidual.plant.bodies import Vector

AIRBORNE_M = 0.003
"""An object is off the table above this clearance."""
TOUCH_N = 0.1
"""Smaller forces do not count as touch."""


class TrueObject(Protocol):
    """One object of a ground truth; see `plant.bodies.NamedObject`."""

    @property
    def frame(self) -> tuple[Array, Array]:
        """Orientation (3, 3) and position (3,) [m] in the world."""
        ...

    def look(self) -> Array:
        """Return pose, hand forces and pinches (16,)."""
        ...

    def solids(self, parts: Sequence[PartConfig]) -> list[tuple[Vector, Vector]]:
        """Return centre and half extents (3,) [m] of its parts, in its frame."""
        ...

    def pose(self) -> Array:
        """Return the pose (4, 4)."""
        ...

    def twist(self) -> Array:
        """Return the twist (6,)."""
        ...


class GroundTruth(Protocol):
    """True state of objects and contacts: a simulated world, for the judge only."""

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        ...

    def truth(self, name: str | None = None) -> TrueObject:
        """Return an object, None for the only one."""
        ...

    def on_table(self, name: str | None = None) -> bool:
        """Return whether an object touches the table."""
        ...

    def at_an_arm(self, name: str | None = None) -> bool:
        """Return whether an object touches an arm."""
        ...

    def touches(self, geom: str) -> bool:
        """Return whether a geom has contacts."""
        ...

    def mark_goal(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Show the goal on the table."""
        ...


class ObjectTruth:
    """True state of one object.

    Attributes:
        xyz: (x, y, z) [m] of its centre.
        tilt_rad: Of its long axis from the horizontal, or from the vertical if upright.
        solids: (k, 8), for each part its place (3) and half extents (3) [m] in the object's frame,
            whether it is round, and its axis; with the sizes of this trial.
        half_m: Half extents [m] of the first part.
        reach_m: Distance of its farthest end from its centre, horizontally.
        clearance_m: Height of its lowest point above the table.
        airborne: Whether it is off the table.
        pinch: Normal force of the weaker finger of the left and the right hand [N].
        squeeze_n: Internal force: the smaller inward hand force along y.
        yaw_rad: Yaw of its y axis.
    """

    def __init__(self, name: str, body: ObjectConfig) -> None:
        self.name = name
        self.body = body
        self._upright = body.upright
        self.half_m: Sequence[float] = body.solids[0].half_m
        self.reach_m = 0.0
        self._ground: GroundTruth | None = None

    def refresh(self, ground: GroundTruth) -> None:
        """Read the ground truth."""
        if ground is not self._ground:
            self._attach(ground)
        reading = self._object.look()
        self.tilt_rad, self.clearance_m = lie(reading, self.solids, self._upright)
        self.airborne = self.clearance_m > AIRBORNE_M
        # Plain floats: conditions that compute with arrays take four times as long.
        numbers: list[float] = reading.tolist()
        self.xyz = (numbers[0], numbers[1], numbers[2])
        self._left_force = numbers[HAND_FORCES : HAND_FORCES + 3]
        self._right_force = numbers[HAND_FORCES + 3 : PINCHES]
        self.pinch = (numbers[PINCHES], numbers[PINCHES + 1])
        self.squeeze_n = numbers[INTERNAL_FORCE]
        self.yaw_rad = numbers[YAW]

    def _attach(self, ground: GroundTruth) -> None:
        """Find the object, with its sizes there: a condition may have changed them."""
        self._ground = ground
        self._object = ground.truth(self.name)
        parts = self.body.solids
        rows: list[list[float]] = []
        for part, (position_m, half_m) in zip(parts, self._object.solids(parts), strict=True):
            is_round = part.shape == "cylinder"
            rows.append([*position_m, *half_m, is_round, "xyz".index(part.axis)])
        self.solids = np.array(rows)
        self.half_m = rows[0][3:6]
        ends_m = np.abs(self.solids[:, :2]) + self.solids[:, 3:5]
        self.reach_m = float(ends_m.max())

    def distance_m(self, xy: Sequence[float]) -> float:
        """Return the horizontal distance of its centre from (x, y) [m]."""
        return math.hypot(self.xyz[0] - xy[0], self.xyz[1] - xy[1])

    @property
    def place(self) -> tuple[float, float, float]:
        """Horizontal (x, y) [m] of its centre, and its yaw [rad]."""
        return self.xyz[0], self.xyz[1], self.yaw_rad

    def moved_m(self, place: tuple[float, float, float]) -> float:
        """Return how far its centre or its ends are from where they were at a `place` [m]."""
        x, y, yaw_rad = place
        turned_rad = abs(math.remainder(self.yaw_rad - yaw_rad, math.tau))
        return self.distance_m((x, y)) + self.reach_m * turned_rad

    @property
    def in_fingers(self) -> bool:
        """Whether a finger presses on it."""
        if max(self.pinch) >= TOUCH_N:
            return True
        return any(abs(force) > TOUCH_N for hand in self.hand_forces for force in hand)

    @property
    def at_an_arm(self) -> bool:
        """Whether it has a contact with any part of an arm."""
        return self._ground is not None and self._ground.at_an_arm(self.name)

    @property
    def hand_forces(self) -> tuple[list[float], list[float]]:
        """Net force (3,) [N] of the left and the right hand, in the world."""
        return self._left_force, self._right_force

    @property
    def frame(self) -> tuple[Array, Array]:
        """Orientation (3, 3) and position (3,) [m] in the world; views of MuJoCo's own memory."""
        return self._object.frame

    @property
    def T(self) -> Array:
        """Pose (4, 4) in the world."""
        return self._object.pose()

    @property
    def speed_m_per_s(self) -> float:
        """Speed of its centre."""
        return math.hypot(*self._object.twist()[:3].tolist())

    @property
    def on_table(self) -> bool:
        """Whether it touches the table."""
        return self._ground is not None and self._ground.on_table(self.name)


class Truth(dict[str, ObjectTruth]):
    """True state of a task's objects, by name.

    Attributes:
        began_s: Simulated time at which the trial began.
        time: Since then [s].
        duration_s: Time of the finish, else of now; the judge sets it before `end`.
    """

    def __init__(self, objects: Mapping[str, ObjectConfig]) -> None:
        super().__init__({name: ObjectTruth(name, body) for name, body in objects.items()})
        self._ground: GroundTruth | None = None
        self.began_s = 0.0
        self.time = 0.0
        self.duration_s = 0.0

    def refresh(self, ground: GroundTruth) -> None:
        """Read the ground truth."""
        self._ground = ground
        self.time = ground.time - self.began_s
        for item in self.values():
            item.refresh(ground)

    def touches(self, geom: str) -> bool:
        """Return whether a geom has contacts."""
        return self._ground is not None and self._ground.touches(geom)
