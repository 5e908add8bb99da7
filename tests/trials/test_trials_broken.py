"""A trial that breaks has failed, with a name and true numbers; later trials are as without it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from minidual.control.impedance import SingularPostureError
from minidual.plant.world import World
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import pose, rot_z
from minidual.tasks.judge import Judge, begin
from minidual.tasks.task import Task, Trial
from minidual.trials import site
from minidual.trials.conditions import CLEAN, condition
from minidual.trials.methods import METHODS
from minidual.trials.runner import Bench, Judged
from minidual.trials.site import SimulatedSite
from tests.support.carry_trials import carry_task, same_row, sample_trial
from tests.support.placing import put_at


class Stands:
    """A method that holds the arms where they are and ends, or breaks, after so many steps."""

    phase = "standing"

    def __init__(
        self,
        world: World,
        kinematics: Kinematics,
        *,
        steps: int,
        breaks: str = "",
        aborted: str | None = None,
    ) -> None:
        self.world = world
        self._gravity = kinematics.gravity(world.q)
        self._left = steps
        self._breaks = breaks
        self.aborted = aborted

    @property
    def done(self) -> bool:
        return self._left <= 0

    def step(self) -> None:
        tau = self._gravity.copy()
        self._left -= 1
        if self._left <= 0 and self._breaks == "singular":
            raise SingularPostureError("a hand has lost a direction of motion")
        if self._left <= 0 and self._breaks == "diverged":
            tau[9] = math.nan
        if self._left <= 0 and self._breaks == "exploded":
            self.world.data.qvel[self.world.joints.qvel[2]] = 1e12
        self.world.command(tau, np.full(2, 0.04))
        self.world.step()


@pytest.fixture
def trial(world: World) -> Trial:
    return sample_trial(world.scene, 5, "broken", 0)


def _run(
    world: World,
    trial: Trial,
    method: str = "impedance",
    *,
    task: Task | None = None,
    **how: Any,
) -> Judged:
    bench = Bench.__new__(Bench)  # on the world of the other tests: none is compiled
    bench.method = method
    bench.seed = 5
    bench.spec = METHODS[method]
    bench.task = carry_task(world.scene) if task is None else task
    bench.condition = condition(CLEAN)
    bench.site = SimulatedSite(world)
    bench.plant = bench.world = world
    bench.kinematics = Kinematics()
    bench.hands = Hands(bench.kinematics)
    bench.factory = lambda w, k, _trial: Stands(w, k, **how)
    return bench.run(trial)


@pytest.mark.parametrize("breaks", ["diverged", "exploded", "singular"])
def test_a_trial_that_breaks_is_judged_as_it_stood(
    world: World,
    trial: Trial,
    breaks: str,
    quiet_mujoco: None,
) -> None:
    whole, whole_log = _run(world, trial, steps=999)
    metrics, log = _run(world, trial, steps=1000, breaks=breaks)
    assert not metrics.success
    assert metrics.failure == ("singular" if breaks == "singular" else "diverged")
    assert metrics.failed_at_s == pytest.approx(0.999)
    assert metrics.failed_in == "standing"
    assert ("direction of motion" if breaks == "singular" else "not finite") in metrics.reason
    # All that was measured is that of the same trial without its last step.
    assert np.array_equal(log.q, whole_log.q)
    assert np.array_equal(log.tau, whole_log.tau)
    for name in ("torque_ratio_max", "jerk_rms", "tilt_max_rad", "path_length_m"):
        assert getattr(metrics, name) == getattr(whole, name)
        assert math.isfinite(getattr(metrics, name))
    assert metrics.goal_error_m == pytest.approx(
        math.dist(trial.start["rod"][:2], trial.goal["rod"][:2]),
        abs=2e-3,
    )
    assert math.isnan(metrics.duration_s)


@pytest.mark.parametrize("breaks", ["diverged", "exploded", "singular"])
def test_a_trial_that_breaks_at_its_first_step_has_a_log_too(
    world: World,
    trial: Trial,
    breaks: str,
    quiet_mujoco: None,
) -> None:
    result, log = _run(world, trial, steps=1, breaks=breaks)
    assert result.failed_at_s == 0.0
    assert result.failure in ("diverged", "singular")
    assert len(log.t) == 1
    assert np.isfinite(log.q).all()


def test_the_next_trial_is_the_same_as_without_a_broken_one(
    world: World,
    trial: Trial,
    quiet_mujoco: None,
) -> None:
    before, before_log = _run(world, trial, steps=400)
    _run(world, trial, steps=300, breaks="exploded")
    after, after_log = _run(world, trial, steps=400)
    assert same_row(after) == same_row(before)
    assert np.array_equal(after_log.tau, before_log.tau)
    assert before.failure != "diverged"  # the control: a trial that only ends has another name


@pytest.mark.parametrize(
    ("breaks", "failure"),
    [("", ""), ("diverged", "diverged"), ("exploded", "diverged"), ("singular", "singular")],
)
def test_a_trial_that_breaks_after_its_finish_is_no_success(
    world: World,
    trial: Trial,
    breaks: str,
    failure: str,
    monkeypatch: pytest.MonkeyPatch,
    quiet_mujoco: None,
) -> None:
    """The task demands nothing here, so it is finished after a tenth of a second."""
    nothing = dataclasses.replace(carry_task(world.scene), success=lambda task, trial: ())
    result, _ = _run(world, trial, "moveit", task=nothing, steps=300, breaks=breaks)
    assert result.success == (failure == "")
    assert result.failure == failure


def test_a_method_that_stops_itself_before_the_finish_fails(world: World, trial: Trial) -> None:
    result, _ = _run(world, trial, "moveit", steps=50, aborted="the grasp was lost")
    assert not result.success
    assert result.aborted == "the grasp was lost"
    assert "(stopped itself: the grasp was lost)" in result.text


@pytest.mark.parametrize(
    ("method", "faults"),
    [("impedance", {"held", "squeezed"}), ("moveit", {"held"})],
)
def test_trials_of_object_impedance_must_squeeze_and_others_need_not(
    world: World,
    trial: Trial,
    method: str,
    faults: set[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judges: list[Judge] = []
    monkeypatch.setattr(site, "begin", lambda *given: judges.append(begin(*given)) or judges[-1])
    _run(world, trial, method, steps=2)
    assert judges[0].failures == {}
    x, y, yaw = trial.start["rod"]
    put_at(world, "rod", pose(rot_z(yaw), (x, y, 0.1)))  # in the air, and no hand squeezes it
    judges[0].disturbed()
    judges[0].observe(world)
    assert set(judges[0].failures) == faults
