"""Compile the numeric kernels into numba's cache, so that no first command waits half a minute for it."""

from __future__ import annotations

import time

from minidual.control import kernels
from minidual.motion.held.planner import HeldPlanner


def main() -> None:
    """Load every module with kernels and plan once."""
    planner = HeldPlanner().planner
    goal = planner.robot.home.copy()
    goal[0] += 0.4
    planner.plan_to_joints("both_arms", planner.robot.home, goal, seed=1)
    cpu_s = time.process_time()
    print(
        f"kernels of {kernels.__name__}, proof and motion: ready, {cpu_s:.0f} s of processor time",
    )


if __name__ == "__main__":
    main()
