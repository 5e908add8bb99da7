"""The controllers behind the arbiter: what each does with a command, and that every joint has exactly one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand, ObjectCommand
from minidual.control.impedance import HeldObject, SingularPostureError
from minidual.control.joint_control import JointLoop
from minidual.control.measurement import Measurement
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, inverse
from minidual.robot.trajectory import Trajectory
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.arm_scripts import pinch_rod
from tests.support.control_plant import ArmsPlant, TrueObject
from tests.support.panda import A_MAX, HOME, V_MAX
from tests.support.stacks import OPEN, PAIR, hand_over, move, stack_on, trajectory


@pytest.fixture
def plant(scene: SceneConfig) -> ArmsPlant:
    return ArmsPlant(scene)


# A ----------------------------------------------------------------------------------------------------------


def test_streamed_targets_give_the_torques_of_the_joint_loop_to_the_bit(
    scene: SceneConfig,
    world: World,
) -> None:
    def target(k: int) -> Array:
        return HOME + 0.3 * np.sin(0.02 * k) * np.linspace(-1.0, 1.0, 14)

    world.reset()
    stack = stack_on(world)
    stack.request("teleop")
    states = []
    for k in range(60):
        if k >= 1:
            stack.propose("teleop", JointCommand(target(k), OPEN, world.time, k))
        stack.arbitrate()
        for _ in range(20):
            stack.advance()
        states.append(world.q)
    other = World(scene, model=world.model)
    loop = JointLoop(other, Kinematics())
    for k, q in enumerate(states):
        for _ in range(20):
            loop.step(target(k) if k >= 1 else HOME, OPEN)
        np.testing.assert_array_equal(other.q, q)


def test_a_trajectory_is_forwarded_as_it_is(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    motion = move(plant.q, HOME + 0.3, 0.5)
    assert stack.propose("moveit", trajectory(stack, motion)) is None
    references = []
    while stack.executing:
        stack.step()
        references.append(stack.manager.reference)
    np.testing.assert_allclose(references, motion.q, atol=1e-12)
    assert np.abs(plant.q - HOME - 0.3).max() < 2e-3
    stack.step()
    assert stack.state == ArbiterState.WAITING, (
        "the source keeps its turn when a trajectory has ended"
    )
    for _ in range(1100):
        stack.step()
    assert stack.state == ArbiterState.STOPPED
    np.testing.assert_allclose(plant.q, HOME + 0.3, atol=1e-4)


def test_what_is_left_between_reference_and_start_fades_without_a_jump(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME + 0.09, HOME + 0.3, 1.0)))
    last = stack.manager.reference
    largest = 0.0
    for _ in range(1000):
        stack.step()
        largest = max(largest, float(np.abs(stack.manager.reference - last).max()))
        last = stack.manager.reference
    assert largest < 1e-3, "0.09 rad at once would be ninety times that"
    np.testing.assert_allclose(last, HOME + 0.3, atol=1e-6)


def test_a_switch_brakes_a_trajectory_on_its_path(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    goal = HOME + np.linspace(-0.65, 0.75, 14)
    motion = move(HOME, goal, 0.9)
    stack.propose("moveit", trajectory(stack, motion))
    for _ in range(450):
        stack.step()
    assert np.abs(plant.v).max() > 1.2
    asked = plant.time
    stack.request("teleop")
    references = [stack.manager.reference]
    while stack.source != "teleop":
        stack.step()
        references.append(stack.manager.reference)
        assert stack.state in (ArbiterState.SETTLING, ArbiterState.WAITING)
    assert plant.time - asked < 0.5
    path = np.array(references[:-1])
    # On a straight path in joint space every joint has covered the same share of its way.
    share = (path - HOME) / (goal - HOME)
    assert np.ptp(share, axis=1).max() < 1e-6, "it left the path"
    v = np.diff(path, axis=0) / plant.dt
    assert (np.abs(v) <= V_MAX).all()
    assert np.abs(np.diff(v, axis=0) / plant.dt / A_MAX).max() < 1.3
    assert np.abs(v[-1]).max() < 0.05, "not at rest"
    assert 0.5 < share[-1, 0] < 0.95


def test_a_source_that_falls_silent_in_motion_is_held_and_brought_to_rest(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "teleop")
    for k in range(1, 31):  # 0.6 s at 1 rad/s
        stack.propose("teleop", JointCommand(HOME + 0.02 * k, OPEN, plant.time, k))
        for _ in range(20):
            stack.step()
    assert np.abs(stack.manager.reference - HOME).min() > 0.4
    assert plant.v.min() > 0.8
    states = []
    references = [stack.manager.reference]
    targets = set()
    for _ in range(1300):
        stack.step()
        states.append(stack.state)
        references.append(stack.manager.reference)
        if stack.state == ArbiterState.STALE:
            targets.add(stack.output.q_target.tobytes())
    assert list(dict.fromkeys(states)) == [
        ArbiterState.ACTIVE,
        ArbiterState.STALE,
        ArbiterState.STOPPED,
    ]
    assert states.index(ArbiterState.STALE) <= 121, "0.1 s, and a tick"
    assert len(targets) == 1, "the held target moved"
    path = np.array(references)
    v = np.diff(path, axis=0) / plant.dt
    assert (np.abs(np.diff(v, axis=0) / plant.dt) <= 0.81 * A_MAX).all(), (
        "the stop is not a controlled one"
    )
    assert path.max(axis=0).max() - path[-1].max() < 1e-3, "it overshot"
    np.testing.assert_allclose(plant.q, HOME + 0.6, atol=1e-3)


@pytest.mark.parametrize("dies_at", [0, 1, 137, 300])
def test_a_trajectory_stops_on_its_path_when_its_source_dies(
    plant: ArmsPlant,
    dies_at: int,
) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    goal = HOME + np.linspace(-0.65, 0.75, 14)
    stack.propose("moveit", trajectory(stack, move(HOME, goal, 0.9)))
    for _ in range(dies_at):
        stack.step()
    died = plant.time
    stack.dead = True
    states = []
    references = [stack.manager.reference]
    while stack.executing:
        stack.step()
        states.append(stack.state)
        references.append(stack.manager.reference)
    stale = states.index(ArbiterState.STALE)
    assert stale <= 141, "0.1 s, and the ticks that hear the last sign and notice the silence"
    assert set(states[stale:]) == {ArbiterState.STALE}
    assert stack.output.active_source is None
    assert plant.time - died < 0.65
    path = np.array(references)
    share = (path - HOME) / (goal - HOME)
    assert np.ptp(share, axis=1).max() < 1e-6, "it left the path"
    assert share[-1].max() < 0.9, "it ran to its end"
    v = np.diff(path, axis=0) / plant.dt
    assert np.abs(np.diff(v, axis=0) / plant.dt / A_MAX).max() < 1.3
    for _ in range(50):
        stack.step()
    assert np.abs(plant.v).max() < 0.05
    # Alive again, the source may go on from there, but the old trajectory does not resume.
    assert stack.state == ArbiterState.STALE
    stack.dead = False
    rest = stack.manager.reference
    for _ in range(60):
        stack.step()
    np.testing.assert_array_equal(stack.manager.reference, rest)
    stack.propose("moveit", trajectory(stack, move(rest, HOME, 0.9), 2))
    while stack.executing:
        stack.step()
    assert stack.refusals == []
    np.testing.assert_allclose(plant.q, HOME, atol=3e-3)


def test_a_source_that_stays_dead_loses_its_turn(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.3, 0.9)))
    stack.step()
    stack.dead = True
    for _ in range(1150):
        stack.step()
    assert stack.state == ArbiterState.STOPPED
    assert stack.source is None


def test_another_source_cannot_keep_a_dead_one_alive(plant: ArmsPlant) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.3, 0.9)))
    stack.dead = True
    for k in range(150):
        stack.affirm("teleop")
        stack.propose("policy", JointCommand(HOME, OPEN, plant.time, k))
        stack.step()
    assert stack.state == ArbiterState.STALE
    with pytest.raises(UsageError, match="no command source 'planner'"):
        stack.affirm("planner")


# B ----------------------------------------------------------------------------------------------------------


def test_two_single_arm_controllers_do_what_the_double_one_does(scene: SceneConfig) -> None:
    runs = []
    for controllers in (("both_arms",), PAIR):
        plant = ArmsPlant(scene)
        stack = stack_on(plant)
        hand_over(stack, "moveit", controllers)
        assert stack.manager.active == controllers
        stack.propose("moveit", trajectory(stack, move(plant.q, HOME - 0.2, 0.4)))
        while stack.executing:
            stack.step()
        runs.append(np.array(plant.torques))
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-9)
    assert np.ptp(runs[0], axis=0).max() > 1.0


@pytest.mark.parametrize("controllers", [("both_arms",), PAIR])
def test_seven_joints_move_and_the_other_arm_is_held(
    plant: ArmsPlant,
    controllers: tuple[str, ...],
) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit", controllers)
    whole = move(
        HOME,
        HOME + 0.3,
        0.5,
        "right_arm",
    )  # a planner gives 14 columns; the left ones are not used
    stack.propose("moveit", trajectory(stack, whole, group="right_arm"))
    stack.step()
    while stack.executing:
        stack.step()
    np.testing.assert_allclose(plant.q[:7], HOME[:7], atol=1e-3)
    np.testing.assert_allclose(plant.q[7:], HOME[7:] + 0.3, atol=3e-3)


# C ----------------------------------------------------------------------------------------------------------


def _grasped(world: World, kinematics: Kinematics) -> HeldObject:
    rod = world.scene.object
    grasps: Any = tuple(inverse(world.object_pose()) @ T for T in kinematics.tcp_poses(world.q))
    across = rod.mass_kg * rod.length_m**2 / 12.0
    inertia = np.diag([across, 1e-5, across])
    return HeldObject(rod.mass_kg, inertia, grasps, np.array([0.0, 1.0, 0.0]))


def test_object_impedance_lifts_the_rod_and_hands_it_back(
    scene: SceneConfig,
    world: World,
    kinematics: Kinematics,
) -> None:
    pinch_rod(JointLoop(world, kinematics), scene, kinematics)
    stack = stack_on(world, sensor=TrueObject(world))
    stack.grippers.close(
        world.data.ctrl[world.finger_joints.ctrl[::2]],
    )  # the stack must not open the hands
    hand_over(stack, "moveit")
    q = world.q
    still = Trajectory(
        np.array([0.0, 0.9]),
        np.array([q, q]),
        np.zeros((2, 14)),
        np.zeros((2, 14)),
        "both_arms",
    )
    stack.propose("moveit", trajectory(stack, still, gripper=np.zeros(2)))
    while stack.executing:
        stack.step()
    assert world.truth().pinch().min() > 30.0

    stack.impedance.configure(_grasped(world, kinematics))
    stack.switch_controllers(("object_impedance",))
    x, y, z = world.object_pose()[:3, 3]
    path = ObjectPath(
        Waypoint((x, y, z), 0.0, 0.0),
        [
            Waypoint((x, y, z), 0.0, 0.5),
            Waypoint((x, y, z + 0.06), 0.0, 0.8),
            Waypoint((x, y - 0.1, z + 0.06), 0.0, 1.0),
        ],
    )
    # The rod may have rolled in the fingers: the path keeps the roll it has.
    roll = world.object_pose()[:3, :3]

    class Rolled:
        duration_s = path.duration_s

        def at(self, t_s: float) -> Any:
            state = path.at(t_s)
            T = state.T_world_object.copy()
            T[:3, :3] = roll
            return type(state)(T, state.twist, state.acceleration)

    command = ObjectCommand(
        Rolled(),
        lambda t: 40.0 * min(1.0, t / 0.4),
        np.zeros(2),
        world.time,
        2,
    )
    assert stack.propose("moveit", command) is None
    forces = []
    jumps = []
    last = stack.manager.tau
    while stack.executing:
        stack.step()
        jumps.append(float(np.abs(stack.manager.tau - last).max()))
        last = stack.manager.tau
        forces.append(world.truth().internal_force())
    assert stack.refusals == []
    assert jumps[0] < 1.0, "the torques jumped when the impedance took over"
    assert min(forces[600:]) > 20.0
    np.testing.assert_allclose(world.object_pose()[:3, 3], (x, y - 0.1, z + 0.06), atol=5e-3)

    # Joint commands are not for this controller; a path that starts elsewhere is refused.
    stack.propose("moveit", JointCommand(world.q, np.zeros(2), world.time, 3))
    far = ObjectPath(Waypoint((x, y, z), 0.0, 0.0), [Waypoint((x, y, z + 0.1), 0.0, 1.0)])
    stack.step()
    stack.propose("moveit", ObjectCommand(far, lambda t: 40.0, np.zeros(2), world.time, 4))
    for _ in range(25):
        stack.step()
    assert {r.name for r in stack.refusals} == {"wrong_controller", "far_start"}

    # Another mode gets the arms with the rod in them: the joint controller takes over without a jolt.
    last = stack.manager.tau
    largest = 0.0
    stack.request("teleop")
    for _ in range(300):
        stack.step()
        largest = max(largest, float(np.abs(stack.manager.tau - last).max()))
        last = stack.manager.tau
    assert stack.manager.active == ("both_arms",)
    assert largest < 1.0
    assert world.object_pose()[2, 3] > z + 0.05, "the rod was dropped"


def test_a_supervisor_of_another_period_is_refused(plant: ArmsPlant) -> None:
    """At 500 Hz an emergency stop took 0.39 s instead of 0.14 s, and the arm went back."""
    with pytest.raises(
        UsageError,
        match=r"the supervisor's period is 0.002 s, the plant's 0.001 s",
    ):
        stack_on(plant, supervisor=Supervisor(dt_s=0.002))


# A controller that fails ------------------------------------------------------------------------------------


def _break(stack: ControlStack) -> None:
    def update(q: Array, v: Array) -> Array:
        raise SingularPostureError("a hand has lost a direction of motion")

    stack.manager["left_arm"].update = update  # type: ignore[method-assign]


@pytest.mark.parametrize("bounded", [True, False])
def test_the_arms_of_a_controller_that_fails_stop(world: World, bounded: bool) -> None:
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt, bounded=bounded))
    hand_over(stack, "moveit", PAIR)
    _break(stack)
    now_s = world.time
    with pytest.raises(ReflexError, match=r"controller_failed.*lost a direction") as caught:
        stack.step()
    assert isinstance(caught.value.__cause__, SingularPostureError)
    assert stack.reflex is caught.value
    assert world.time > now_s, "the tick of the reflex moves the plant too"
    for _ in range(300):  # once; the controller goes on failing
        stack.step()
    assert np.abs(world.v).max() < 0.01
    assert stack.source is None
    with pytest.raises(UsageError, match="may not drive: the supervisor stopped the arms"):
        stack.request("teleop")
    stack.switch_controllers(("both_arms",))
    stack.recover()
    hand_over(stack, "moveit")


# The supervisor ---------------------------------------------------------------------------------------------


class _Replacing(Supervisor):
    """Lets through torques of its own."""

    def guard(
        self,
        measurement: Measurement,
        tau: Array,
        applied: Array,
        a_ref: Array | None = None,
    ) -> Array:
        super().guard(measurement, tau, applied, a_ref)
        return np.full(14, 0.25)


def test_the_supervisor_has_the_last_word_in_every_tick(plant: ArmsPlant) -> None:
    stack = stack_on(plant, supervisor=_Replacing(dt_s=plant.dt))
    stack.step()
    stack.step()
    np.testing.assert_array_equal(plant.torques, np.full((2, 14), 0.25))


def _run_out(stack: ControlStack) -> None:
    while stack.executing:
        stack.step()


def test_the_supervisor_hears_the_arbiter_and_sees_the_commanded_acceleration(
    scene: SceneConfig,
    world: World,
) -> None:
    world.reset()
    stack = stack_on(
        world,
        supervisor=Supervisor(SupervisorConfig(acceleration_scale=0.5), dt_s=world.dt),
    )
    hand_over(stack, "moveit")
    legal = move(HOME, HOME + 0.3, 0.9)
    stack.propose("moveit", trajectory(stack, legal))
    while stack.executing:
        stack.step()
    # Within the joints' limits, and beyond the half of their accelerations that this supervisor allows.
    hard = move(stack.manager.reference, stack.manager.reference - 0.08, 0.25)
    assert np.abs(hard.v).max() < V_MAX.min()
    assert (np.abs(hard.a).max(axis=0) > 0.5 * A_MAX).any()
    assert stack.propose("moveit", trajectory(stack, hard, 2)) is None
    with pytest.raises(ReflexError, match=r"reference\.acceleration"):
        _run_out(stack)

    world.reset()
    stack.reset()
    stack.arbitrate()
    for _ in range(100):  # the arbiter has died: nobody calls it any more
        stack.advance()
    with pytest.raises(ReflexError, match="stale_command"):
        stack.advance()


def test_a_rate_that_does_not_divide_the_control_rate_is_refused(plant: ArmsPlant) -> None:
    with pytest.raises(UsageError, match="rate_hz 30"):
        stack_on(plant, rate_hz=30.0)
