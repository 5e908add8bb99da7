"""A finger comes down on an object that lies further off than it was seen: the hand backs off and grasps it there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.control.reflexes import Reflex, ReflexError
from minidual.control.stack import ControlStack
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES
from minidual.skills import planned_carry
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.states import moved
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import begin

TASK = make_task(Config(task="handover"))
TRIAL = TASK.trial(1, "plan", 0)
NAME = TASK.carried
LEAST_N = 20.0


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner()


@pytest.fixture(scope="module")
def world() -> World:
    return World(TASK.scene)


@pytest.fixture(scope="module")
def axis(world: World, planner: Planner) -> np.ndarray:
    """Return the direction (3,) along which the fingers of the giving hand close."""
    carry = seen(world, planner)
    segment = next(s for s in carry.solution.segments if s.phase == "descend")
    return carry.stack.kinematics.tcp_poses(segment.trajectory.q[-1])[giver(carry)][:3, 1]


def seen(world: World, planner: Planner, off_m: np.ndarray | None = None) -> PlannedCarry:
    """Return a trial whose bottle was seen `off_m` (3,) from its place."""
    begin(world, TASK, TRIAL)
    stack = ControlStack(
        world,
        Kinematics(),
        supervisor=trial_supervisor(TASK.config.supervisor, world.dt, world.robot),
    )
    pose = world.object_pose() if off_m is None else moved(world.object_pose(), off_m)
    return PlannedCarry(stack, planner, TASK, TRIAL, 0, poses={NAME: pose})


def giver(carry: PlannedCarry) -> int:
    return SIDES.index(carry.solution.pipeline.stages[0].name.split()[-1])


def drive(carry: PlannedCarry, until: str) -> list[str]:
    """Run until a phase or the end; return the phases."""
    phases = [carry.phase]
    while not carry.done and carry.phase != until and carry.plant.time < TASK.time_limit_s:
        carry.step()
        if carry.phase != phases[-1]:
            phases.append(carry.phase)
    return phases


@pytest.mark.parametrize("dry_nm", [0.0, 0.5])
@pytest.mark.parametrize("off_m", [-0.018, 0.018])
def test_the_hand_backs_off_and_grasps_the_bottle_where_it_is(
    world: World,
    planner: Planner,
    axis: np.ndarray,
    off_m: float,
    dry_nm: float,
) -> None:
    carry = seen(world, planner, -off_m * axis)
    arm = giver(carry)
    before = carry._poses[NAME]
    world.model.dof_frictionloss[world.joints.qvel] = dry_nm
    try:
        phases = drive(carry, "lift")
    finally:
        world.model.dof_frictionloss[world.joints.qvel] = 0.0
    assert phases == [
        "approach",
        "descend",
        "done",
        "retreat",
        "approach",
        "descend",
        "close",
        "lift",
    ], carry.aborted
    assert carry.aborted is None
    assert carry.solution.pipeline.stages[0].name == "back off"
    assert world.truth().pinch()[arm] > LEAST_N
    # Three quarters of what it was off by, or more, is found: towards the finger that touched.
    left_m = np.linalg.norm((carry._poses[NAME] - world.object_pose())[:2, 3])
    assert np.linalg.norm((before - world.object_pose())[:2, 3]) > 0.015
    assert left_m < 0.005


def test_dry_joints_are_hardly_a_touch(world: World, planner: Planner) -> None:
    """On the way down friction is nearly constant: the supervisor feels it, and takes little of it for a touch."""
    carry = seen(world, planner)
    felt = []
    supervisor = carry.stack.supervisor
    world.model.dof_frictionloss[world.joints.qvel] = 0.5
    try:
        drive(carry, "descend")
        for _ in range(600):
            carry.step()
            felt.append(
                (np.abs(supervisor.observer.external).max(), np.abs(supervisor.touch).max())
            )
    finally:
        world.model.dof_frictionloss[world.joints.qvel] = 0.0
    assert carry.phase == "descend"
    torque, touch = np.array(felt[400:]).T  # no joint turns round any more
    assert torque.min() > 0.4
    assert touch.max() < 0.3


def test_a_bottle_within_reach_of_the_fingers_needs_no_second_grasp(
    world: World,
    planner: Planner,
    axis: np.ndarray,
) -> None:
    carry = seen(world, planner, -0.008 * axis)
    assert drive(carry, "lift") == ["approach", "descend", "close", "lift"]


def test_after_three_tries_the_reflex_ends_the_trial(
    world: World,
    planner: Planner,
    axis: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(planned_carry, "_ASIDE_M", 0.0)
    carry = seen(world, planner, -0.018 * axis)
    assert drive(carry, "close").count("descend") == 4
    assert carry.done
    assert carry.aborted.startswith("phase 'descend': ")
    assert "reflex contact." in carry.aborted
    assert np.abs(world.v).max() < 0.05


def test_a_plan_that_is_not_found_leaves_the_arms_stopped(
    world: World,
    planner: Planner,
    axis: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(planned_carry, "_ASIDE_M", 1.5)  # to beyond the table
    carry = seen(world, planner, -0.018 * axis)
    assert drive(carry, "close") == ["approach", "descend", "done"]
    assert carry.done
    assert "reflex contact." in carry.aborted
    assert carry.stack.reflex is not None
    assert carry.stack.source is None


@pytest.mark.parametrize("after", [0, 3])
def test_a_halt_in_the_stop_of_a_touch_is_not_overridden(
    world: World,
    planner: Planner,
    axis: np.ndarray,
    after: int,
) -> None:
    """Arms that recovered would drive on, by 0.50 rad."""
    carry = seen(world, planner, -0.018 * axis)
    assert drive(carry, "done") == ["approach", "descend", "done"]
    for _ in range(after):
        carry.step()
    carry.stack.halt("teleop")
    stopped = world.q
    for _ in range(600):
        carry.step()
    assert carry.done
    assert "reflex contact." in carry.aborted
    assert carry.stack.source is None
    assert np.abs(world.q - stopped).max() < 0.1


def test_arms_that_are_not_measured_grasp_nothing_again(
    world: World,
    planner: Planner,
    axis: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The touch of NaN has no force; `step` must not raise."""
    carry = seen(world, planner, -0.018 * axis)
    assert drive(carry, "done") == ["approach", "descend", "done"]
    monkeypatch.setattr(
        np.linalg,
        "lstsq",
        lambda a, b: _raise(np.linalg.LinAlgError("SVD did not converge")),
    )
    for _ in range(600):
        carry.step()
    assert carry.done
    assert "reflex contact." in carry.aborted
    assert carry.stack.reflex is not None


