"""Run, judge and log trials."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from minidual import emergency
from minidual.config.seeds import stream
from minidual.control.bounds import SATURATED
from minidual.control.impedance import SingularPostureError
from minidual.errors import MinidualError
from minidual.plant.model import build_model
from minidual.plant.recorder import Recorder
from minidual.plant.recording import write_recording
from minidual.plant.simulation import Simulation
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array, Robot, robot_from
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Failure, Outcome
from minidual.tasks.task import Task, Trial
from minidual.trials.compared import name_policies
from minidual.trials.condition import Disturbance
from minidual.trials.conditions import CLEAN
from minidual.trials.conditions import condition as named_condition
from minidual.trials.measures import LOG_RATE_HZ, Sample, TrialLog, measure
from minidual.trials.methods import (
    METHODS,
    Method,
    MethodInputs,
    MethodSpec,
    check_able,
)
from minidual.trials.metrics import TrialMetrics, trial_metrics
from minidual.trials.site import SimulatedSite, Site
from minidual.trials.strain import strain
from minidual.workers import in_workers

SETTLED_S = 0.5
"""A trial ends this long after it is finished."""
# Errors that end a trial, with the failure's name.
_BROKEN: dict[type[MinidualError], str] = {
    SimulationDivergedError: "diverged",
    SingularPostureError: "singular",
}
# Phases of a method that has stopped: they do not tell where it failed.
_ENDED_PHASES = ("stop", "done")

StepHook = Callable[[Simulation, Method], None]
"""Called after each step; read-only."""
Watch = Callable[["Bench", str], StepHook]
"""Returns a trial's step hook, from bench and title."""

type Judged = tuple[TrialMetrics, TrialLog]


def _watch_nothing(world: Simulation, method: Method) -> None:
    pass


class Bench:
    """A site and a method for many trials under one condition, with its settings.

    Attributes:
        ran: The method of the latest trial.
        plant: What the method drives.
        world: What the judge sees.
        inputs: Of the method, with its senses there.

    Args:
        method: Row of METHODS.
        inputs: With the configuration, to which the condition's settings are added.
        condition: Row of CONDITIONS; CLEAN at any site but the simulator's.
        visuals: Whether to compile visual meshes even if the method needs none.
        site: Where; by default a simulated world of its own.

    Raises:
        UsageError: The condition sets a value out of bounds.
    """

    ran: Method

    def __init__(
        self,
        method: str,
        inputs: MethodInputs,
        condition: str = CLEAN,
        *,
        visuals: bool = False,
        site: Site | None = None,
    ) -> None:
        name_policies((method,), inputs.policies.keys() & {method})  # a worker has its own table
        inputs = inputs.of(method)
        self.method = method
        self.seed = inputs.seed
        self.spec: MethodSpec = METHODS[method]
        self.condition = named_condition(condition)
        self.task: Task = make_task(self.condition.config_under(inputs.config))
        check_able(method, [self.task], inputs.trained)
        robot = robot_from(inputs.config.robot)
        if site is None:
            model = build_model(self.task.scene, robot, visuals=visuals or self.spec.needs_images)
            site = SimulatedSite(World(self.task.scene, robot, model=model))
        self.site = site
        self.plant = site.plant
        self.world = site.world
        self.kinematics = Kinematics(site.plant.robot)
        self.hands = Hands(self.kinematics)
        self.inputs = inputs._replace(
            config=self.task.config,
            senses=site.senses,
            plant=site.plant,
        )
        self.factory = self.spec.factory(self.inputs)

    def run(self, trial: Trial, *, on_step: StepHook = _watch_nothing) -> Judged:
        """Run and judge one trial.

        An error in _BROKEN ends it as a failure, judged in its last complete state.

        Raises:
            EmergencyStop: It was pressed; the arms have stopped.
        """
        condition = self.condition
        rng = stream(self.seed, f"disturbance/{trial.purpose}/{condition.name}", trial.index)
        disturbance = None if condition.act is None else condition.act(self.task, rng)
        with condition.applied(self.world.model, self.task, trial, rng):
            run = _TrialRun(self, trial, disturbance, on_step)
            self.ran = run.method
            run.simulate()
            result, log = run.judged()
        emergency.check()  # what the emergency stop cut short is no result of the method
        took_place = None if disturbance is None else disturbance.took_place
        return replace(result, condition=condition.name, disturbed=took_place), log

    def record(self, trial: Trial, path: Path) -> Judged:
        """Run a trial and write it to `path` (.npz) for replay."""
        recorder = Recorder(self.world, seed=self.seed)
        self.world.recorder = recorder
        result, log = self.run(trial)
        self.world.recorder = None
        carry = self.task.config.carry
        details = {
            "method": self.method,
            "purpose": trial.purpose,
            "trial": trial.index,
            "success": result.success,
            "task": self.task.name,
            "object": carry.object,
            "motion": carry.motion,
        }
        title = f"{self.method}, trial {trial.index}: {result.text}"
        write_recording(path, recorder.recording(title, details=details))
        return result, log


