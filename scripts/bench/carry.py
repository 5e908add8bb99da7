"""What surrounds the law: a tick of the supervisor alone, and a whole step of a trial of each task."""

from __future__ import annotations

import itertools
import time

import mujoco
import numpy as np
from numpy.typing import NDArray

from minidual.config.root import changed
from minidual.control.joint_control import ComputedTorque
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.supervised import trial_supervisor
from minidual.stages.env_check.tracking import sine_reference
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench
from scripts.bench.tables import BenchInputs, BenchRow, BenchTable

BLOCK = 50
STEP_RATIO_MAX = 3.0
"""A whole step of a trial over bare physics."""
TICK_RATIO_MAX = 0.5
MEAN_RATIO_MAX = 0.75
WATCHED_RATIO_MAX = 1.0
"""A tick of the supervisor over bare physics: its median, its mean with the slow looks, and with all distances."""
_FINGERS_M = np.full(2, 0.04)


def measure(inputs: BenchInputs) -> BenchTable:
    """Time ticks of the supervisor, and all steps of one trial of each task."""
    rows: list[BenchRow] = []
    world = World(inputs.config.scene)
    watched = trial_supervisor(inputs.config.supervisor, world.dt, world.robot)
    for name, supervisor, limits in (
        (
            "supervisor: joints and hands",
            Supervisor(),
            {"ratio": TICK_RATIO_MAX, "mean_ratio": MEAN_RATIO_MAX},
        ),
        ("supervisor: and stopping distances", watched, {"mean_ratio": WATCHED_RATIO_MAX}),
    ):
        rows.append(tick(name, world, supervisor, limits, inputs.repeats_n))
        inputs.advance(name)
    rows += trials(inputs)
    return BenchTable(
        f"The supervisor's tick and a trial's whole step beside bare mj_step, in turns of {BLOCK}",
        ("median_us", "mean_us", "bare_us", "ratio", "mean_ratio", "tenth_ratio"),
        tuple(rows),
        (
            "A whole step: sensing, estimate, monitors, arbiter, supervisor, law, physics, judge, log. mean: fastest tenth.",
            "tenth_ratio: of tenth percentiles, which other work on the machine disturbs least.",
        ),
    )


def tick(
    name: str,
    world: World,
    supervisor: Supervisor,
    limits: dict[str, float],
    steps_n: int,
) -> BenchRow:
    """Time `guard` on arms that swing."""
    controller = ComputedTorque(Kinematics(world.robot))
    bare = _Bare(world)
    world.reset(sine_reference(world.robot, 0.3, 0.5, 0.0)[0])
    guard_ns = []
    bare_ns = []
    for k in range(steps_n):
        q = world.q
        v = world.v
        tau = controller.torque(q, v, *sine_reference(world.robot, 0.3, 0.5, world.time))
        began = time.perf_counter_ns()
        tau = supervisor.guard(world.time, q, v, tau)
        guard_ns.append(time.perf_counter_ns() - began)
        world.command(tau, _FINGERS_M)
        world.step()
        if k % BLOCK == BLOCK - 1:
            bare_ns += bare.block()
    return _row(name, guard_ns, bare_ns, limits)


def trials(inputs: BenchInputs) -> list[BenchRow]:
    """Time all steps of one trial of each task by each method that plans or senses, and those with the object held."""
    rows = []
    for task, method in itertools.product(TASKS, ("impedance", "moveit")):
        bench = Bench(
            method,
            MethodInputs(make_task(changed(inputs.config, {"task": task})).config, inputs.seed),
        )
        whole, physics, carried, text = _steps(bench, inputs.seed)
        inputs.advance(f"{task}, {method}: {text}")
        rows.append(
            _row(f"{task}, {method}", whole.tolist(), physics.tolist(), {"ratio": STEP_RATIO_MAX}),
        )
        if carried.any():
            rows.append(
                _row(
                    f"{task}, {method}, while held",
                    whole[carried].tolist(),
                    physics[carried].tolist(),
                    {},
                ),
            )
    return rows


def _steps(bench: Bench, seed: int) -> tuple[Array, Array, NDArray[np.bool_], str]:
    """Return each step's time [ns] and that of bare physics beside it, whether it belongs to a carry, and the result."""
    bare = _Bare(bench.world)
    step_ns = list[int]()
    bare_ns = list[int]()
    held = list[bool]()
    ended_ns = 0

    def on_step(world: World, method: Method) -> None:
        nonlocal ended_ns
        if ended_ns:
            step_ns.append(time.perf_counter_ns() - ended_ns)
            held.append(method.phase == "carry")
            if len(step_ns) % BLOCK == 0:
                bare_ns.extend(bare.block())
        ended_ns = time.perf_counter_ns()

    result, _ = bench.run(bench.task.trial(seed, "bench", 0), on_step=on_step)
    n = len(bare_ns)
    return np.array(step_ns[:n]), np.array(bare_ns), np.array(held[:n]), result.text


class _Bare:
    """Physics alone, on from the state of a world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._data = mujoco.MjData(world.model)

    def block(self) -> list[int]:
        """Return the times [ns] of BLOCK steps."""
        mujoco.mj_copyData(self._data, self._world.model, self._world.data)
        times = []
        for _ in range(BLOCK):
            began = time.perf_counter_ns()
            mujoco.mj_step(self._world.model, self._data)
            times.append(time.perf_counter_ns() - began)
        return times


def _row(name: str, times_ns: list[int], bare_ns: list[int], limits: dict[str, float]) -> BenchRow:
    blocks = np.sort([np.mean(times_ns[k : k + BLOCK]) for k in range(0, len(times_ns), BLOCK)])
    median = float(np.median(times_ns)) / 1e3
    bare = float(np.median(bare_ns)) / 1e3
    mean = float(blocks[: max(1, len(blocks) // 10)].mean()) / 1e3
    numbers = {
        "median_us": median,
        "mean_us": mean,
        "bare_us": bare,
        "ratio": median / bare,
        "mean_ratio": mean / bare,
    }
    numbers["tenth_ratio"] = float(np.percentile(times_ns, 10) / np.percentile(bare_ns, 10))
    return BenchRow(name, numbers, limits)
