"""What a tick of the supervisor costs, beside bare physics in the same run; `pytest -s` prints the numbers."""

from __future__ import annotations

import time

import mujoco
import numpy as np

from minidual.control.joint_control import ComputedTorque
from minidual.control.supervisor import Supervisor
from minidual.robot.arms import DUAL_PANDA
from minidual.skills.supervised import arm_distance
from minidual.stages.env_check.tracking import sine_reference

STEPS, BLOCK = 4000, 50
FINGERS = np.full(2, 0.04)


def tick_cost(world, kinematics, self_distance) -> tuple[float, float, float]:
    """Return (median of a tick, mean over blocks at their fastest tenth, median of mj_step) [us], timed in turns."""
    supervisor = Supervisor(self_distance=self_distance)
    controller, bare = ComputedTorque(kinematics), mujoco.MjData(world.model)
    world.reset(sine_reference(DUAL_PANDA, 0.3, 0.5, 0.0)[0])
    guard_us, step_us = np.empty(STEPS), np.empty(STEPS)
    for start in range(0, STEPS, BLOCK):
        for k in range(start, start + BLOCK):
            q, v = world.q, world.v
            tau = controller.torque(q, v, *sine_reference(DUAL_PANDA, 0.3, 0.5, world.time))
            began = time.perf_counter_ns()
            tau = supervisor.guard(world.time, q, v, tau)
            guard_us[k] = (time.perf_counter_ns() - began) / 1e3
            world.command(tau, FINGERS)
            world.step()
        mujoco.mj_copyData(bare, world.model, world.data)
        for k in range(start, start + BLOCK):
            began = time.perf_counter_ns()
            mujoco.mj_step(world.model, bare)
            step_us[k] = (time.perf_counter_ns() - began) / 1e3
    blocks = np.sort(guard_us.reshape(-1, BLOCK).mean(axis=1))
    return float(np.median(guard_us)), float(blocks[: len(blocks) // 10].mean()), float(np.median(step_us))


def test_a_tick_costs_a_fraction_of_physics(world, kinematics) -> None:
    plain = tick_cost(world, kinematics, None)
    watched = tick_cost(world, kinematics, arm_distance(DUAL_PANDA))
    for name, (median, mean, bare) in (("joints and hands", plain), ("with self-collision", watched)):
        print(f"{name}: median {median:.1f} us, mean with the slow looks {mean:.1f} us, mj_step {bare:.1f} us")
    assert plain[0] < 0.5 * plain[2]
    assert plain[1] < 0.75 * plain[2]
    assert watched[1] < 1.0 * watched[2]
