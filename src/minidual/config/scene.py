"""Configuration of the simulated world, its arms and their named postures."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from minidual.config.base import AtLeast, AtMost, Coordinate, Rate, Size, StrictModel

OBSTACLE = "obstacle"
DISTRACTORS = ("distractor_box", "distractor_cylinder")
DISTRACTOR_HALF_M = 0.03
"""Geoms without contacts, invisible until a condition of trials shows them."""
GRASPED_HALF_MAX_M = 0.035
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]


class PhysicsConfig(StrictModel):
    """Solver settings; a pinched object must not creep."""

    timestep_s: float = Field(default=0.001, ge=1e-5, le=0.002)
    impratio: float = Field(default=100.0, ge=1.0, le=1000.0)
    finger_kp_n_per_m: float = Field(default=5000.0, ge=1.0, le=50000.0)
    finger_kv_ns_per_m: float = Field(default=100.0, ge=0.0, le=5000.0)
    finger_force_max_n: float = Field(default=70.0, ge=0.1, le=140.0)


class PartConfig(StrictModel):
    """A convex part, in the object's frame; a cylinder lies along `axis`."""

    shape: Literal["cylinder", "box"] = "box"
    size_m: tuple[Size, Size, Size]
    position_m: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    axis: Literal["y", "z"] = "z"
    colour: tuple[Rate, Rate, Rate, Rate] = (0.10, 0.25, 0.75, 1.0)

    @property
    def half_m(self) -> tuple[float, float, float]:
        """Half extents."""
        x, y, z = self.size_m
        return x / 2, y / 2, z / 2


class ObjectConfig(StrictModel):
    """An object; its long axis is y, or z if upright.

    A cylinder has a radius, a box width and height.
    """

    name: str = Field(default="rod", pattern=r"^[a-z][a-z0-9_]*$")
    shape: Literal["cylinder", "box"] = "cylinder"
    upright: bool = False
    length_m: float = Field(default=0.30, gt=0.03, le=0.6)
    radius_m: float = Field(default=0.00887, gt=0.003, le=0.15)
    width_m: float = Field(default=0.05, gt=0.005, le=0.3)
    """Width of a box along x."""
    height_m: float = Field(default=0.05, gt=0.005, le=0.2)
    """Height of a box, or depth along y if upright."""
    mass_kg: float = Field(default=0.2, gt=0.01, le=3.0)
    friction: float = Field(default=0.5, gt=0.05, le=2.0)
    rolling_friction: float = Field(default=0.002, ge=0.0, le=0.1)
    grasp_offset_m: float = Field(default=0.12, ge=0.0, le=0.25)
    """Distance of each hand from the centre, along y or the long axis."""
    grasp_height_m: float = Field(default=0.003, ge=-0.01, le=0.2)
    """Tool centre point above the centre."""
    parts: tuple[PartConfig, ...] = ()
    """Handles."""
    break_force_n: float | None = Field(default=None, gt=0.0, le=1e4)
    """Net force of one hand; None: unbreakable."""
    break_pinch_n: float | None = Field(default=None, gt=0.0, le=1e4)
    """Of one hand."""
    colour: tuple[Rate, Rate, Rate, Rate] = (0.96, 0.45, 0.09, 1.0)
    xy_m: tuple[Coordinate, Coordinate] | None = None
    """None uses the task's start."""

    @property
    def solids(self) -> tuple[PartConfig, ...]:
        """The part with mass, then `parts`."""
        return (self._main_part, *self.parts)

    @property
    def _main_part(self) -> PartConfig:
        if self.shape == "box":
            x = self.width_m
            z = self.height_m
        else:
            x = 2.0 * self.radius_m
            z = x
        if self.upright:
            return PartConfig(
                shape=self.shape,
                size_m=(x, z, self.length_m),
                axis="z",
                colour=self.colour,
            )
        return PartConfig(
            shape=self.shape,
            size_m=(x, self.length_m, z),
            axis="y",
            colour=self.colour,
        )

    @property
    def grasped(self) -> PartConfig:
        """The part between the fingers."""
        for part in self.parts:
            if self._holds(part):
                return part
        return self._main_part

    def _holds(self, part: PartConfig) -> bool:
        """Return whether the grasp point lies in a part."""
        grasp = (0.0, self.grasp_offset_m, self.grasp_height_m)
        axes = zip(grasp, part.position_m, part.half_m, strict=True)
        return all(abs(point - centre) <= half for point, centre, half in axes)

    @property
    def half_width_m(self) -> float:
        """Half the width between the fingers."""
        return self.grasped.half_m[0]

    @property
    def rest_height_m(self) -> float:
        """Height of the centre on the table."""
        return self.solids[0].half_m[2]

    @property
    def inertia_kg_m2(self) -> tuple[float, float, float]:
        """Principal moments about x, y, z; uniform density."""
        m = self.mass_kg
        x, y, z = self.solids[0].size_m
        if self.shape == "cylinder":
            across = m * (3 * self.radius_m**2 + self.length_m**2) / 12.0
            along = 0.5 * m * self.radius_m**2
            if self.upright:
                return (across, across, along)
            return (across, along, across)
        return (m * (y**2 + z**2) / 12.0, m * (x**2 + z**2) / 12.0, m * (x**2 + y**2) / 12.0)

    @model_validator(mode="after")
    def _hands_on_it(self) -> Self:
        if self.parts and not self._holds(self.grasped):
            raise ValueError(
                f"no part holds the grasp (0, {self.grasp_offset_m}, {self.grasp_height_m})",
            )
        if not self.parts and self.grasp_offset_m > self.length_m / 2:
            raise ValueError(
                f"grasp_offset_m {self.grasp_offset_m} lies beyond the end at {self.length_m / 2}",
            )
        if self.half_width_m > GRASPED_HALF_MAX_M:
            raise ValueError(
                f"{2 * self.half_width_m} m between the fingers; at most {2 * GRASPED_HALF_MAX_M}",
            )
        return self