class _TrialRun:
    """One trial while it runs: its judge, log and measures."""

    def __init__(
        self,
        bench: Bench,
        trial: Trial,
        disturbance: Disturbance | None,
        on_step: StepHook,
    ) -> None:
        self._bench = bench
        self._world = bench.world
        self._plant = bench.plant
        self._trial = trial
        self._log_every = max(1, round(1.0 / (LOG_RATE_HZ * bench.plant.dt)))
        self._log_rate_hz = 1.0 / (self._log_every * bench.plant.dt)
        self._disturbance = disturbance
        self._on_step = on_step
        self._judge = bench.site.begin(bench.task, trial, bench.spec.demands)
        began_s = time.process_time()
        self.method = bench.factory(bench.plant, bench.kinematics, trial)
        self._planning_s = time.process_time() - began_s
        bench.site.start(self._judge)
        self._carried = self._judge.truth[bench.task.carried]
        self._samples: list[Sample] = []
        self._phases: list[str] = []
        self._strain = _MotorStrain(bench.plant.robot)
        self._complete = _CompleteState(bench.world)
        self._broken: Failure | None = None

    def simulate(self) -> None:
        """Run the method until it is done, the task is finished, the time is over, or it breaks."""
        world = self._world
        dt_s = self._plant.dt
        finished_s = 0.0
        for step in range(round(self._bench.task.time_limit_s / dt_s)):
            try:
                self.method.step()
            except tuple(_BROKEN) as error:
                self._end_broken(error)
                return
            self._complete.remember()
            self._judge.observe(world)
            self._strain.update(self._plant.tau)
            if step % self._log_every == 0:
                self._samples.append(self._sample())
                self._phases.append(self.method.phase)
            self._disturb()
            self._on_step(world, self.method)
            finished_s = finished_s + dt_s if self._judge.finished else 0.0
            if self.method.done or finished_s > SETTLED_S:
                return

    def _disturb(self) -> None:
        """Apply the disturbance, and tell the judge when it has acted."""
        disturbance = self._disturbance
        if disturbance is None:
            return
        took_place_before = disturbance.took_place
        disturbance(self._world)
        if disturbance.took_place and not took_place_before:
            self._judge.disturbed()

    def _end_broken(self, error: MinidualError) -> None:
        self._complete.restore()
        self._judge.truth.refresh(self._world)
        self._broken = Failure(_BROKEN[type(error)], self._judge.truth.time, error.message)
        if not self._samples:
            self._samples.append(self._sample())

    def _sample(self) -> Sample:
        plant = self._plant
        q = plant.q
        hands = self._bench.hands
        hands.update(q)
        carried = self._carried
        return Sample(
            t=self._judge.truth.time,
            q=q,
            tau=plant.tau,
            tcp=[p.copy() for p in hands.p],
            position=carried.xyz,
            tilt=carried.tilt_rad,
            pinch=carried.pinch,
            internal_force=carried.squeeze_n,
            airborne=carried.airborne,
        )

    def judged(self) -> Judged:
        """Return the result and the log."""
        log = TrialLog.of(self._samples, self._log_rate_hz)
        result = trial_metrics(
            self._bench.method,
            self._trial.index,
            self._outcome(log),
            log,
            torque_ratio_max=self._strain.ratio_max,
            saturated_max_s=self._strain.saturated_ticks_max * self._plant.dt,
            aborted=self.method.aborted or "",
            wall={
                "planning_s": self._planning_s,
                "inference_s": getattr(self.method, "inference_s", math.nan),
            },
        )
        if not result.success:
            result = replace(result, failed_in=self._phase_at(result.failed_at_s))
        return result, log

    def _outcome(self, log: TrialLog) -> Outcome:
        """Return the judge's outcome, with the measures of the motion."""
        outcome = self._judge.outcome(self._world)
        if self._broken is not None:  # the cause comes before its consequences
            failures = (self._broken, *outcome.failures)
            outcome = replace(outcome, success=False, failures=failures)
        task = self._bench.task
        body = self._world.truth(task.carried).body
        mass_kg = float(self._world.model.body_mass[body])
        controls_force = task.together and "squeezed" in self._bench.spec.demands
        wanted_n = task.config.carry.impedance.internal_force_n if controls_force else math.nan
        measures = {
            name: value
            for name, value in measure(log, mass_kg, wanted_n).items()
            if math.isfinite(value)
        }
        return replace(outcome, measured={**outcome.measured, **measures})

    def _phase_at(self, time_s: float) -> str:
        """Return the method's phase at a time; the last one before it stopped."""
        logged_n = int(time_s * self._log_rate_hz) + 1
        for phase in reversed(self._phases[:logged_n]):
            if phase not in _ENDED_PHASES:
                return phase
        return ""


