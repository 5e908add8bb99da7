"""Run rod trials, one or many, on one core or all, and keep what is needed to judge and to plot them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from minidual.config.seeds import stream
from minidual.control.object_impedance import SingularPostureError
from minidual.errors import MinidualError
from minidual.plant.model import build_model
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.tasks.judge import Fault, Outcome, begin
from minidual.tasks.rod_carry import tilt_rad
from minidual.tasks.task import Task, Trial, make_task
from minidual.trials.conditions import CLEAN
from minidual.trials.conditions import condition as named_condition
from minidual.trials.methods import Factory, Method, MethodInputs, load_factory, method_spec
from minidual.trials.metrics import TrialMetrics, trial_metrics

LOG_RATE_HZ = 250
_SATURATED = 0.999
"""Share of its limit from which a motor counts as saturated; controllers clip at the limit itself."""
SETTLED_S = 0.5
"""A trial ends this long after its rod lies finished; methods without an end of their own would go on."""
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_BROKEN: dict[type[MinidualError], str] = {SimulationDivergedError: "diverged", SingularPostureError: "singular"}
"""What may end a trial from below its method, and the name under which it fails then."""


StepHook = Callable[[World, Method], None]
"""Called after each step of a trial; it only reads."""
Watch = Callable[["Bench", str], StepHook]
"""Given the bench and a title before each trial that is watched; returns the trial's step hook."""


@dataclass
class TrialLog:
    """Time series of one trial at 250 Hz.

    Attributes:
        t: (T,) [s].
        q: (T, n) measured joints [rad].
        tau: (T, n) motor torques [Nm].
        tcp: (T, 2, 3) positions of the tool centre points [m].
        rod: (T, 3) rod position [m].
        tilt: (T,) [rad].
        pinch: (T, 2) [N].
        internal_force: (T,) [N].
        phase: (T,) names.
    """

    t: Array
    q: Array
    tau: Array
    tcp: Array
    rod: Array
    tilt: Array
    pinch: Array
    internal_force: Array
    phase: list[str]


@dataclass(frozen=True)
class TrialResult:
    """One trial as run: its metrics, and all that failed, not only what failed first.

    Attributes:
        metrics: The row of the tables.
        faults: (name, time [s], detail) of everything that failed.
        aborted: Why the method stopped itself, or an empty string.
        lifted: Whether the rod rose clear of the table.
        saturated_max_s: Longest time that one motor stood at its torque limit.
        wall_s: Wall time of the trial; it differs from run to run and stays out of the tables.
    """

    metrics: TrialMetrics
    faults: tuple[tuple[str, float, str], ...]
    aborted: str
    lifted: bool
    wall_s: float
    saturated_max_s: float = 0.0

    @property
    def success(self) -> bool:
        """Whether the task's success test passed."""
        return self.metrics.success

    @property
    def text(self) -> str:
        """Return the outcome as one line for people."""
        if self.success:
            return "success"
        metrics = self.metrics
        stop = f" (stopped itself: {self.aborted})" if self.aborted else ""
        return f"{metrics.failure} at {metrics.failed_at_s:.2f} s: {metrics.reason}{stop}"


def run_trial(
    method_name: str,
    factory: Factory,
    world: World,
    kinematics: Kinematics,
    task: Task,
    trial: Trial,
    *,
    condition: str = CLEAN,
    on_step: StepHook | None = None,
) -> tuple[TrialResult, TrialLog]:
    """Reset the world, run one trial to its end or its time limit, and judge it.

    A trial that breaks (_BROKEN) has failed and is judged as it stood after its last whole step; others go on.
    """
    scene = world.scene
    began = time.perf_counter()
    judge = begin(world, task, trial, method_spec(method_name).demands)
    method = factory(world, kinematics, trial)
    every = round(1.0 / (LOG_RATE_HZ * world.dt))
    columns: list[tuple[Any, ...]] = []
    peak = np.zeros(world.robot.dof)
    saturated, longest, longest_now = np.zeros(world.robot.dof, dtype=int), 0, 0
    steps = round(scene.task.time_limit_s / world.dt)
    finished_s, broken = 0.0, None
    last = np.empty(mujoco.mj_stateSize(world.model, _STATE))
    mujoco.mj_getState(world.model, world.data, last, _STATE)
    for step in range(steps):
        try:
            method.step()
        except tuple(_BROKEN) as error:
            mujoco.mj_setState(world.model, world.data, last, _STATE)  # one that diverged has been reset
            mujoco.mj_forward(world.model, world.data)
            broken = Fault(_BROKEN[type(error)], world.time, error.message)
            if not columns:
                columns.append(_sample(world, kinematics, method.phase))
            break
        mujoco.mj_getState(world.model, world.data, last, _STATE)
        judge.observe(world)
        ratio = np.abs(world.tau) / world.robot.tau_max
        np.maximum(peak, ratio, out=peak)
        if ratio.max() >= _SATURATED or longest_now:
            saturated = np.where(ratio >= _SATURATED, saturated + 1, 0)
            longest_now = int(saturated.max())
            longest = max(longest, longest_now)
        if step % every == 0:
            columns.append(_sample(world, kinematics, method.phase))
        if on_step is not None:
            on_step(world, method)
        finished_s = finished_s + world.dt if judge.finished else 0.0
        if method.done or finished_s > SETTLED_S:
            break
    log = _collect(columns)
    outcome = _with_fault(judge.outcome(world), broken)
    metrics = trial_metrics(
        method_name,
        trial.index,
        outcome,
        q=log.q,
        torque_ratio_max=float(peak.max()),  # of every step, not of the log's 250 Hz
        tcp_positions=log.tcp,
        rate_hz=LOG_RATE_HZ,
        condition=condition,
    )
    result = TrialResult(
        metrics=replace(metrics, aborted=method.aborted or ""),
        faults=tuple((f.name, f.at_s, f.detail) for f in outcome.faults),
        aborted=method.aborted or "",
        lifted=outcome.rise_m > scene.task.clear_height_m,
        wall_s=time.perf_counter() - began,
        saturated_max_s=longest * world.dt,
    )
    return result, log


