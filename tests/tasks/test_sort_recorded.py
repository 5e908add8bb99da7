"""Cubes as they are recorded: the operator's hands, and colours in other rooms."""

from __future__ import annotations

import functools

import numpy as np

from minidual.config.root import Config, changed
from minidual.demos.leader import LeaderSetup
from minidual.demos.leaders.scripted import plan_demonstration
from minidual.plant.model import build_model
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.operator import Demonstration
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial
from minidual.trials.conditions import condition
from tests.support.panda import V_MAX

SEED = 5
TASK = make_task(Config(task="sort"))


def demonstrated(task: Task, trial: Trial) -> Demonstration:
    setup = LeaderSetup(DUAL_PANDA, task, task.config.teleop, SEED)
    return plan_demonstration(setup, trial)


@functools.cache
def sorted_cubes() -> tuple[Task, Trial, Demonstration]:
    trial = TASK.trial(SEED, "demonstrations", 0)
    return TASK, trial, demonstrated(TASK, trial)


def with_noise(task: Task, trial: Trial, noise_m: float) -> Demonstration:
    """Return the demonstration whose hands err by this along the fingers."""
    noise = {"teleop.operator.along_noise_m": noise_m}
    return demonstrated(make_task(changed(task.config, noise)), trial)


def tips_of(demo: Demonstration) -> np.ndarray:
    """Return T_world_tcp (T, 2, 4, 4)."""
    return np.array([Kinematics().tcp_poses(q) for q in demo.q])


def test_the_hands_of_a_planned_demonstration_close_at_the_cubes_one_by_one() -> None:
    task, trial, demo = sorted_cubes()
    kinematics = Kinematics()
    closing = [(k, hand) for k, hand in np.argwhere(np.diff(demo.gripper, axis=0) < 0.0)]
    assert len(closing) >= len(task.objects) + 1, "each cube is grasped, one of them twice"
    assert {hand for _, hand in closing} == {0, 1}
    first, hand = closing[0]
    at = kinematics.tcp_poses(demo.q[first + 1])[hand][:2, 3]
    nearest = min(np.hypot(x - at[0], y - at[1]) for x, y, _ in trial.start.values())
    assert nearest < 1e-3
    np.testing.assert_array_equal(demo.gripper[-1], 1.0)
    np.testing.assert_array_equal(demo.q[-1], demo.q[-2])


def test_hands_err_along_what_they_grasp_until_they_are_down() -> None:
    """Oracle: the same plan without the error.

    Hands never err across the fingers, where they would touch.
    """
    task, trial, _ = sorted_cubes()
    exact = with_noise(task, trial, 0.0)
    erring = with_noise(task, trial, 0.03)
    exact_tips = tips_of(exact)
    shift = tips_of(erring)[:, :, :3, 3] - exact_tips[:, :, :3, 3]
    off = np.einsum("thij,thi->thj", exact_tips[:, :, :3, :3], shift)
    assert np.abs(off[:, :, 1:]).max() < 1e-6, "only along"
    assert np.all(np.abs(off[:, :, 0]).max(axis=0) > 0.002), "both hands"
    held = np.minimum(exact.gripper[1:], exact.gripper[:-1]) < 1.0
    assert np.abs(off[1:, :, 0][held]).max() < 5e-4, "none is left where a hand closes or holds"
    np.testing.assert_array_equal(exact.gripper, erring.gripper)
    speed = np.abs(np.diff(exact.q, axis=0)) * exact.rate_hz / V_MAX
    assert 0.3 < speed.max() <= 0.61, "the plan itself keeps its share of the speed"


def test_a_cube_keeps_its_colour_in_every_room() -> None:
    model = build_model(TASK.scene, visuals=False)
    for index in range(8):
        trial = TASK.trial(3, "randomised", index)
        with condition("randomised").applied(model, TASK, trial, np.random.default_rng(index)):
            colours = model.geom_rgba.copy()
        for number in (1, 2):
            red = colours[model.geom(f"red_{number}").id]
            blue = colours[model.geom(f"blue_{number}").id]
            assert red[0] > red[2]
            assert blue[2] > blue[0]