class ObstacleConfig(StrictModel):
    """A block on the table; touching it is a failure."""

    size_m: tuple[Size, Size, Size] = (0.30, 0.04, 0.10)
    xy_m: tuple[Coordinate, Coordinate] = (0.5, 0.0)


class MarkConfig(StrictModel):
    """A coloured rectangle or disk (diameter: x) on the table, without contacts."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    xy_m: tuple[Coordinate, Coordinate]
    size_m: tuple[Size, Size]
    yaw_rad: float = Field(default=0.0, ge=-3.2, le=3.2)
    round: bool = False
    colour: tuple[Rate, Rate, Rate, Rate]


class TaskConfig(StrictModel):
    """Start, goal and limits of a trial."""

    start_xy_m: tuple[Coordinate, Coordinate] = (0.5, 0.25)
    goal_xy_m: tuple[Coordinate, Coordinate] = (0.5, -0.25)
    goal_yaw_rad: float = Field(default=0.0, ge=-3.2, le=3.2)
    goal_range_m: AtLeast[float] = Field(default=0.05, ge=0.0, le=0.1)
    """Half width of the uniform range, drawn after the start."""
    goal_range_rad: AtLeast[float] = Field(default=0.2618, ge=0.0, le=0.6)
    mirrored_share: Rate = 0.0
    """Share of trials from the right to the left, where the task has such."""
    yaw_tolerance_rad: AtMost[float] = Field(default=0.08727, gt=0.0, le=1.0)
    """5 degrees."""
    obstacle: ObstacleConfig | None = None
    lift_height_m: float = Field(default=0.12, gt=0.03, le=0.4)
    """Rise of the object's centre during the lift."""
    start_range_m: AtLeast[float] = Field(default=0.05, ge=0.0, le=0.1)
    start_range_rad: AtLeast[float] = Field(default=0.2618, ge=0.0, le=0.6)
    """Half width of the uniform range (15 degrees)."""
    clear_height_m: AtLeast[float] = Field(default=0.04, gt=0.0, le=0.3)
    """Least rise above the table."""
    tilt_max_rad: AtMost[float] = Field(default=0.08727, gt=0.0, le=0.3)
    """5 degrees."""
    goal_tolerance_m: AtMost[float] = Field(default=0.02, gt=0.0, le=0.1)
    pinch_min_n: AtLeast[float] = Field(default=20.0, gt=0.0, le=1000.0)
    internal_force_min_n: AtLeast[float] = Field(default=20.0, gt=0.0, le=1000.0)
    rest_speed_m_per_s: AtMost[float] = Field(default=0.02, gt=0.0, le=10.0)
    time_limit_s: AtMost[float] = Field(default=15.0, gt=1.0, le=60.0)

    @property
    def distance_m(self) -> float:
        """From start to goal."""
        return round(math.dist(self.start_xy_m, self.goal_xy_m), 6)

    @property
    def turn_rad(self) -> float:
        """From start to goal."""
        return abs(self.goal_yaw_rad)

    def demands(self) -> dict[str, float]:
        """Return the distance from start to goal [m] and the turn [rad]."""
        return {"distance_m": self.distance_m, "turn_rad": self.turn_rad}


class CameraConfig(StrictModel):
    """Recorded images."""

    width_px: int = Field(default=128, ge=32, le=1920)
    height_px: int = Field(default=96, ge=24, le=1080)
    supersample: int = Field(default=2, ge=1, le=4)
    """Images are rendered this many times larger and averaged: a pixel is 8 mm."""


class SceneConfig(StrictModel):
    """The world."""

    physics: PhysicsConfig = PhysicsConfig()
    object: ObjectConfig = ObjectConfig()
    more: tuple[ObjectConfig, ...] = ()
    marks: tuple[MarkConfig, ...] = ()
    """Instead of those of start and goal; later ones lie above."""
    task: TaskConfig = TaskConfig()
    camera: CameraConfig = CameraConfig()

    @property
    def objects(self) -> dict[str, ObjectConfig]:
        """Objects by name, the carried one first."""
        return {item.name: item for item in (self.object, *self.more)}

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        if len(self.objects) < 1 + len(self.more):
            names = ", ".join(item.name for item in (self.object, *self.more))
            raise ValueError(f"two objects have one name: {names}")
        return self


class RobotConfig(StrictModel):
    """The arms."""

    arm: str = Field(default="panda", min_length=1)
    """Row of robot.models.ARM_MODELS."""
    right_arm: str | None = Field(default=None, min_length=1)
    """Another row for the right arm; None: the same."""
    packages: dict[str, str] = Field(default={})
    """Folder of each package of a URDF's package:// that is no installed distribution."""


class NamedStateConfig(StrictModel):
    """A posture of one or both arms."""

    left_rad: tuple[Angle, ...] | None = None
    """Base first."""
    right_rad: tuple[Angle, ...] | None = None
    description: str = ""


class SemanticsConfig(StrictModel):
    """Named states."""

    states: dict[str, NamedStateConfig] = Field(default={})
    """Added to the arm model's states (`home` and others), or replace them."""
