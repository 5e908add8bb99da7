"""What other planners get and give, the same for all of them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from minidual.collision.scene import PlanningScene
from minidual.motion.timing import DT_S
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory

_SHARE_S = 0.2
"""Processor time over which the share of a core is measured."""


@dataclass(frozen=True, eq=False)
class PeerQuery:
    """A motion from posture to posture.

    Attributes:
        group: Joints that move; the others stay at `q_start`.
        index: In its set.
        seed: Of the planner.
        scene: What stands around.
        q_start: Free posture (n,) [rad].
        q_goal: Free posture (n,) [rad].
        T_left_right: Pose (4, 4) of the right tcp in the left one, which the motion keeps; None if
            the hands are free.
    """

    group: str
    index: int
    seed: int
    scene: PlanningScene
    q_start: Array
    q_goal: Array
    T_left_right: Array | None = None


@dataclass(frozen=True, eq=False)
class Run:
    """What a planner gives for a query.

    Attributes:
        trajectory: Timed path; None if there is none.
        cpu_s: Processor time from the postures to the timed path.
        reason: Why there is no path.
    """

    trajectory: Trajectory | None
    cpu_s: float
    reason: str = ""


def core_share() -> float:
    """Return the share of a core that this process gets at the moment."""
    wall_began = time.perf_counter()
    cpu_began = time.process_time()
    while time.process_time() < cpu_began + _SHARE_S:
        pass
    wall_s = time.perf_counter() - wall_began
    cpu_s = time.process_time() - cpu_began
    return min(1.0, cpu_s / wall_s)


def evenly(times: Array, q: Array, v: Array, a: Array, group: str) -> Trajectory:
    """Return a trajectory of about 1 kHz.

    Args:
        times: (T,) [s]; the last sample may come early.
        q: (T, n) [rad].
        v: (T, n) [rad/s].
        a: (T, n) [rad/s^2].
        group: Joints that move.
    """
    even_n = max(2, round(times[-1] / DT_S) + 1)
    even_times = np.linspace(0.0, times[-1], even_n)
    spline = CubicHermiteSpline(times, q, v)
    even_a = np.stack([np.interp(even_times, times, column) for column in a.T], axis=1)
    return Trajectory(even_times, spline(even_times), spline(even_times, 1), even_a, group)
