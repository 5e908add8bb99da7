"""Run, judge and log trials."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from minidual import emergency
from minidual.config.seeds import stream
from minidual.control.bounds import SATURATED
from minidual.control.impedance import SingularPostureError
from minidual.control.kernels import strain
from minidual.errors import MinidualError
from minidual.plant.model import build_model
from minidual.plant.recorder import Recorder
from minidual.plant.recording import write_recording
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import robot_from
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Failure, begin
from minidual.tasks.task import Task, Trial
from minidual.tasks.truth import ObjectTruth
from minidual.trials.conditions import CLEAN, Disturbance
from minidual.trials.conditions import condition as named_condition
from minidual.trials.measures import LOG_RATE_HZ, TrialLog, measure
from minidual.trials.methods import METHODS, Method, MethodInputs, MethodSpec, check_able
from minidual.trials.metrics import TrialMetrics, trial_metrics
from minidual.workers import in_workers

SETTLED_S = 0.5
"""A trial ends this long after it is finished."""
# Errors that end a trial, with the failure name.
_BROKEN: dict[type[MinidualError], str] = {
    SimulationDivergedError: "diverged",
    SingularPostureError: "singular",
}

StepHook = Callable[[World, Method], None]
"""Called after each step; read-only."""
Watch = Callable[["Bench", str], StepHook]
"""Returns a trial's step hook, from bench and title."""


type Judged = tuple[TrialMetrics, TrialLog]


