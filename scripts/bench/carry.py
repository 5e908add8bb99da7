"""What surrounds the law in a carry: a tick of the supervisor alone, and a whole step of a trial."""

from __future__ import annotations

import time

import mujoco
import numpy as np

from minidual.control.joint_control import ComputedTorque
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.supervised import trial_supervisor
from minidual.stages.env_check.tracking import sine_reference
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench
from scripts.bench.tables import BenchInputs, BenchRow, BenchTable

BLOCK = 50
STEP_RATIO_MAX = 3.0
"""A whole step of a carry over bare physics."""
TICK_RATIO_MAX, MEAN_RATIO_MAX, WATCHED_RATIO_MAX = 0.5, 0.75, 1.0
"""A tick of the supervisor over bare physics: its median, its mean with the slow looks, and with all distances."""
_FINGERS_M = np.full(2, 0.04)


def measure(inputs: BenchInputs) -> BenchTable:
    """Time ticks of the supervisor, and all steps of one carry."""
    rows: list[BenchRow] = []
    world = World(inputs.config.scene)
    watched = trial_supervisor(inputs.config.supervisor, world.dt, world.robot)
    for name, supervisor, limits in (
        ("supervisor: joints and hands", Supervisor(), {"ratio": TICK_RATIO_MAX, "mean_ratio": MEAN_RATIO_MAX}),
        ("supervisor: and stopping distances", watched, {"mean_ratio": WATCHED_RATIO_MAX}),
    ):
        rows.append(tick(name, world, supervisor, limits, inputs.repeats_n))
        inputs.advance(name)
    rows += carry(inputs)
    return BenchTable(
        f"The supervisor's tick and a carry's whole step beside bare mj_step, in turns of {BLOCK}",
        ("median_us", "mean_us", "bare_us", "ratio", "mean_ratio", "tenth_ratio"),
        tuple(rows),
        (
            "A whole step: sensing, estimate, monitors, arbiter, supervisor, law, physics, judge, log. mean: fastest tenth.",
            "tenth_ratio: of tenth percentiles, which other work on the machine disturbs least.",
        ),
    )


def tick(name: str, world: World, supervisor: Supervisor, limits: dict[str, float], steps_n: int) -> BenchRow:
    """Time `guard` on arms that swing."""
    controller = ComputedTorque(Kinematics(world.robot))
    bare = _Bare(world)
    world.reset(sine_reference(world.robot, 0.3, 0.5, 0.0)[0])
    guard_ns, bare_ns = [], []
    for k in range(steps_n):
        q, v = world.q, world.v
        tau = controller.torque(q, v, *sine_reference(world.robot, 0.3, 0.5, world.time))
        began = time.perf_counter_ns()
        tau = supervisor.guard(world.time, q, v, tau)
        guard_ns.append(time.perf_counter_ns() - began)
        world.command(tau, _FINGERS_M)
        world.step()
        if k % BLOCK == BLOCK - 1:
            bare_ns += bare.block()
    return _row(name, guard_ns, bare_ns, limits)


def carry(inputs: BenchInputs) -> list[BenchRow]:
    """Time all steps of an impedance trial, and those in which the object is held."""
    bench = Bench("impedance", MethodInputs(inputs.config, inputs.seed))
    bare, step_ns, bare_ns, held = _Bare(bench.world), list[int](), list[int](), list[bool]()
    ended_ns = 0

    def on_step(world: World, method: Method) -> None:
        nonlocal ended_ns
        if ended_ns:
            step_ns.append(time.perf_counter_ns() - ended_ns)
            held.append(method.phase == "carry")
            if len(step_ns) % BLOCK == 0:
                bare_ns.extend(bare.block())
        ended_ns = time.perf_counter_ns()

    result, _ = bench.run(bench.task.trial(inputs.seed, "bench", 0), on_step=on_step)
    inputs.advance(f"carry: {result.text}")
    n = len(bare_ns)
    whole, physics, carried = np.array(step_ns[:n]), np.array(bare_ns), np.array(held[:n])
    return [
        _row("carry, whole step", whole.tolist(), physics.tolist(), {"ratio": STEP_RATIO_MAX}),
        _row("carry, whole step while it is held", whole[carried].tolist(), physics[carried].tolist(), {}),
    ]


class _Bare:
    """Physics alone, on from the state of a world."""

    def __init__(self, world: World) -> None:
        self._world, self._data = world, mujoco.MjData(world.model)

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
    median, bare = float(np.median(times_ns)) / 1e3, float(np.median(bare_ns)) / 1e3
    mean = float(blocks[: max(1, len(blocks) // 10)].mean()) / 1e3
    numbers = {"median_us": median, "mean_us": mean, "bare_us": bare, "ratio": median / bare, "mean_ratio": mean / bare}
    numbers["tenth_ratio"] = float(np.percentile(times_ns, 10) / np.percentile(bare_ns, 10))
    return BenchRow(name, numbers, limits)