def _raise(error: Exception) -> None:
    raise error


def wrenched(carry: PlannedCarry, force_n: float, aside_m: float) -> np.ndarray:
    """Return the joint torques of a force up on the giving hand, so far along its fingers."""
    arm = giver(carry)
    kinematics = carry.stack.kinematics
    q = carry.plant.q
    x, _, z = kinematics.tcp_poses(q)[arm][:3, :3].T
    wrench = np.r_[-force_n * z, -force_n * aside_m * x]
    return kinematics.tcp_jacobians(q)[arm].T @ wrench


@pytest.mark.parametrize(
    ("force_n", "aside_m", "held", "goes_on"),
    [
        (40.0, 0.04, False, True),
        (40.0, -0.04, False, True),
        (40.0, 0.005, False, False),  # on the palm, or on both fingers
        (5.0, 0.04, False, False),  # too weak to tell
        (-40.0, 0.04, False, False),  # pulled down
        (40.0, 0.04, True, False),  # the other hand holds it
    ],
)
def test_only_a_press_on_one_finger_says_where_the_object_is(
    world: World,
    planner: Planner,
    force_n: float,
    aside_m: float,
    held: bool,
    goes_on: bool,
) -> None:
    carry = seen(world, planner)
    solution = carry.solution
    tries = carry._tries_left
    before = carry._poses[NAME]
    segment = next(s for s in solution.segments if s.phase == "descend")
    k = next(k for k, part in enumerate(solution.parts) if segment in part)
    if held:
        states = list(solution.states)
        states[k] = dataclasses.replace(states[k], held_by={SIDES[1 - giver(carry)]: np.eye(4)})
        solution = dataclasses.replace(solution, states=tuple(states))
    along = carry.stack.kinematics.tcp_poses(world.q)[giver(carry)][:3, 1]
    carry._grasp_again(solution, segment, wrenched(carry, force_n, aside_m))
    assert (carry._tries_left < tries) == goes_on
    assert (
        carry.solution is not solution and carry.solution.pipeline.stages[0].name == "back off"
    ) == goes_on
    assert (carry._poses[NAME] - before)[:3, 3] == pytest.approx(
        goes_on * np.sign(aside_m) * 0.02 * along,
    )


@pytest.mark.parametrize(
    ("name", "phase", "goes_on"),
    [
        ("contact.joint", "descend", True),
        ("contact.hand", "descend", True),
        ("contact.joint", "approach", False),
        ("tracking_error", "descend", False),
        ("emergency_stop", "descend", False),
    ],
)
def test_only_a_touch_on_the_way_down_is_tried_again(
    world: World,
    planner: Planner,
    name: str,
    phase: str,
    goes_on: bool,
) -> None:
    carry = seen(world, planner)
    while carry.phase != phase:
        carry._left.pop(0)
    family, _, detail = name.partition(".")
    carry._stopped(ReflexError(Reflex(family, detail, 0.0, "a joint"), np.zeros(14)))
    assert (carry._touch is not None) == goes_on
    assert carry.aborted.startswith(f"phase '{phase}': reflex {name}")
