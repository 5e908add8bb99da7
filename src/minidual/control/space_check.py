"""Guard, every 10 ms: hands and distances, now and where a stop would end."""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from minidual.config.control import SupervisorConfig
from minidual.control.bounds import Reach, TickBounds
from minidual.control.braking import rest_posture
from minidual.control.kernels import hand_look
from minidual.control.measurement import Measurement
from minidual.control.soft_stop import SupervisedStop
from minidual.control.tick_check import Violation, beyond
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import SIDES, Array

Distance = Callable[[Array], tuple[str, float]]
"""Maps q (n,) [rad] to the nearest collidable pair ("a with b") and its distance [m]."""


class Clearance(Protocol):
    """Distances between all that may collide."""

    def __call__(self, q: Array) -> tuple[str, float, float]:
        """Return the pair nearest to its bound at q (n,), its distance and bound [m]."""
        ...

    def hold(self, arm: int | None, T_tcp_shape: Array | None = None) -> None:
        """Attach the object's shape to a hand at a pose (4, 4), besides what the other holds; None empties both."""
        ...

    def lower(self) -> None:
        """Let fingers and what they hold reach the table, where it is put down, until the next `hold`."""
        ...


class SpaceCheck:
    """Checks that need kinematics; `update` in each tick decides which are due."""

    # Parts that the supervisor shares with its other checks.
    def __init__(
        self,
        config: SupervisorConfig,
        kinematics: Kinematics,
        bounds: TickBounds,
        stop: SupervisedStop,
        dt_s: float,
        self_distance: Distance | None,
        clearance: Clearance | None,
    ) -> None:
        self._config = config
        self._robot = kinematics.robot
        self._bounds = bounds
        self._stop = stop
        self._dt = dt_s
        self._self_distance = self_distance
        self.clearance = clearance
        self._reach = Reach(kinematics)
        self._hands = Hands(kinematics)
        self._looks = np.zeros((len(SIDES), 5))
        self._every = max(1, round(config.slow_period_s / dt_s))
        self.reset()

    def reset(self) -> None:
        """Check everything in the next tick."""
        self._tick = 0
        self._next_hands = 1
        self._next_stop = 1
        self._next_near: float = math.inf if self._self_distance is None else 1

    def update(
        self,
        measurement: Measurement,
        a_ref: Array,
        external: Array,
        force_max_n: float,
    ) -> Violation | None:
        """Run the checks that are due.

        Args:
            a_ref: Commanded reference acceleration (n,).
            external: External torques (n,) [Nm] that nothing explains.
            force_max_n: Bound of the force of a hand.

        Raises:
            Exception: What a distance function raises.
        """
        self._tick += 1
        if self._tick < min(self._next_hands, self._next_near):
            return None
        q = measurement.q
        v = measurement.v
        violation: Violation | None = None
        if self._tick >= self._next_hands:
            self._next_hands = self._tick + self._every
            violation = self._limits_ahead(q, v) or self._of_hands(q, v, external, force_max_n)
        if violation is None and self.clearance is not None and self._tick >= self._next_stop:
            self._next_stop = self._tick + self._every
            violation = self._of_a_stop(q, v, a_ref)
        if violation is None and self._self_distance is not None and self._tick >= self._next_near:
            violation = self._between_arms(q, v)
        return violation

    @property
    def _ahead_s(self) -> float:
        """Two periods: one until the next check, one for the speed gained meanwhile."""
        return 2.0 * self._every * self._dt

    def _limits_ahead(self, q: Array, v: Array) -> Violation | None:
        bounds = self._bounds
        rest = rest_posture(q, v, self._robot.a_max)
        if np.abs((rest - bounds.centre[0]) * bounds.scale[0]).max() <= 1.0:
            return None
        names = self._robot.joint_names
        return beyond("joint_position", "", names, rest, bounds.q_lower, bounds.q_upper)

    def _of_hands(
        self,
        q: Array,
        v: Array,
        external: Array,
        force_max_n: float,
    ) -> Violation | None:
        self._hands.update(q)
        hand_look(self._hands.views, v, external, self._ahead_s, self._looks)
        speed_max = self._config.tcp_speed_max_m_per_s
        ranges_m = self._config.workspace_m
        for arm, (force_n, speed, *place_m) in enumerate(self._looks.tolist()):
            side = SIDES[arm]
            if not force_n <= force_max_n:
                return Violation("contact", "hand", f"the {side} hand", force_n, force_max_n)
            if not speed <= speed_max:
                return Violation("speed", "hand", self._robot.tcp_names[arm], speed, speed_max)
            inside = [low <= x <= high for x, (low, high) in zip(place_m, ranges_m, strict=True)]
            if not all(inside):
                axes = tuple(f"{axis} of the {side} hand" for axis in "xyz")
                lower, upper = np.transpose(ranges_m)
                return beyond("clearance", "workspace", axes, np.array(place_m), lower, upper)
        return None

    def _of_a_stop(self, q: Array, v: Array, a_ref: Array) -> Violation | None:
        """Check where a stop that began two periods ahead would end."""
        assert self.clearance is not None
        ahead_s = self._ahead_s
        later = q + ahead_s * (v + 0.5 * ahead_s * a_ref)
        rest = self._stop.rest(later, v + ahead_s * a_ref)
        pair, distance_m, bound_m = self.clearance(rest)
        if distance_m >= bound_m:
            return None
        return Violation("clearance", "stop", pair, distance_m, bound_m)

    def _between_arms(self, q: Array, v: Array) -> Violation | None:
        assert self._self_distance is not None
        bound_m = self._config.self_collision_min_m
        pair, distance_m = self._self_distance(q)
        if not distance_m >= bound_m:
            return Violation("clearance", "arms", pair, distance_m, bound_m)
        # The next check comes before the gap can close to the bound at full acceleration.
        safe_s = min(self._reach.safe_time_s(v, distance_m - bound_m), 1.0)
        self._next_near = self._tick + min(3 * self._every, max(1, int(safe_s / self._dt)))
        return None
