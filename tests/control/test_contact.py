"""What arms touch, what blocks them and hands that open are stopped softly, by name, within milliseconds."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from minidual.config.control import CarryConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand
from minidual.control.reflexes import Reflex, ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.motion.ik import posture_at
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.carry_motions import grasp_posture
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.tasks.task import level_part
from tests.support.carries import impedance_carry
from tests.support.carry_trials import sample_trial
from tests.support.panda import DOF, HOME

Change = Callable[["FaultyWorld"], None]


class FaultyWorld(World):
    """A world whose encoders, left hand and joints can fail."""

    def __init__(self, scene: SceneConfig, model: mujoco.MjModel) -> None:
        self.bias = np.zeros(DOF)
        self.left_hand = "held"
        super().__init__(scene, model=copy.copy(model))

    @property
    def q(self) -> np.ndarray:
        return World.q.fget(self) + self.bias  # type: ignore[attr-defined]

    def command(self, tau: np.ndarray, fingers: np.ndarray) -> None:
        left = {"held": fingers[0], "opens": 0.04, "dead": self.fingers[0]}[self.left_hand]
        super().command(tau, np.array([left, fingers[1]]))


@pytest.fixture
def faulty(scene: SceneConfig, compiled_model: mujoco.MjModel) -> FaultyWorld:
    return FaultyWorld(scene, compiled_model)


def _table_force_n(world: World) -> float:
    """Return the normal force between hands and table."""
    table = world.model.body("table").id
    rod = world.truth().body
    force = np.zeros(6)
    total = 0.0
    for i, contact in enumerate(world.data.contact[: world.data.ncon]):
        bodies = set(world.model.geom_bodyid[contact.geom].tolist())
        if table in bodies and rod not in bodies:
            mujoco.mj_contactForce(world.model, world.data, i, force)
            total += force[0]
    return total


@pytest.mark.parametrize("supervised", [False, True])
def test_a_target_under_the_table_does_not_press_for_ever(world: World, supervised: bool) -> None:
    """5 mm under: 76 N for ever without bounds; with them the arm stops after the touch and keeps off."""
    kinematics = Kinematics()
    left, right = kinematics.tcp_poses(HOME)
    q = HOME
    heights = []
    left[:2, 3] += 0.1, 0.0
    for height in np.r_[np.linspace(left[2, 3], 0.02, 20), np.linspace(0.02, -0.005, 16)]:
        left[2, 3] = height
        q = posture_at(DUAL_PANDA, (left, right), q, HOME)
        heights.append(q)
    world.reset(heights[19])
    supervisor = Supervisor(dt_s=world.dt) if supervised else None
    stack = ControlStack(world, kinematics, supervisor=supervisor)
    stack.request("teleop")
    touched_s = np.inf
    error = None
    forces = []
    for k in range(1200):
        target = heights[min(len(heights) - 1, 19 + max(0, k - 300) // 20)]
        if stack.tick_next and error is None:
            stack.propose("teleop", JointCommand(target, np.ones(2), world.time, k + 1))
        try:
            stack.step()
        except ReflexError as stopped:
            error = stopped.reflex
        forces.append(_table_force_n(world))
        if forces[-1] > 0.0:
            touched_s = min(touched_s, world.time)
    assert np.isfinite(touched_s)
    if not supervised:
        assert np.mean(forces[-100:]) > 60.0
    else:
        assert error is not None
        assert error.label in ("contact.joint", "contact.hand")
        assert error.time_s - touched_s < 0.05
        assert np.mean(forces[-100:]) < 25.0


@pytest.mark.parametrize("how", ["opens", "dead", "held"])
def test_a_hand_that_opens_or_dies_is_named_in_10_ms(faulty: FaultyWorld, how: str) -> None:
    world = faulty
    q = grasp_posture(world.scene, world.robot, level_part(world.object_pose()), HOME, above_m=0.0)
    world.reset(q)
    stack = ControlStack(world, Kinematics(), supervisor=Supervisor(dt_s=world.dt))
    stack.request("teleop")
    stopped: Reflex | None = None
    for k in range(1100):
        if stack.tick_next and stopped is None:
            stack.propose("teleop", JointCommand(q, np.zeros(2), world.time, k + 1))
        if k == 1000:
            assert stopped is None, stopped
            assert world.grip.min() > 50.0
            world.left_hand = how
        try:
            stack.step()
        except ReflexError as error:
            stopped = error.reflex
    assert (stopped is not None) == (how != "held")
    if stopped is not None:
        assert stopped.name == "gripper_opened"
        assert stopped.where.startswith("the left hand")
        assert stopped.time_s <= 1.012
        stack.recover()  # nothing is held any more: the fault does not come back
        for _ in range(100):
            stack.step()
        assert stack.reflex is None


def _sticks(joint: int) -> Change:
    def change(world: FaultyWorld) -> None:
        world.model.dof_damping[world.joints.qvel[joint]] = 1e5

    return change


def _jumps(joint: int) -> Change:
    return lambda world: world.bias.__setitem__(joint, 0.05)


def _pushed(axis: int) -> Change:
    def change(world: FaultyWorld) -> None:
        world.data.xfrc_applied[world.model.body("left_panda_link5").id, axis] = 100.0

    return change


def _left_hand(how: str) -> Change:
    return lambda world: setattr(world, "left_hand", how)


FAULTS: dict[str, tuple[Change, tuple[str, ...], float]] = {
    **{
        f"joint {j + 1} sticks": (_sticks(j), ("contact.stuck", "contact.joint"), 0.01)
        for j in (1, 3, 5, 8)
    },
    **{
        f"pushed along {'xyz'[a]}": (_pushed(a), ("contact.joint", "contact.hand"), 0.02)
        for a in range(3)
    },
    **{
        f"encoder {j + 1} jumps": (_jumps(j), ("measurement.implausible",), 0.001)
        for j in (0, 1, 3, 5)
    },
    "a hand opens": (_left_hand("opens"), ("gripper_opened",), 0.01),
    "a hand dies": (_left_hand("dead"), ("gripper_opened",), 0.01),
}


def _carried(
    world: FaultyWorld,
    change: Change | None,
    after_s: float = 0.4,
) -> tuple[ImpedanceCarry, float]:
    trial = sample_trial(world.scene, 5, "arbiter", 0)
    world.reset(poses=trial.start)
    carry = impedance_carry(world, Kinematics(), CarryConfig(), trial, seed=5)
    began_s = np.inf
    onset_s = np.inf
    while not carry.done and world.time < 12.0:
        if carry.phase == "carry":
            began_s = min(began_s, world.time)
        if change is not None and world.time > began_s + after_s:
            change(world)
            onset_s = world.time
            change = None
        carry.step()
    return carry, onset_s


@pytest.mark.slow
@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_in_a_carry_is_named_as_what_it_is(faulty: FaultyWorld, what: str) -> None:
    change, names, within_s = FAULTS[what]
    carry, onset_s = _carried(faulty, change)
    assert carry.fault is not None
    assert carry.stack.reflex is not None
    reflex: Any = carry.stack.reflex
    assert reflex.reflex.label in names, carry.fault.text
    assert carry.fault.at_s - onset_s <= within_s + 1e-9
    assert "reflex" in carry.fault.name


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "after_s"), [(1, 0.1), (3, 0.4), (3, 1.2), (8, 0.1)])
def test_a_joint_that_sticks_at_01_to_03_rad_per_s_is_named_in_4_ms(
    faulty: FaultyWorld,
    joint: int,
    after_s: float,
) -> None:
    """By the joint, before the arms tear at the object."""
    carry, onset_s = _carried(faulty, _sticks(joint), after_s)
    reflex: Any = carry.stack.reflex
    assert reflex.reflex.label == "contact.stuck"
    assert reflex.reflex.where.split(",")[0] == DUAL_PANDA.joint_names[joint]
    assert reflex.reflex.time_s - onset_s <= 0.004 + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "after_s"), [(1, 0.8), (3, 0.1), (3, 0.8)])
def test_a_joint_that_sticks_while_it_hardly_moves_stops_the_path(
    faulty: FaultyWorld,
    joint: int,
    after_s: float,
) -> None:
    """Below 0.08 rad/s its torque is what the law expects; the distance to the path names it."""
    carry, _ = _carried(faulty, _sticks(joint), after_s)
    assert carry.fault is not None
    assert carry.fault.name == "off_path"
    assert np.abs(faulty.v).max() < 0.05


@pytest.mark.slow
def test_a_carry_without_faults_meets_none_of_them(faulty: FaultyWorld) -> None:
    carry, _ = _carried(faulty, None)
    assert carry.fault is None
    assert carry.stack.reflex is None


def _steps(stack: ControlStack, n: int) -> None:
    for _ in range(n):
        stack.step()


def test_hands_that_open_may_press_until_they_are_open(world: World) -> None:
    """Hands let go of an object that stands on the table: it pushes back while the fingers part."""
    world.reset(HOME)
    stack = ControlStack(world, Kinematics(), supervisor=Supervisor(dt_s=world.dt))
    stack.request("teleop")
    pushed = Kinematics().tcp_jacobians(HOME)[0][1] * 25.0
    stopped: ReflexError | None = None
    for k in range(1600):
        if stack.tick_next and stopped is None:
            stack.propose(
                "teleop",
                JointCommand(HOME, np.full(2, float(k >= 800)), world.time, k + 1),
            )
        if k == 810:
            world.data.qfrc_applied[world.joints.qvel] = pushed
        try:
            stack.step()
        except ReflexError as error:
            stopped = error
            break
    assert stopped is not None
    assert world.fingers.min() > 0.038
    assert stopped.reflex.where.endswith("free motion")
