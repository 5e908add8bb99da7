"""Wall time of one step of control and physics, beside physics alone.

Both are timed in turns, in blocks, in one process: absolute times say as much about the machine and
its other work as about the code, their ratio does not. Bare physics runs on a copy of the same state
under the same commands, so that it has the same contacts to solve.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from minidual.plant.world import World
from minidual.robot.pair import Array

Step = Callable[[], object]
"""One whole step, or one part of it, ready to be called."""


def _nothing() -> None:
    pass


@dataclass(frozen=True)
class StepCost:
    """Wall time of one step [us], the bare physics of the same model in the same run beside it.

    Attributes:
        median_us: Control and physics.
        p99_us: Of the same.
        bare_median_us: `mj_step` alone.
        dt_s: What one step simulates.
        parts_us: Median of each part of the step that was timed by itself.
        turn_ratios: Whole over bare of each turn: its two halves shared the machine's other work.
    """

    median_us: float
    p99_us: float
    bare_median_us: float
    dt_s: float = 0.001
    parts_us: Mapping[str, float] = field(default_factory=dict[str, float])
    turn_ratios: tuple[float, ...] = ()

    @property
    def ratio(self) -> float:
        """Whole step over bare physics: the median of the turns, so that other work cancels."""
        if self.turn_ratios:
            return float(np.median(self.turn_ratios))
        return self.median_us / self.bare_median_us

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time."""
        return self.dt_s / (1e-6 * self.median_us)


def step_cost(
    world: World,
    step: Step,
    steps_n: int,
    *,
    parts: Mapping[str, Step] | None = None,
    before: Step = _nothing,
    block: int = 50,
) -> StepCost:
    """Time `step` in blocks, in turns with bare `mj_step` on a copy of the state the block began with.

    Args:
        world: What `step` drives.
        step: One whole step of control and physics; must call `world.step`.
        steps_n: How many are timed.
        parts: Parts of the step that leave the world as it is. Each is timed right after a bare
            `mj_step`, as the controller finds the processor's caches: in a loop of its own it would
            look faster than it is.
        before: Called before each step and not timed.
        block: Steps in one turn.
    """
    parts = {} if parts is None else parts
    bare_data = mujoco.MjData(world.model)
    whole_ns: Array = np.empty(steps_n)
    bare_ns: Array = np.empty(steps_n)
    parts_ns: dict[str, Array] = {name: np.empty(steps_n) for name in parts}
    turn_ratios: list[float] = []
    for start in range(0, steps_n, block):
        end = min(start + block, steps_n)
        mujoco.mj_copyData(bare_data, world.model, world.data)
        for k in range(start, end):
            before()
            whole_ns[k] = _time_ns(step)
        for k in range(start, end):
            began = time.perf_counter_ns()
            mujoco.mj_step(world.model, bare_data)
            bare_ns[k] = time.perf_counter_ns() - began
            for name, part in parts.items():
                parts_ns[name][k] = _time_ns(part)
        ratio = np.median(whole_ns[start:end]) / np.median(bare_ns[start:end])
        turn_ratios.append(float(ratio))
    return StepCost(
        _median_us(whole_ns),
        float(np.percentile(whole_ns, 99)) / 1e3,
        _median_us(bare_ns),
        world.dt,
        {name: _median_us(times_ns) for name, times_ns in parts_ns.items()},
        tuple(turn_ratios),
    )


def _time_ns(step: Step) -> int:
    began = time.perf_counter_ns()
    step()
    return time.perf_counter_ns() - began


def _median_us(times_ns: Array) -> float:
    return float(np.median(times_ns)) / 1e3
