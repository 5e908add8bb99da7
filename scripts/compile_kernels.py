"""Compile the numeric kernels into numba's cache, so that no first command waits half a minute for it."""

from __future__ import annotations

import time

import numpy as np

from minidual.config.root import Config
from minidual.control import kernels
from minidual.environments.batched import BatchedEnv
from minidual.motion.held.planner import HeldPlanner


def main() -> None:
    """Load every module with kernels, plan once, and step a batched environment once."""
    planner = HeldPlanner().planner
    goal = planner.robot.home.copy()
    goal[0] += 0.4
    planner.plan_to_joints("both_arms", planner.robot.home, goal, seed=1)
    _step_environment()
    cpu_s = time.process_time()
    print(
        f"kernels of {kernels.__name__}, proof, motion and environments: ready,"
        f" {cpu_s:.0f} s of processor time",
    )


def _step_environment() -> None:
    """Compile the kernels of batched worlds, which have no signatures."""
    env = BatchedEnv(1, Config(task="pot_lift"), fast=True)
    env.reset()
    env.step(np.zeros((1, len(env.actions.names))))


if __name__ == "__main__":
    main()
