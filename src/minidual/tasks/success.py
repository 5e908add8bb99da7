"""The one success test of a rod trial. It watches physics alone and needs two arms.

Whatever drives the arms (planner, impedance, policy, a person) is judged by the same predicate:

* held      both hands pinch with more than 20 N at every instant the rod is off the table,
* rose      the rod rises clear of the table,
* level     its tilt stays under 5 degrees,
* arrived   it lies within 2 cm of the goal,
* released  no hand touches it any more,
* at_rest   it lies on the table and does not move,
* on_time   all that before the time limit,
* squeezed  (impedance only) the internal force stays over 20 N while the rod is off the table,
* whole     an object that can break never feels more than it stands,
* clear     nothing touches the obstacle, where the task has one,
* turned    it points as the goal asks, where the task asks for a direction.

The 20 N of `squeezed` are a value of the scene (`task.internal_force_min_n`). One object has another: the glass, whose
own range of forces ends below 20 N, must be squeezed with at least the low end of that range, 10 N.

A rod pushed along the table never rises; a rod lifted by one hand is not held. Ground truth is read here,
for scoring, and handed to nobody.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.model import OBSTACLE
from minidual.plant.world import World
from minidual.robot.constants import Array
from minidual.tasks.rod_carry import RodTrial, tilt_rad

_AIRBORNE_M = 0.003
"""The rod counts as lifted when its lower end is this far above its resting height."""
_REST_S = 0.1
"""The rod counts as put down when it has lain released and at rest for this long: for an instant, a rod let go a
millimetre above the table is at rest too."""


@dataclass(frozen=True)
class Fault:
    """What failed, when it first did, and by how much."""

    name: str
    at_s: float
    detail: str


@dataclass(frozen=True)
class Outcome:
    """The verdict on one trial and the extremes it rests on."""

    success: bool
    faults: tuple[Fault, ...]
    duration_s: float
    goal_error_m: float
    yaw_error_rad: float
    tilt_max_rad: float
    rise_m: float
    pinch_min_n: float
    internal_force_min_n: float

    @property
    def reason(self) -> str:
        """Return the first fault as one line, or an empty string."""
        if not self.faults:
            return ""
        first = min(self.faults, key=lambda f: f.at_s)
        return f"{first.name} at {first.at_s:.2f} s: {first.detail}"


@dataclass
class RodCarryJudge:
    """Watches one trial; call `observe` after every physics step and `outcome` at the end.

    Args:
        scene: Holds the limits.
        trial: Holds the goal.
        demand_internal_force: Judge the squeeze as well (impedance trials).
    """

    scene: SceneConfig
    trial: RodTrial
    demand_internal_force: bool = False
    _faults: dict[str, Fault] = field(default_factory=dict)
    _was_airborne: bool = False
    _rise: float = 0.0
    _tilt: float = 0.0
    _pinch: float = np.inf
    _squeeze: float = np.inf
    _quiet_since: float | None = None
    _done_at: float | None = None

    def observe(self, world: World) -> None:
        """Take one instant into account."""
        task, rod = self.scene.task, self.scene.rod
        T = world.object_pose()
        tilt = tilt_rad(T)
        rest = rod.rest_height_m
        low_end = T[2, 3] - 0.5 * rod.length_m * abs(T[2, 1]) - rest
        self._rise = max(self._rise, low_end)
        self._tilt = max(self._tilt, tilt)
        if tilt > task.tilt_max_rad:
            self._fault(
                "level", world.time, f"tilt {np.degrees(tilt):.1f} deg, limit {np.degrees(task.tilt_max_rad):.1f}"
            )
        pinch = world.pinch()
        self._observe_damage(world, pinch)
        if low_end > _AIRBORNE_M:
            self._was_airborne = True
            self._quiet_since = self._done_at = None
            weakest = int(np.argmin(pinch))
            self._pinch = min(self._pinch, float(pinch[weakest]))
            if pinch[weakest] <= task.pinch_min_n:
                hand = ("left", "right")[weakest]
                self._fault(
                    "held", world.time, f"{hand} hand pinches {pinch[weakest]:.1f} N, needs > {task.pinch_min_n:.0f}"
                )
            squeeze = world.internal_force()
            self._squeeze = min(self._squeeze, squeeze)
            if self.demand_internal_force and squeeze <= task.internal_force_min_n:
                self._fault(
                    "squeezed", world.time, f"internal force {squeeze:.1f} N, needs > {task.internal_force_min_n:.0f}"
                )
        elif self._was_airborne:
            if not self._finished(world, pinch):
                self._quiet_since = self._done_at = None
            elif self._quiet_since is None:
                self._quiet_since = world.time
            elif self._done_at is None and world.time - self._quiet_since >= _REST_S:
                self._done_at = world.time

    def _observe_damage(self, world: World, pinch: Array) -> None:
        """Look for what nothing later can mend: a broken object, an obstacle touched."""
        rod = self.scene.rod
        if rod.break_pinch_n is not None and float(pinch.max()) > rod.break_pinch_n:
            self._fault(
                "whole",
                world.time,
                f"the object broke: pinch {float(pinch.max()):.1f} N, it stands {rod.break_pinch_n:.0f}",
            )
        if rod.break_force_n is not None:
            force = float(np.linalg.norm(world.object_forces(), axis=1).max())
            if force > rod.break_force_n:
                self._fault(
                    "whole",
                    world.time,
                    f"the object broke: a hand pressed with {force:.1f} N, it stands {rod.break_force_n:.0f}",
                )
        if self.scene.task.obstacle is not None and world.touches(OBSTACLE):
            self._fault("clear", world.time, "something touches the obstacle")

    def _finished(self, world: World, pinch: Array) -> bool:
        position_error, yaw_error = self.goal_errors(world)
        tolerance = self.scene.task.yaw_tolerance_rad
        return (
            position_error < self.scene.task.goal_tolerance_m
            and (tolerance is None or yaw_error < tolerance)
            and float(pinch.max()) < 0.1
            and float(np.linalg.norm(world.object_twist()[:3])) < self.scene.task.rest_speed_m_per_s
            and not self._touched(world)
            and world.on_table()
        )

    @staticmethod
    def _touched(world: World) -> bool:
        left, right = world.contact_wrenches()
        return bool(np.abs(left.force).max() > 0.1 or np.abs(right.force).max() > 0.1)

    def goal_errors(self, world: World) -> tuple[float, float]:
        """Return the distance to the goal [m] and the yaw error [rad] of the rod as it lies."""
        T = world.object_pose()
        x, y, yaw = self.trial.goal
        axis = T[:3, 1]
        return (
            float(np.hypot(T[0, 3] - x, T[1, 3] - y)),
            abs(math.remainder(float(np.arctan2(-axis[0], axis[1])) - yaw, math.tau)),
        )

    @property
    def finished(self) -> bool:
        """Return whether the rod lies released and at rest at its goal."""
        return self._done_at is not None

    def _fault(self, name: str, at_s: float, detail: str) -> None:
        self._faults.setdefault(name, Fault(name, at_s, detail))

    def outcome(self, world: World) -> Outcome:
        """Judge the trial as it stands now."""
        task = self.scene.task
        position_error, yaw_error = self.goal_errors(world)
        now = world.time
        faults = dict(self._faults)

        def demand(name: str, holds: bool, detail: str) -> None:
            if not holds:
                faults.setdefault(name, Fault(name, now, detail))

        demand(
            "rose",
            self._rise > task.clear_height_m,
            f"rose {1e3 * max(self._rise, 0.0):.0f} mm, needs > {1e3 * task.clear_height_m:.0f}",
        )
        demand(
            "arrived",
            position_error < task.goal_tolerance_m,
            f"{1e3 * position_error:.1f} mm from the goal, limit {1e3 * task.goal_tolerance_m:.0f}",
        )
        if task.yaw_tolerance_rad is not None:
            demand(
                "turned",
                yaw_error < task.yaw_tolerance_rad,
                f"{np.degrees(yaw_error):.1f} deg off its direction, limit {np.degrees(task.yaw_tolerance_rad):.0f}",
            )
        demand("released", not self._touched(world), "a hand still touches the rod")
        speed = float(np.linalg.norm(world.object_twist()[:3]))
        demand(
            "at_rest",
            speed < task.rest_speed_m_per_s and world.on_table(),
            f"speed {speed:.3f} m/s, on the table: {world.on_table()}",
        )
        duration = now if self._done_at is None else self._done_at
        demand("on_time", duration <= task.time_limit_s, f"{duration:.1f} s, limit {task.time_limit_s:.0f}")
        lifted = self._was_airborne
        return Outcome(
            success=not faults and self._done_at is not None,
            faults=tuple(faults.values()),
            duration_s=duration,
            goal_error_m=position_error,
            yaw_error_rad=yaw_error,
            tilt_max_rad=self._tilt,
            rise_m=max(float(self._rise), 0.0),
            pinch_min_n=self._pinch if lifted else 0.0,
            internal_force_min_n=self._squeeze if lifted else 0.0,
        )
