"""Follow poses of the hands with the arms: smooth, within speed limits, by inverse kinematics."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from minidual.config.leading import MirrorConfig
from minidual.motion.ik import solvers
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, pose

_JOINT_SPEED_SHARE = 0.7
"""Of the joints' speed limits. Near a singularity the hands slow down to keep it."""
_STOP_S = 0.35
"""Height over the least one that a hand has left for each m/s downwards.

Lower or faster, a stop would end in the table, and the supervisor would stop the arms.
"""
_LANDING_M_S = 0.03
"""Downward speed that a hand may have at any height."""


def _copies(Ts: Sequence[Array]) -> list[Array]:
    return [np.array(T, dtype=float) for T in Ts]


class Spring:
    """A critically damped spring.

    Args:
        lag_s: By which it lags a steady motion.
        period_s: Of a step; a shorter lag is as long as it.
        ramp_s: Time in which it reaches its largest rate at the soonest; 0: at once.
    """

    def __init__(self, lag_s: float, period_s: float, ramp_s: float = 0.0) -> None:
        self._lag_s = max(lag_s, period_s)
        self._period_s = period_s
        self._ramp_s = ramp_s

    def step(self, away: Array, rate: Array, rate_max: float) -> tuple[Array, Array]:
        """Return how far away (k,) it is from its goal after a period, and its rate.

        Far away, it pulls as if the goal were where the largest rate lets it be, or nearer: where it
        can still brake.
        """
        distance = float(np.linalg.norm(away))
        reach = self._rate_towards(distance, rate_max) * self._lag_s
        pulled = away if distance <= reach else away * (reach / distance)
        beyond = away - pulled
        stiffness = 2.0 / self._lag_s
        decay = np.exp(-stiffness * self._period_s)
        drift = (rate + stiffness * pulled) * self._period_s
        rate_next = (rate - stiffness * drift) * decay
        change = rate_next - rate
        share = self._allowed_share(float(np.linalg.norm(change)), rate_max)
        if share < 1.0:
            rate_eased = rate + share * change
            return away + 0.5 * (rate + rate_eased) * self._period_s, rate_eased
        return beyond + (pulled + drift) * decay, rate_next

    def _rate_towards(self, distance: float, rate_max: float) -> float:
        """Return the largest rate from which it comes to rest within a distance."""
        if self._ramp_s == 0.0:
            return rate_max
        return min(rate_max, float(np.sqrt(distance * rate_max / self._ramp_s)))

    def _allowed_share(self, change: float, rate_max: float) -> float:
        """Return the share of a period's change of rate that the ramp allows."""
        if self._ramp_s == 0.0:
            return 1.0
        change_max = rate_max * self._period_s / self._ramp_s
        return 1.0 if change <= change_max else change_max / change