class _MotorStrain:
    """The largest share of its limit that a motor gives, and how long one stays at its limit."""

    def __init__(self, robot: Robot) -> None:
        self._tau_max = np.array(robot.tau_max)
        self._saturated_ticks = np.zeros(robot.dof)
        self._largest = np.zeros(2)

    def update(self, tau: Array) -> None:
        """Take the motor torques (n,) [Nm] of one step."""
        strain(tau, self._tau_max, SATURATED, self._saturated_ticks, self._largest)

    @property
    def ratio_max(self) -> float:
        """Largest |torque| / limit so far."""
        return self._largest.item(0)

    @property
    def saturated_ticks_max(self) -> float:
        """Most steps in a row of one motor at its limit."""
        return self._largest.item(1)


class _CompleteState:
    """The latest state that a step completed; a world that has diverged is reset."""

    def __init__(self, world: Simulation) -> None:
        self._model = world.model
        self._data = world.data
        self.remember()

    def remember(self) -> None:
        self._time_s = self._data.time
        # A copy takes half the time of writing into an array.
        self._qpos = self._data.qpos.copy()
        self._qvel = self._data.qvel.copy()

    def restore(self) -> None:
        self._data.time = self._time_s
        self._data.qpos[:] = self._qpos
        self._data.qvel[:] = self._qvel
        mujoco.mj_forward(self._model, self._data)


_BENCHES: dict[str, Bench] = {}
"""The latest bench of this process, by its inputs."""


def _bench(method: str, inputs: MethodInputs, condition: str) -> Bench:
    inputs = inputs.of(method)
    settings = inputs.config.model_dump_json()
    key = f"{method}/{condition}/{inputs.checkpoint}/{inputs.seed}/{settings}"
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
    site: Site | None = None,
) -> Iterator[TrialMetrics]:
    """Run trials in parallel, or in this process if they are watched or at a site; yield in order."""
    if watch is not None or site is not None:
        yield from _run_here(Bench(method, inputs, condition, site=site), trials, watch)
        return
    yield from in_workers(
        lambda trial: _bench(method, inputs, condition).run(trial)[0],
        trials,
        workers,
    )


def _run_here(
    bench: Bench,
    trials: Sequence[Trial],
    watch: Watch | None,
) -> Iterator[TrialMetrics]:
    under = "" if bench.condition.name == CLEAN else f", {bench.condition.name}"
    for number, trial in enumerate(trials, start=1):
        title = f"{bench.method}, trial {number} of {len(trials)}{under}"
        on_step = _watch_nothing if watch is None else watch(bench, title)
        result, _ = bench.run(trial, on_step=on_step)
        yield result
