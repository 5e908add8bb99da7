"""The joint target that the arbiter sends, and how it moves."""

from collections.abc import Mapping

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.control.braking import rest_posture
from minidual.control.commands import JointCommand
from minidual.robot.pair import SIDES, Array, Robot

ARMS = frozenset(range(len(SIDES)))
_STOP_SHARE = 0.5
"""Share of the joints' acceleration limits for stopping at a switch."""


class JointTarget:
    """A joint target (n,) [rad] that moves in bounded steps.

    Attributes:
        q: The target; replaced, never changed in place.
        aligning: Whether the last approach was slowed down because its goal was far away.
    """

    def __init__(self, robot: Robot, config: ArbiterConfig) -> None:
        self._robot = robot
        self._step_max_rad = config.switch_step_max_rad
        self._align_rad_per_s = config.align_speed_rad_s
        self.q = robot.home
        self.aligning = False
        self._stopping = set[int]()
        """Arms whose source has gone silent, on the way to where they can stop."""

    @property
    def stopping(self) -> bool:
        """Whether an arm is on its way to where it can stop."""
        return bool(self._stopping)

    def hold(self, q: Array) -> None:
        """Hold a posture (n,), within the joint limits."""
        self.q = np.clip(q, self._robot.q_lower, self._robot.q_upper)
        self._stopping = set()

    def stand(self, q: Array, v: Array) -> None:
        """Hold the posture (n,) in which arms at q, v can stop."""
        self.hold(self._rest(q, v))

    def stop(self, q: Array, v: Array) -> None:
        """Hold where arms at q, v can stop, but not beyond the target that they were on the way to."""
        self.hold(self.stopped(q, v))

    def stopped(self, q: Array, v: Array) -> Array:
        """Return the posture (n,) of `stop`."""
        rest = np.clip(self._rest(q, v), self._robot.q_lower, self._robot.q_upper)
        way = self.q - q
        ahead = (way * v >= 0.0) | (np.abs(way) < self._step_max_rad)
        overshoots = ahead & ((rest - self.q) * v > 0.0)
        return np.where(overshoots, self.q, rest)

    def _rest(self, q: Array, v: Array) -> Array:
        robot = self._robot
        return rest_posture(q, np.clip(v, -robot.v_max, robot.v_max), _STOP_SHARE * robot.a_max)

    def approach(self, commands: Mapping[int, JointCommand], dt: float, speed: float) -> bool:
        """Move towards streamed commands by arm; return whether the target follows them, or still aligns.

        A step over `switch_step_max_rad` starts an alignment at `align_speed_rad_s` times `speed`. It ends once
        one tick at that speed reaches the goal.
        """
        robot = self._robot
        goal = self.q.copy()
        for arm, command in commands.items():
            joints = robot.joints_of(arm)
            q = command.q[joints] if len(command.arms) > 1 else command.q
            goal[joints] = np.clip(q, robot.q_lower[joints], robot.q_upper[joints])
        step = goal - self.q
        largest = float(np.max(np.abs(step)))
        align_step = speed * self._align_rad_per_s * dt
        far = largest > self._step_max_rad
        self.aligning = far or (self.aligning and largest > align_step)
        if self.aligning:
            share = min(align_step, self._step_max_rad) / largest
            goal = self.q + step * min(1.0, share)
        self.q = goal
        return not self.aligning

    def stop_arms(self, idle: set[int], silent: set[int], rest: Array) -> list[int]:
        """Move idle arms that have gone silent towards `rest` (n,) in bounded steps; return those that begin.

        An arm near its rest stays at its target, since a loaded arm would sag.
        """
        arms = idle & (self._stopping | silent)
        far = {arm for arm in arms if self._distance(arm, rest) > self._step_max_rad}
        moving = far | (arms & self._stopping)
        self.q = self.q.copy()
        for arm in moving:
            joints = self._robot.joints_of(arm)
            step = rest[joints] - self.q[joints]
            self.q[joints] += np.clip(step, -self._step_max_rad, self._step_max_rad)
        self._stopping = far
        return sorted(moving & silent)

    def stop_all(self, idle: set[int], silent: set[int], rest: Array) -> None:
        """Hold idle arms at `rest` (n,) at once, because nobody drives; only if one of them is far from it."""
        self._stopping = set()
        far = {arm for arm in idle if self._distance(arm, rest) > self._step_max_rad}
        if not far:
            return
        self.q = self.q.copy()
        for arm in idle & (silent | far):
            joints = self._robot.joints_of(arm)
            self.q[joints] = rest[joints]

    def _distance(self, arm: int, rest: Array) -> float:
        joints = self._robot.joints_of(arm)
        return float(np.abs(rest[joints] - self.q[joints]).max())