class Bench:
    """A world and a method for many trials under one condition, with its settings; `visuals` compiles visual meshes.

    Raises:
        UsageError: The condition sets a value out of bounds.
    """

    def __init__(
        self,
        method: str,
        inputs: MethodInputs,
        condition: str = CLEAN,
        *,
        visuals: bool = False,
    ) -> None:
        self.method = method
        self.seed = inputs.seed
        self.spec: MethodSpec = METHODS[method]
        self.condition = named_condition(condition)
        self.task: Task = make_task(self.condition.config_under(inputs.config))
        check_able(method, [self.task], inputs.trained)
        robot = robot_from(inputs.config.robot)
        model = build_model(self.task.scene, robot, visuals=visuals or self.spec.needs_images)
        self.world = World(self.task.scene, robot, model=model)
        self.kinematics = Kinematics(robot)
        self.hands = Hands(self.kinematics)
        self.factory = self.spec.factory(
            inputs._replace(config=self.task.config),
        )  # with the settings of the task

    def run(self, trial: Trial, *, on_step: StepHook = lambda world, method: None) -> Judged:
        """Run and judge one trial; an error in _BROKEN ends it as a failure, judged in its last complete state.

        Raises:
            EmergencyStop: It was pressed; the arms have stopped.
        """
        spec = self.condition
        rng = stream(self.seed, f"disturbance/{trial.purpose}/{spec.name}", trial.index)
        disturb = None if spec.act is None else spec.act(self.task, rng)
        with spec.applied(self.world.model, self.task, trial, rng):
            result, log = self._run(trial, disturb, on_step)
        emergency.check()  # what the emergency stop cut short is no result of the method
        return replace(
            result,
            condition=spec.name,
            disturbed=None if disturb is None else disturb.took_place,
        ), log

    def record(self, trial: Trial, path: Path) -> Judged:
        """Run a trial and write it to `path` (.npz) for replay."""
        recorder = self.world.recorder = Recorder(self.world, seed=self.seed)
        result, log = self.run(trial)
        self.world.recorder = None
        carry = self.task.config.carry
        details = {
            "method": self.method,
            "purpose": trial.purpose,
            "trial": trial.index,
            "success": result.success,
        }
        details |= {"task": self.task.name, "object": carry.object, "motion": carry.motion}
        write_recording(
            path,
            recorder.recording(
                f"{self.method}, trial {trial.index}: {result.text}",
                details=details,
            ),
        )
        return result, log

    def _run(self, trial: Trial, disturb: Disturbance | None, on_step: StepHook) -> Judged:
        world = self.world
        judge = begin(world, self.task, trial, self.spec.demands)
        began_s = time.process_time()
        method = self.factory(world, self.kinematics, trial)
        self.ran = method
        wall = {"planning_s": time.process_time() - began_s}
        every = round(1.0 / (LOG_RATE_HZ * world.dt))
        seen = judge.truth[self.task.carried]
        rows = list[tuple[Any, ...]]()
        phases = list[str]()
        most = np.zeros(2)
        saturated = np.zeros(world.robot.dof)
        tau_max = np.array(world.robot.tau_max)
        model = world.model
        data = world.data
        finished_s = 0.0
        broken = None
        time_s = data.time
        qpos = data.qpos
        qvel = data.qvel
        last_q = qpos.copy()
        last_v = qvel.copy()
        for step in range(round(self.task.time_limit_s / world.dt)):
            try:
                method.step()
            except tuple(_BROKEN) as error:
                data.time = time_s  # a diverged world has been reset
                qpos[:] = last_q
                qvel[:] = last_v
                mujoco.mj_forward(model, data)
                broken = Failure(_BROKEN[type(error)], world.time, error.message)
                judge.truth.refresh(world)
                rows = rows or [self._sample(seen)]
                break
            last_q = qpos.copy()  # half the time of writing into an array
            last_v = qvel.copy()
            judge.observe(world)
            time_s = judge.truth.time
            strain(world.tau, tau_max, SATURATED, saturated, most)
            if step % every == 0:
                rows.append(self._sample(seen))
                phases.append(method.phase)
            if disturb is not None:
                before = disturb.took_place
                disturb(world)
                if disturb.took_place and not before:
                    judge.disturbed()
            on_step(world, method)
            finished_s = finished_s + world.dt if judge.finished else 0.0
            if method.done or finished_s > SETTLED_S:
                break
        log = TrialLog(*map(np.array, zip(*rows, strict=True)))
        outcome = judge.outcome(world)
        if broken is not None:  # the cause comes before its consequences
            outcome = replace(outcome, success=False, failures=(broken, *outcome.failures))
        controls = self.task.together and "squeezed" in self.spec.demands
        wanted_n = self.task.config.carry.impedance.internal_force_n if controls else math.nan
        mass_kg = float(model.body_mass[world.truth(self.task.carried).body])
        found = {name: x for name, x in measure(log, mass_kg, wanted_n).items() if math.isfinite(x)}
        outcome = replace(outcome, measured={**outcome.measured, **found})
        wall["inference_s"] = getattr(method, "inference_s", math.nan)
        known: Any = {
            "torque_ratio_max": most.item(0),
            "saturated_max_s": most.item(1) * world.dt,
            "wall": wall,
        }
        result = trial_metrics(
            self.method,
            trial.index,
            outcome,
            log,
            aborted=method.aborted or "",
            **known,
        )
        if not result.success:
            until = phases[: int(result.failed_at_s * LOG_RATE_HZ) + 1]
            result = replace(
                result,
                failed_in=next((p for p in reversed(until) if p not in ("stop", "done")), ""),
            )
        return result, log

    def _sample(self, seen: ObjectTruth) -> tuple[Any, ...]:
        world = self.world
        q = self.world.q
        self.hands.update(q)
        thing = seen.xyz, seen.tilt_rad, seen.pinch, seen.squeeze_n, seen.airborne
        return (world.time, q, world.tau, [p.copy() for p in self.hands.p], *thing)


_BENCHES: dict[str, Bench] = {}


def _bench(method: str, inputs: MethodInputs, condition: str) -> Bench:
    key = (
        f"{method}/{condition}/{inputs.checkpoint}/{inputs.seed}/{inputs.config.model_dump_json()}"
    )
    if key not in _BENCHES:
        _BENCHES.clear()
        _BENCHES[key] = Bench(method, inputs, condition)
    return _BENCHES[key]


def run_trials(
    method: str,
    inputs: MethodInputs,
    trials: Sequence[Trial],
    *,
    workers: int,
    condition: str = CLEAN,
    watch: Watch | None = None,
) -> Iterator[TrialMetrics]:
    """Run trials in parallel, or watched in this process; yield results in order."""
    if watch is not None:
        bench = Bench(method, inputs, condition)
        for number, trial in enumerate(trials, start=1):
            title = f"{method}, trial {number} of {len(trials)}" + (
                f", {condition}" if condition != CLEAN else ""
            )
            yield bench.run(trial, on_step=watch(bench, title))[0]
        return
    yield from in_workers(
        lambda trial: _bench(method, inputs, condition).run(trial)[0],
        trials,
        workers,
    )
