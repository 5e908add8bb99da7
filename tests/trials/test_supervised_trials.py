"""Every trial has the supervisor before the motors: a reflex ends the trial by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leaders.scripted import ScriptedLeader
from minidual.demos.session import TeleopSession
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.policies.pilot import PolicyPilot
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.operator import ScriptedOperator
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.supervised import arm_distance, trial_supervisor
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench
from tests.support.carries import true_poses
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.panda import HOME

SEED = 7
TASK = make_task(Config())
FRAIL = SupervisorConfig(velocity_scale=0.05)
"""Stops at 5 % of the joints' speed limits: any motion is too fast."""


class Still:
    """A policy that asks for one posture."""

    inference_hz = 100.0
    joints_n = 14

    def __init__(self, away_rad: float) -> None:
        self.cameras: dict[str, tuple[int, int]] = {}
        self.inputs: dict[str, int] = {}
        self.times_s: list[float] = []
        self._action = np.r_[HOME + away_rad, 1.0, 1.0]

    def reset(self) -> None: ...

    def flush(self) -> None: ...

    def act(self, images: Any, state: Array) -> Array:
        return self._action


@pytest.fixture
def trial(world: World) -> Trial:
    trial = sample_trial(world.scene, SEED, "benchmark", 0)
    world.reset(poses=trial.start)
    return trial


def _steps(method: Any, limit: int) -> int:
    for step in range(limit):
        method.step()
        if method.done:
            return step + 1
    return limit


@pytest.mark.parametrize(
    ("config", "reflex"),
    [(FRAIL, "speed.joint"), (SupervisorConfig(), "")],
)
def test_a_reflex_ends_the_trial_of_a_policy(
    world: World,
    trial: Trial,
    config: SupervisorConfig,
    reflex: str,
) -> None:
    runtime: Any = Still(0.3)
    supervisor = trial_supervisor(config, world.dt, DUAL_PANDA)
    stack = ControlStack(world, Kinematics(), supervisor=supervisor)
    pilot = PolicyPilot(stack, runtime, lambda name: (np.zeros((1, 1, 3), np.uint8), world.time))
    _steps(pilot, 400)
    assert (pilot.aborted is not None) == bool(reflex)
    if reflex:
        assert f"reflex {reflex}" in (pilot.aborted or "")
        for _ in range(600):  # the supervisor holds the arms from then on
            pilot.step()
        assert np.abs(world.v).max() < 0.01


def test_a_reflex_ends_a_planned_trial(world: World, trial: Trial) -> None:
    planner = Planner()
    stack = ControlStack(
        world,
        Kinematics(),
        supervisor=trial_supervisor(FRAIL, world.dt, DUAL_PANDA),
    )
    carry = PlannedCarry(stack, planner, TASK, trial, SEED, poses=true_poses(world, TASK))
    assert _steps(carry, 2000) < 2000
    assert "phase 'approach': reflex speed.joint" in (carry.aborted or "")


def test_a_planned_trial_keeps_the_distance_that_the_supervisor_watches(
    world: World,
    trial: Trial,
) -> None:
    planner = Planner()
    supervisor = trial_supervisor(SupervisorConfig(), world.dt, DUAL_PANDA)
    carry = PlannedCarry(
        ControlStack(world, Kinematics(), supervisor=supervisor),
        planner,
        TASK,
        trial,
        SEED,
        poses=true_poses(world, TASK),
    )
    assert carry.solution is not None
    distance = arm_distance(DUAL_PANDA)
    gaps = [distance(q)[1] for segment in carry.solution.segments for q in segment.trajectory.q]
    assert min(gaps) > supervisor.config.self_collision_min_m + 0.004

    # What no plan keeps is said, and nothing moves.
    world.reset(poses=trial.start)
    wide = trial_supervisor(SupervisorConfig(self_collision_min_m=0.14), world.dt, DUAL_PANDA)
    carry = PlannedCarry(
        ControlStack(world, Kinematics(), supervisor=wide),
        planner,
        TASK,
        trial,
        SEED,
        poses=true_poses(world, TASK),
    )
    assert carry.done
    assert "they must keep 145" in (carry.aborted or "")


@pytest.mark.parametrize(
    ("config", "ended_by"),
    [(FRAIL, "reflex"), (SupervisorConfig(), "leader")],
)
def test_a_reflex_ends_a_demonstration(
    world: World,
    config: SupervisorConfig,
    ended_by: str,
) -> None:
    trial = sample_trial(world.scene, SEED, "demonstrations", 0)
    stack = ControlStack(
        world,
        Kinematics(),
        supervisor=trial_supervisor(config, world.dt, DUAL_PANDA),
    )
    session = TeleopSession(stack, TeleopConfig())
    result = session.run(
        carry_task(world.scene),
        trial,
        ScriptedLeader(ScriptedOperator(world.scene).plan(trial, seed=SEED)),
    )
    assert result.ended_by == ended_by
    assert result.reason.startswith("reflex speed.joint" if ended_by == "reflex" else "")
    assert result.outcome.success == (ended_by == "leader")


def test_a_reflex_is_a_fault_of_a_carry_and_the_supervisor_stops_the_arms(world: World) -> None:
    config = Config().model_copy(update={"supervisor": SupervisorConfig(velocity_scale=0.3)})
    bench = Bench("impedance", MethodInputs(config, SEED))
    phases = set[str]()
    trial = sample_trial(config.scene, SEED, "benchmark", 0)
    result, _ = bench.run(trial, on_step=lambda _, method: phases.add(method.phase))
    assert not result.success
    assert "reflex" in result.aborted
    assert "speed.joint" in result.aborted
    assert "stop" in phases
    assert bench.world.gripper.min() > 0.9, "a hand that had nothing to do with it closed"
    assert np.abs(bench.world.v).max() < 0.01


@pytest.mark.parametrize("method", ["moveit", "impedance"])
def test_every_method_is_built_with_a_supervisor(
    method: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[Callable[..., Any]] = []
    guard = Supervisor.guard

    def counted(self: Supervisor, *args: Any) -> Array:
        calls.append(guard)
        return guard(self, *args)

    monkeypatch.setattr(Supervisor, "guard", counted)
    config = Config()
    bench = Bench(method, MethodInputs(config, SEED))
    world = bench.world
    trial = sample_trial(config.scene, SEED, "benchmark", 1)
    world.reset(poses=trial.start)
    run = bench.factory(world, bench.kinematics, trial)
    for _ in range(30):
        run.step()
    assert len(calls) == 30, "a step of control without the supervisor"
    if method == "moveit":
        assert isinstance(run.stack, ControlStack)  # type: ignore[attr-defined]