def _with_fault(outcome: Outcome, broken: Fault | None) -> Outcome:
    """Return the verdict on a trial that broke; its fault stands before those that only follow from it."""
    if broken is None:
        return outcome
    return replace(outcome, success=False, faults=(broken, *outcome.faults))


def _sample(world: World, kinematics: Kinematics, phase: str) -> tuple[Any, ...]:
    q = world.q
    left, right = kinematics.tcp_poses(q)
    T = world.object_pose()
    return (
        world.time,
        q,
        world.tau,
        np.array([left[:3, 3], right[:3, 3]]),
        T[:3, 3],
        tilt_rad(T),
        world.pinch(),
        world.internal_force(),
        phase,
    )


def _collect(columns: list[tuple[Any, ...]]) -> TrialLog:
    *numbers, phases = zip(*columns, strict=True)
    return TrialLog(*(np.array(c) for c in numbers), list(phases))


class Bench:
    """A world and a method, built once in a process and used for many trials."""

    def __init__(self, method: str, inputs: MethodInputs) -> None:
        self.method, self.seed = method, inputs.seed
        self.task = make_task(inputs.config)
        scene = self.task.scene
        robot = robot_from(inputs.config.robot)
        model = build_model(scene, robot, visuals=method_spec(method).needs_images)
        self.world = World(scene, robot, model=model)
        self.kinematics = Kinematics(robot)
        self.factory = load_factory(method, inputs)

    def run(
        self, trial: Trial, *, condition: str = CLEAN, on_step: StepHook | None = None
    ) -> tuple[TrialResult, TrialLog]:
        """Run one trial under a condition of the table in `minidual.trials.conditions`."""
        spec = named_condition(condition)
        disturb = spec.disturbance(stream(self.seed, f"disturbance/{trial.purpose}/{spec.name}", trial.index))

        def both(world: World, method: Method) -> None:
            if disturb is not None:
                disturb(world)
            if on_step is not None:
                on_step(world, method)

        with spec.applied(self.world.model, trial.index):
            result, log = run_trial(
                self.method,
                self.factory,
                self.world,
                self.kinematics,
                self.task,
                trial,
                condition=spec.name,
                on_step=None if disturb is None and on_step is None else both,
            )
        if disturb is not None:
            result = replace(result, metrics=replace(result.metrics, disturbed=disturb.took_place))
        return result, log


_BENCHES: dict[str, Bench] = {}


def _run_in_worker(
    method: str, inputs: MethodInputs, trial: Trial, condition: str, keep_log: bool
) -> tuple[TrialResult, TrialLog | None]:
    key = f"{method}/{inputs.checkpoint}/{inputs.seed}/{inputs.config.model_dump_json()}"
    if key not in _BENCHES:
        _BENCHES.clear()
        _BENCHES[key] = Bench(method, inputs)
    result, log = _BENCHES[key].run(trial, condition=condition)
    return result, log if keep_log else None


def _run_watched(
    method: str, inputs: MethodInputs, trials: Sequence[Trial], condition: str, watch: Watch
) -> Iterator[tuple[TrialResult, TrialLog | None]]:
    bench = Bench(method, inputs)
    for number, trial in enumerate(trials, start=1):
        title = f"{method}, trial {number} of {len(trials)}" + (f", {condition}" if condition != CLEAN else "")
        yield bench.run(trial, condition=condition, on_step=watch(bench, title))


def run_trials(
    method: str,
    inputs: MethodInputs,
    trials: Sequence[Trial],
    *,
    workers: int,
    condition: str = CLEAN,
    keep_logs: bool = False,
    watch: Watch | None = None,
) -> Iterator[tuple[TrialResult, TrialLog | None]]:
    """Run trials over processes and yield their results in order; the results do not depend on `workers`.

    Watched trials run in this process, one after another, and give the same results.
    """
    if watch is not None:
        yield from _run_watched(method, inputs, trials, condition, watch)
        return
    import joblib

    import minidual.control.kernels  # noqa: F401 - compiled once here, or every process would compile for itself

    # One numeric thread a process: on a busy machine more of them only wait for each other.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    yield from joblib.Parallel(n_jobs=min(workers, max(1, len(trials))), return_as="generator", batch_size=1)(
        joblib.delayed(_run_in_worker)(method, inputs, trial, condition, keep_logs) for trial in trials
    )
