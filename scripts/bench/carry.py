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
from minidual.plant.simulation import Simulation
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.show.report.bench import BenchRow, BenchTable
from minidual.skills.supervised import trial_supervisor
from minidual.stages.env_check.tracking import sine_reference
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench
from scripts.bench.step import COLUMNS, NOTES, Spread, StepCost, bare_step_ns, elapsed_ns
from scripts.bench.tables import BenchInputs

BLOCK = 50
STEP_MEAN_RATIO_MAX = 3.5
"""A whole step of a trial over bare physics, the mean of all steps: the goal."""
STEP_MEDIAN_RATIO_MAX = 3.0
"""The same, its median."""
TICK_MEDIAN_RATIO_MAX = 0.5
"""A tick of measurement and supervisor over bare physics, its median."""
TICK_MEAN_RATIO_MAX = 0.75
"""The same, its mean: some ticks look at distances, which takes longer."""
WATCHED_MEAN_RATIO_MAX = 1.0
"""The same, with all stopping distances."""
STEP_LIMITS = {"mean_ratio": STEP_MEAN_RATIO_MAX, "median_ratio": STEP_MEDIAN_RATIO_MAX}
_METHODS = ("impedance", "moveit")
_FINGERS_M = np.full(2, 0.04)
_SWING_RAD = 0.3
_SWING_HZ = 0.5


@dataclass
class Times:
    """Processor times [ns], each list in the order of its steps.

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
            {"median_ratio": TICK_MEDIAN_RATIO_MAX, "mean_ratio": TICK_MEAN_RATIO_MAX},
            inputs.repeats_n,
        ),
        tick(
            "measurement and supervisor: and stopping distances",
            world,
            watched,
            {"mean_ratio": WATCHED_MEAN_RATIO_MAX},
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
            "a whole step: sensing, estimate, monitors, arbiter, supervisor with its looks at distances,",
            "    law, physics, judge, log",
            *NOTES,
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
        began_ns = time.process_time_ns()
        applied = supervisor.guard(measurement, tau, applied)
        guard_ns = elapsed_ns(began_ns)
        world.command(applied, _FINGERS_M)
        world.step()
        began_ns = time.process_time_ns()
        measurement = reader.read(applied, supervisor.observer.needed)
        read_ns = elapsed_ns(began_ns)
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
    rows = [_row(name, times.own, times.bare, STEP_LIMITS)]
    held = times.while_held()
    if held.own:
        rows.append(_row(f"{name}, while held", held.own, held.bare, STEP_LIMITS))
    return rows


def _step_times(bench: Bench, seed: int) -> tuple[Times, str]:
    """Return the times of a trial's steps, with bare physics beside each, and the trial's result."""
    bare = _BarePhysics(bench.world)
    times = Times()
    ended_ns = 0

    def on_step(_world: Simulation, method: Method) -> None:
        nonlocal ended_ns
        if ended_ns:
            times.own.append(elapsed_ns(ended_ns))
            times.held.append(method.phase == "carry")
            if len(times.own) % BLOCK == 0:
                times.bare += bare.block()
        ended_ns = time.process_time_ns()

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
            times_ns.append(bare_step_ns(self._world.model, self._data))
        return times_ns


def _row(
    name: str,
    own_ns: Sequence[int],
    bare_ns: Sequence[int],
    limits: dict[str, float],
) -> BenchRow:
    cost = StepCost(Spread.of(own_ns), Spread.of(bare_ns))
    return BenchRow(name, cost.numbers(), limits)