class HandTracker:
    """Moves both hands towards goals, and gives the joints.

    Each hand is a critically damped spring of bounded speed on the way to its goal. A goal below the
    table is raised to it, and on the way down a hand slows so that it can stop over the table. A
    hand whose goal is out of reach slides along what it can reach.

    Args:
        robot: The arms.
        config: Speeds, filter and least height.
        period_s: Between two calls of `follow`.

    Attributes:
        q: Joints (n,) [rad].
        blocked: Hands, 0 left and 1 right, that cannot go where they should.
    """

    def __init__(self, robot: Robot, config: MirrorConfig, period_s: float) -> None:
        self._robot = robot
        self._config = config
        self._period_s = period_s
        self._kinematics = Kinematics(robot)
        self._step_max_rad = _JOINT_SPEED_SHARE * robot.v_max * period_s
        self._mobility = np.ones(robot.dof)
        self.begin(robot.home)

    def begin(self, q: Array) -> None:
        """Start at rest at joints (n,) [rad]; goals are those of the hands themselves."""
        self.q = np.array(q, dtype=float)
        self.blocked: tuple[int, ...] = ()
        self._Ts = _copies(self._kinematics.tcp_poses(self.q))
        self._velocity_m_s = np.zeros((2, 3))
        self._turn_rad_s = np.zeros((2, 3))

    @property
    def Ts_world_tcp(self) -> list[Array]:
        """Poses (4, 4) of left and right hand."""
        return _copies(self._Ts)

    def joints_at(self, Ts_world_tcp: Sequence[Array]) -> Array | None:
        """Return the joints (n,) [rad] at poses (4, 4) that are nearest to `q`; None out of reach."""
        q = self.q.copy()
        for ik, T in zip(solvers(self._robot).values(), Ts_world_tcp, strict=True):
            near = self.q[ik.joints]
            solution = ik.resting(T, near, near, self._mobility[ik.joints])
            if not solution.reached:
                return None
            q[ik.joints] = solution.q
        return q

    def follow(self, Ts_goal: Sequence[Array]) -> Array:
        """Return the joints (n,) [rad] one period further towards poses (4, 4)."""
        blocked: list[int] = []
        for arm, T_goal in enumerate(Ts_goal):
            is_free = self._follow_hand(arm, self.above_table(T_goal))
            if not is_free:
                blocked.append(arm)
        self.blocked = tuple(blocked)
        return self.q.copy()

    @property
    def hint(self) -> str:
        """Which hand is out of reach, or ""."""
        return ", ".join(f"{self._robot.sides[arm]} hand: out of reach" for arm in self.blocked)

    def above_table(self, T_goal: Array) -> Array:
        """Return a pose (4, 4) raised to the least height."""
        T = np.array(T_goal, dtype=float)
        T[2, 3] = max(T[2, 3], self._config.hand_height_min_m)
        return T

    def _follow_hand(self, arm: int, T_goal: Array) -> bool:
        """Move one hand; return whether it can go where its spring takes it."""
        T_from = self._Ts[arm]
        T_next = self._pulled(arm, T_goal)
        turned = pose(T_next[:3, :3], T_from[:3, 3])
        moved = pose(T_from[:3, :3], T_next[:3, 3])
        for T in (T_next, moved, turned):
            if self._reach(arm, T):
                return T is T_next
        self._rest(arm)
        return False

    def _rest(self, arm: int) -> None:
        self._velocity_m_s[arm] = 0.0
        self._turn_rad_s[arm] = 0.0

    def _reach(self, arm: int, T: Array) -> bool:
        """Go to a pose, or as far as the joints' speeds allow; return whether it can be reached."""
        side = self._robot.sides[arm]
        ik = solvers(self._robot)[side]
        near = self.q[ik.joints]
        solution = ik.resting(T, near, self._robot.home[ik.joints], self._mobility[ik.joints])
        if not solution.reached:
            return False
        step = solution.q - near
        share = min(1.0, float(np.min(self._step_max_rad[ik.joints] / np.maximum(abs(step), 1e-9))))
        self.q[ik.joints] = near + share * step
        if share < 1.0:
            self._velocity_m_s[arm] *= share
            self._turn_rad_s[arm] *= share
        self._Ts[arm] = ik.tcp_pose(self.q[ik.joints])
        return True

    def _pulled(self, arm: int, T_goal: Array) -> Array:
        """Return a hand's pose after one period of its spring."""
        T = self._Ts[arm]
        config = self._config
        spring = Spring(config.hand_lag_s, self._period_s, config.hand_ramp_s)
        xyz_goal = T_goal[:3, 3].copy()
        xyz_goal[2] = max(xyz_goal[2], self._lowest_m(T[2, 3]))
        away_m, self._velocity_m_s[arm] = spring.step(
            T[:3, 3] - xyz_goal,
            self._velocity_m_s[arm],
            config.hand_speed_max_m_s,
        )
        turn = Rotation.from_matrix(T[:3, :3] @ T_goal[:3, :3].T).as_rotvec()
        away_rad, self._turn_rad_s[arm] = spring.step(
            turn,
            self._turn_rad_s[arm],
            config.hand_turn_max_rad_s,
        )
        R_next = Rotation.from_rotvec(away_rad).as_matrix() @ T_goal[:3, :3]
        return pose(R_next, xyz_goal + away_m)

    def _lowest_m(self, height_m: float) -> float:
        """Return the lowest goal that lets a hand at a height stop over the table."""
        room_m = height_m - self._config.hand_height_min_m
        speed_max_m_s = max(room_m / _STOP_S, _LANDING_M_S)
        lag_s = max(self._config.hand_lag_s, self._period_s)
        return height_m - speed_max_m_s * lag_s
