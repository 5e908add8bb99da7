"""Wall time of one step of control and physics, beside physics alone."""

from __future__ import annotations

import time
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.control.loop import JointLoop
from minidual.evaluation.joint_tracking import sine_reference

_OPEN = np.ones(2)


@dataclass(frozen=True)
class StepCost:
    """Wall time of one step [us], the bare physics of the same model in the same run beside it."""

    median_us: float
    p99_us: float
    bare_median_us: float

    @property
    def ratio(self) -> float:
        """Whole step over bare physics."""
        return self.median_us / self.bare_median_us


def control_step_cost(loop: JointLoop, steps_n: int, *, block: int = 50) -> StepCost:
    """Time control and physics of single steps while the arms swing, in turns with bare `mj_step`."""
    world = loop.world
    world.reset()
    loop.reset()
    bare_data = mujoco.MjData(world.model)
    reference = [sine_reference(0.1, 0.5, k * world.dt) for k in range(steps_n)]
    whole, bare = np.empty(steps_n), np.empty(steps_n)
    for start in range(0, steps_n, block):
        stop = min(start + block, steps_n)
        for k in range(start, stop):
            began = time.perf_counter_ns()
            loop.follow(*reference[k], _OPEN)
            whole[k] = time.perf_counter_ns() - began
        mujoco.mj_copyData(bare_data, world.model, world.data)
        for k in range(start, stop):
            began = time.perf_counter_ns()
            mujoco.mj_step(world.model, bare_data)
            bare[k] = time.perf_counter_ns() - began
    world.reset()
    return StepCost(
        float(np.median(whole)) / 1e3, float(np.percentile(whole, 99)) / 1e3, float(np.median(bare)) / 1e3
    )
