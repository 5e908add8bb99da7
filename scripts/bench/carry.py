"""What surrounds the law: a tick of measurement and supervisor alone, and a whole step of a trial of each task."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from minidual.config.root import changed
from minidual.control.joint_control import ComputedTorque
from minidual.control.measurement import Reader
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.show.report.bench import BenchRow, BenchTable
from minidual.skills.supervised import trial_supervisor
from minidual.stages.env_check.tracking import sine_reference
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench
from scripts.bench.tables import BenchInputs

BLOCK = 50
STEP_RATIO_MAX = 3.0
"""A whole step of a trial over bare physics."""
TICK_RATIO_MAX = 0.5
"""A tick of measurement and supervisor over bare physics, its median."""
MEAN_RATIO_MAX = 0.75
"""The same, its mean: some ticks look at distances, which takes longer."""
WATCHED_RATIO_MAX = 1.0
"""The same, with all stopping distances."""
COLUMNS = ("median_us", "mean_us", "bare_us", "ratio", "mean_ratio", "tenth_ratio")
_METHODS = ("impedance", "moveit")
_FINGERS_M = np.full(2, 0.04)
_SWING_RAD = 0.3
_SWING_HZ = 0.5


@dataclass
class Times:
    """Wall times [ns], each list in the order of its steps.

    Attributes:
        own: Of what is timed.
        bare: Of bare physics, in turns with `own`.
        held: Whether the object was held in a step of `own`.
    """

    own: list[int] = field(default_factory=list[int])
    bare: list[int] = field(default_factory=list[int])
    held: list[bool] = field(default_factory=list[bool])

    def while_held(self) -> Times:
        """Return the times of the steps with the object held."""
        own = list(itertools.compress(self.own, self.held))
        bare = list(itertools.compress(self.bare, self.held))
        return Times(own, bare, [True] * len(own))


def measure(inputs: BenchInputs) -> BenchTable:
    """Time ticks of the supervisor, and all steps of one trial of each task."""
    world = World(inputs.config.scene)
    watched = trial_supervisor(inputs.config.supervisor, world.dt, world.robot)
    rows = [
        tick(
            "measurement and supervisor: joints and hands",
            world,
            Supervisor(),
            {"ratio": TICK_RATIO_MAX, "mean_ratio": MEAN_RATIO_MAX},
            inputs.repeats_n,
        ),
        tick(
            "measurement and supervisor: and stopping distances",
            world,
            watched,
            {"mean_ratio": WATCHED_RATIO_MAX},
            inputs.repeats_n,
        ),
    ]
    for row in rows:
        inputs.advance(row.name)
    for task, method in itertools.product(TASKS, _METHODS):
        rows += trial_rows(task, method, inputs)
    return BenchTable(
        f"The tick of measurement and supervisor, and a trial's whole step beside bare mj_step, in turns of {BLOCK}",
        COLUMNS,
        tuple(rows),
        (
            "a whole step: sensing, estimate, monitors, arbiter, supervisor, law, physics, judge, log",
            "mean: of the fastest tenth of the turns",
            "tenth_ratio: of tenth percentiles, which other work on the machine disturbs least",
        ),
    )


def tick(
    name: str,
    world: World,
    supervisor: Supervisor,
    limits: dict[str, float],
    steps_n: int,
) -> BenchRow:
    """Time the checks of measurement and torques on arms that swing."""
    controller = ComputedTorque(Kinematics(world.robot))
    bare = _BarePhysics(world)
    world.reset(sine_reference(world.robot, _SWING_RAD, _SWING_HZ, 0.0)[0])
    reader = Reader(world, supervisor.config)
    measurement = reader.reset()
    applied = np.zeros(world.robot.dof)
    times = Times()
    for k in range(steps_n):
        reference = sine_reference(world.robot, _SWING_RAD, _SWING_HZ, world.time)
        tau = controller.torque(measurement.q, measurement.v, *reference)
        began = time.perf_counter_ns()
        applied = supervisor.guard(measurement, tau, applied)
        guard_ns = time.perf_counter_ns() - began
        world.command(applied, _FINGERS_M)
        world.step()
        began = time.perf_counter_ns()
        measurement = reader.read(applied, supervisor.observer.needed)
        read_ns = time.perf_counter_ns() - began
        times.own.append(guard_ns + read_ns)
        if k % BLOCK == BLOCK - 1:
            times.bare += bare.block()
    return _row(name, times.own, times.bare, limits)


def trial_rows(task: str, method: str, inputs: BenchInputs) -> list[BenchRow]:
    """Time all steps of one trial, and those with the object held."""
    config = make_task(changed(inputs.config, {"task": task})).config
    bench = Bench(method, MethodInputs(config, inputs.seed))
    times, result = _step_times(bench, inputs.seed)
    name = f"{task}, {method}"
    inputs.advance(f"{name}: {result}")
    rows = [_row(name, times.own, times.bare, {"ratio": STEP_RATIO_MAX})]
    held = times.while_held()
    if held.own:
        rows.append(_row(f"{name}, while held", held.own, held.bare, {}))
    return rows


def _step_times(bench: Bench, seed: int) -> tuple[Times, str]:
    """Return the times of a trial's steps, with bare physics beside each, and the trial's result."""
    bare = _BarePhysics(bench.world)
    times = Times()
    ended_ns = 0

    def on_step(_world: World, method: Method) -> None:
        nonlocal ended_ns
        if ended_ns:
            times.own.append(time.perf_counter_ns() - ended_ns)
            times.held.append(method.phase == "carry")
            if len(times.own) % BLOCK == 0:
                times.bare += bare.block()
        ended_ns = time.perf_counter_ns()

    result, _ = bench.run(bench.task.trial(seed, "bench", 0), on_step=on_step)
    whole_blocks_n = len(times.bare)
    del times.own[whole_blocks_n:]
    del times.held[whole_blocks_n:]
    return times, result.text


class _BarePhysics:
    """Physics alone, on from the state of a world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._data = mujoco.MjData(world.model)

    def block(self) -> list[int]:
        """Return the times [ns] of BLOCK steps."""
        mujoco.mj_copyData(self._data, self._world.model, self._world.data)
        times_ns = []
        for _ in range(BLOCK):
            began = time.perf_counter_ns()
            mujoco.mj_step(self._world.model, self._data)
            times_ns.append(time.perf_counter_ns() - began)
        return times_ns


def _row(
    name: str,
    own_ns: Sequence[int],
    bare_ns: Sequence[int],
    limits: dict[str, float],
) -> BenchRow:
    blocks_ns = np.sort([np.mean(own_ns[k : k + BLOCK]) for k in range(0, len(own_ns), BLOCK)])
    fastest_ns = blocks_ns[: max(1, len(blocks_ns) // 10)]
    median_us = float(np.median(own_ns)) / 1e3
    mean_us = float(fastest_ns.mean()) / 1e3
    bare_us = float(np.median(bare_ns)) / 1e3
    numbers = {
        "median_us": median_us,
        "mean_us": mean_us,
        "bare_us": bare_us,
        "ratio": median_us / bare_us,
        "mean_ratio": mean_us / bare_us,
        "tenth_ratio": float(np.percentile(own_ns, 10) / np.percentile(bare_ns, 10)),
    }
    return BenchRow(name, numbers, limits)
