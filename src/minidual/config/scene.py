"""Configuration of the simulated world: physics, the rod, the cameras and the randomisation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from minidual.config.base import StrictModel

PositiveFloat = Annotated[float, Field(gt=0.0)]


class PhysicsConfig(StrictModel):
    """Solver settings; the values are those under which a pinched rod does not creep."""

    timestep_s: float = Field(default=0.001, gt=0.0, le=0.002)
    impratio: float = Field(default=100.0, ge=1.0, le=1000.0)
    finger_kp_n_per_m: float = Field(default=5000.0, gt=0.0, le=50000.0)
    finger_kv_ns_per_m: float = Field(default=100.0, ge=0.0, le=5000.0)
    finger_force_max_n: float = Field(default=70.0, gt=0.0, le=140.0)


class RodConfig(StrictModel):
    """The carried object: an aluminium rod, or what tasks/objects.py puts in its place.

    Its long axis is y. A cylinder has a radius; a box a width (x, between the fingers) and a height.
    """

    shape: Literal["cylinder", "box"] = "cylinder"

    length_m: float = Field(default=0.30, gt=0.1, le=0.6)
    radius_m: float = Field(default=0.00887, gt=0.003, le=0.03)
    width_m: float = Field(default=0.05, gt=0.005, le=0.07)
    """Of a box, between the fingers; a hand opens to 80 mm."""
    height_m: float = Field(default=0.05, gt=0.005, le=0.2)
    """Of a box."""
    mass_kg: float = Field(default=0.2, gt=0.01, le=3.0)
    friction: float = Field(default=0.5, gt=0.05, le=2.0)
    rolling_friction: float = Field(default=0.002, ge=0.0, le=0.1)
    grasp_offset_m: float = Field(default=0.12, gt=0.03, le=0.25)
    """Distance of each hand from the rod's centre."""
    grasp_height_m: float = Field(default=0.003, ge=-0.01, le=0.02)
    """Height of the tool centre point over the rod's axis."""
    break_force_n: float | None = Field(default=None, gt=0.0)
    """Net force of one hand at which the object breaks; None for one that does not."""
    break_pinch_n: float | None = Field(default=None, gt=0.0)
    """Pinch of one hand at which the object breaks."""
    colour: tuple[float, float, float, float] = (0.96, 0.45, 0.09, 1.0)

    @property
    def half_width_m(self) -> float:
        """Half of what lies between the fingers."""
        return self.radius_m if self.shape == "cylinder" else self.width_m / 2

    @property
    def rest_height_m(self) -> float:
        """Height of the axis over the table while it rests."""
        return self.radius_m if self.shape == "cylinder" else self.height_m / 2

    @property
    def inertia_kg_m2(self) -> tuple[float, float, float]:
        """Principal moments about x, y (the long axis) and z of a body of uniform density."""
        m, length = self.mass_kg, self.length_m
        if self.shape == "cylinder":
            across = m * (3 * self.radius_m**2 + length**2) / 12.0
            return across, 0.5 * m * self.radius_m**2, across
        w, h = self.width_m, self.height_m
        return m * (length**2 + h**2) / 12.0, m * (w**2 + h**2) / 12.0, m * (w**2 + length**2) / 12.0

    @model_validator(mode="after")
    def _hands_on_rod(self) -> RodConfig:
        if self.grasp_offset_m > self.length_m / 2:
            raise ValueError(f"grasp_offset_m {self.grasp_offset_m} lies beyond the rod's end at {self.length_m / 2}")
        return self


class ObstacleConfig(StrictModel):
    """A block that stands on the table; nothing may touch it."""

    size_m: tuple[float, float, float] = (0.30, 0.04, 0.10)
    """Length along x, y and z."""
    xy_m: tuple[float, float] = (0.5, 0.0)


class TaskConfig(StrictModel):
    """Start, goal and limits of one rod trial."""

    start_xy_m: tuple[float, float] = (0.5, 0.25)
    goal_xy_m: tuple[float, float] = (0.5, -0.25)
    goal_yaw_rad: float = Field(default=0.0, ge=-3.2, le=3.2)
    """Direction in which the rod must lie at the goal."""
    yaw_tolerance_rad: float | None = Field(default=None, gt=0.0, le=1.0)
    """Largest error of that direction; None judges the place alone."""
    obstacle: ObstacleConfig | None = None
    lift_height_m: float = Field(default=0.12, gt=0.03, le=0.4)
    """Height to which a method lifts the rod's axis above its resting height."""
    start_range_m: float = Field(default=0.05, ge=0.0, le=0.1)
    start_range_rad: float = Field(default=0.2618, ge=0.0, le=0.6)
    """Start pose is uniform within +-range about the nominal one (15 degrees)."""
    clear_height_m: float = Field(default=0.04, gt=0.0, le=0.3)
    """The rod must rise at least this far."""
    tilt_max_rad: float = Field(default=0.08727, gt=0.0, le=0.3)
    """Five degrees between the rod's axis and the horizontal."""
    goal_tolerance_m: float = Field(default=0.02, gt=0.0, le=0.1)
    pinch_min_n: float = Field(default=20.0, gt=0.0)
    internal_force_min_n: float = Field(default=20.0, gt=0.0)
    rest_speed_m_per_s: float = Field(default=0.02, gt=0.0)
    time_limit_s: float = Field(default=15.0, gt=1.0, le=60.0)


class CameraConfig(StrictModel):
    """The recorded images."""

    width_px: int = Field(default=128, ge=32, le=1920)
    height_px: int = Field(default=96, ge=24, le=1080)
    supersample: int = Field(default=2, ge=1, le=4)
    """Render this many times larger and average. A pixel spans 8 mm of the table; without averaging an edge inside
    it leaves no trace, with it the shade of the pixel tells where the edge is."""


class SceneConfig(StrictModel):
    """Everything that shapes the simulated world."""

    physics: PhysicsConfig = PhysicsConfig()
    rod: RodConfig = RodConfig()
    task: TaskConfig = TaskConfig()
    camera: CameraConfig = CameraConfig()
