"""Processor time of one step of control and physics, beside physics alone.

Both are timed in turns, in blocks, in one process: absolute times say as much about the machine as
about the code, their ratio says less. Bare physics runs on a copy of the same state under the same
commands, so that it has the same contacts to solve. Every step counts, the rare expensive ones too;
only other programs' shares of the processor are left out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple, Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from minidual.plant.world import World
from minidual.robot.pair import Array

Step = Callable[[], object]
"""One whole step, or one part of it, ready to be called."""
COLUMNS = (
    "mean_us",
    "median_us",
    "p99_us",
    "bare_us",
    "mean_ratio",
    "median_ratio",
    "p99_ratio",
)
NOTES = (
    "processor time of all steps; bare_us: mean of bare mj_step",
    "ratio: over the same statistic of bare mj_step, timed the same way in the same run",
)


def _nothing() -> None:
    pass


class Spread(NamedTuple):
    """Processor time of all steps of a kind [us]."""

    mean_us: float
    median_us: float
    p99_us: float

    @classmethod
    def of(cls, times_ns: ArrayLike) -> Self:
        """Return the statistics of times [ns], none left out."""
        times_us = np.asarray(times_ns, dtype=float) / 1e3
        return cls(
            float(times_us.mean()),
            float(np.median(times_us)),
            float(np.percentile(times_us, 99)),
        )


@dataclass(frozen=True)
class StepCost:
    """Processor time of steps, the bare physics of the same model in the same run beside it.

    Attributes:
        whole: Control and physics.
        bare: `mj_step` alone.
        dt_s: What one step simulates.
        parts_us: Mean of each part of the step that was timed by itself.
    """

    whole: Spread
    bare: Spread
    dt_s: float = 0.001
    parts_us: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def real_time_factor(self) -> float:
        """Simulated time over processor time, by the mean."""
        return self.dt_s / (1e-6 * self.whole.mean_us)

    def numbers(self) -> dict[str, float]:
        """Return the numbers of `COLUMNS`."""
        return {
            **self.whole._asdict(),
            "bare_us": self.bare.mean_us,
            "mean_ratio": self.whole.mean_us / self.bare.mean_us,
            "median_ratio": self.whole.median_us / self.bare.median_us,
            "p99_ratio": self.whole.p99_us / self.bare.p99_us,
        }


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
    for start in range(0, steps_n, block):
        end = min(start + block, steps_n)
        mujoco.mj_copyData(bare_data, world.model, world.data)
        for k in range(start, end):
            before()
            whole_ns[k] = _time_ns(step)
        for k in range(start, end):
            bare_ns[k] = bare_step_ns(world.model, bare_data)
            for name, part in parts.items():
                parts_ns[name][k] = _time_ns(part)
    return StepCost(
        Spread.of(whole_ns),
        Spread.of(bare_ns),
        world.dt,
        {name: Spread.of(times_ns).mean_us for name, times_ns in parts_ns.items()},
    )


def bare_step_ns(model: mujoco.MjModel, data: mujoco.MjData) -> int:
    """Take one step of physics alone; return its processor time [ns]."""
    began_ns = time.process_time_ns()
    mujoco.mj_step(model, data)
    return elapsed_ns(began_ns)


def _time_ns(step: Step) -> int:
    began_ns = time.process_time_ns()
    step()
    return elapsed_ns(began_ns)


def elapsed_ns(began_ns: int) -> int:
    """Return the processor time since then [ns], without that of looking at the clock.

    A look takes some 0.5 us, 3 % of bare physics: left in, it would flatter every ratio.
    """
    ended_ns = time.process_time_ns()
    return ended_ns - began_ns - _look_ns()


@cache
def _look_ns() -> int:
    looks_ns = [time.process_time_ns() for _ in range(2001)]
    return int(np.median(np.diff(looks_ns)))
