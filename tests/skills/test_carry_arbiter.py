"""A carry only proposes; the arbiter can stop it and give the arms to another source."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from minidual.config.control import CarryConfig, PaceConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, Command, JointCommand
from minidual.control.driving import Driving
from minidual.control.impedance import ObjectImpedance, ObjectState
from minidual.control.kernels import minimum_jerk
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS
from minidual.plant.sensing import Reading, Sensors
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.show.view.overlay import Overlay
from minidual.show.watch import trial_hook
from minidual.skills.carry_motions import grasp_posture, held_motion, joint_move, plan_path
from minidual.skills.carry_phases import CarryPhases
from minidual.skills.faults import Fault
from minidual.skills.impedance_carry import SOURCE, ImpedanceCarry
from minidual.tasks.task import level_pose, tilt_rad
from tests.support.branches import Branches
from tests.support.carries import impedance_carry
from tests.support.carry_trials import sample_trial
from tests.support.panda import HOME, TAU_RATE_MAX

PHASES = ("approach", "descend", "close", "squeeze", "carry", "unload", "open", "retreat")
ONCE_DONE_S = 0.3
"""How long a trial is watched after it is done."""
POINTS = (
    *((phase, 0.15) for phase in PHASES if phase != "carry"),
    ("approach", 0.4),
    ("approach", 0.6),
    ("close", 0.05),
    ("squeeze", 0.2),
    *(("carry", after_s) for after_s in (0.3, 0.6, 1.0, 1.2, 1.4)),
    ("retreat", 0.2),
)
"""Where tests branch off from the one carry: a phase, and for how long it has lasted [s]."""


@dataclass
class Ride:
    """A carry, and what it did in each tick."""

    carry: ImpedanceCarry
    commanded: list[Array] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)
    active: list[tuple[str, ...]] = field(default_factory=list)
    sources: list[str | None] = field(default_factory=list)
    onset_s: float = np.inf
    began_s: dict[str, float] = field(default_factory=dict)

    @property
    def world(self) -> World:
        return self.carry.plant

    @property
    def torque_step_nm(self) -> float:
        return float(np.abs(np.diff(np.array(self.commanded), axis=0)).max())

    def reached(self, point: tuple[str, float]) -> bool:
        """Return whether a phase has lasted for so long."""
        began_s = self.began_s.setdefault(self.carry.phase, self.world.time)
        return self.carry.phase == point[0] and self.world.time >= began_s + point[1] - 1e-9

    def finish(self, each: Callable[[Ride], None] | None = None) -> None:
        """Carry to the end and a little further, with `each` before every tick."""
        done_s = np.inf
        while self.world.time < min(done_s + ONCE_DONE_S, 14.0):
            if each is not None:
                each(self)
            self.step()
            if self.carry.done and not np.isfinite(done_s):
                done_s = self.world.time

    def step(self) -> None:
        carry = self.carry
        carry.step()
        world = carry.plant
        self.commanded.append(world.data.ctrl[world.joints.ctrl].copy())
        self.phases.append(carry.phase)
        self.active.append(carry.stack.manager.active)
        self.sources.append(carry.stack.output.active_source)
        # Whatever the phase, the motors' commands are what the stack let through.
        assert np.array_equal(self.commanded[-1], carry.stack.applied), (
            "a torque that did not come through the stack"
        )


type Carry = Branches[Ride, tuple[str, float]]


def begun(world: World) -> Ride:
    """Return a carry that is to begin."""
    trial = sample_trial(world.scene, 5, "arbiter", 0)
    world.reset(poses=trial.start)
    return Ride(impedance_carry(world, Kinematics(), CarryConfig(), trial, seed=5))


def ride_through(world: World, each: Callable[[Ride], None] | None = None) -> Ride:
    """Carry to the end and a little further."""
    ride = begun(world)
    ride.finish(each)
    return ride


@pytest.fixture(scope="module")
def carry(scene: SceneConfig) -> Iterator[Carry]:
    """The carry of `undisturbed`; each test branches off from it and disturbs its own copy."""
    with Branches(lambda: begun(World(scene)), Ride.step, Ride.reached, POINTS) as made:
        yield made


@pytest.fixture(scope="module")
def undisturbed(scene: SceneConfig) -> Ride:
    return ride_through(World(scene))


def test_a_carry_is_one_source_with_one_request_and_nothing_is_refused(undisturbed: Ride) -> None:
    carry = undisturbed.carry
    assert carry.fault is None
    assert set(undisturbed.sources) == {SOURCE, None}
    assert carry.stack.refusals == []
    assert tuple(dict.fromkeys(undisturbed.phases)) == (*PHASES, "done")
    while carry.stack.source is not None:  # it has nothing to say any more, and loses its turn
        carry.step()
    assert carry.fault is None
    assert carry.done


def test_the_controllers_change_places_within_one_tick_and_without_a_jolt(
    undisturbed: Ride,
) -> None:
    held = {"squeeze", "carry", "unload"}
    for phase, active in zip(undisturbed.phases, undisturbed.active, strict=True):
        assert active == (OBJECT_CONTROLLERS if phase in held else DEFAULT_CONTROLLERS), phase
    assert undisturbed.torque_step_nm <= TAU_RATE_MAX * 1e-3 + 1e-9


def test_a_torque_past_the_stack_is_noticed(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """The negative control of the check in every tick."""
    step = ImpedanceCarry.step

    def and_more(self: ImpedanceCarry) -> None:
        step(self)
        self.plant.command(self.stack.applied + 0.1, np.full(2, 0.04))

    monkeypatch.setattr(ImpedanceCarry, "step", and_more)
    with pytest.raises(AssertionError, match="did not come through the stack"):
        ride_through(world)


def test_in_the_air_the_motors_are_told_the_law_of_the_path_to_the_bit(world: World) -> None:
    """A second law, given the sensed states and the planned path, returns the same torques."""
    q_hold: list[Array] = []
    motion: Any = None
    inputs: list[tuple[Array, Array, ObjectState, float]] = []
    commanded: list[Array] = []
    trial = sample_trial(world.scene, 5, "arbiter", 1)
    world.reset(poses=trial.start)
    carry = impedance_carry(world, Kinematics(), CarryConfig(), trial, seed=5)
    while carry.phase != "unload":
        q = world.q
        v = world.v
        before = carry.phase
        carry.step()
        if before == "close" and carry.phase == "squeeze":
            q_hold.append(q)
        if carry.phase == "carry":
            motion = carry.stack.output.executions[0].command.motion
            state, felt_n = carry.watch.read()
            inputs.append(
                (q, v, ObjectState(state.T_world_object.copy(), state.twist.copy()), felt_n),
            )
            commanded.append(world.data.ctrl[world.joints.ctrl].copy())
    assert carry.fault is None
    law = carry.stack.impedance._law
    assert law is not None
    again = ObjectImpedance(Kinematics(), law.held, law.gains)
    again.engage(q_hold[0])
    assert len(commanded) > 2000
    for k, (q, v, state, felt_n) in enumerate(inputs):
        tau = again.torque(q, v, state, motion.at(k * world.dt), wanted_n=40.0, felt_n=felt_n)
        assert np.array_equal(tau, commanded[k]), f"step {k} of the path"


def test_another_source_that_proposes_moves_nothing(world: World, undisturbed: Ride) -> None:
    sent = 0

    def intrude(ride: Ride) -> None:
        nonlocal sent
        if ride.carry.stack.tick_next:
            sent += 1
            for source in ("teleop", "policy"):
                command = JointCommand(HOME + 0.2, np.ones(2), world.time, sent)
                assert (
                    ride.carry.stack.propose(source, command) is None
                )  # kept for its turn, which never comes

    ride = ride_through(world, intrude)
    assert sent > 300
    assert ride.carry.fault is None
    assert set(ride.sources) == {SOURCE, None}
    assert np.array_equal(ride.commanded, undisturbed.commanded)


def onset(ride: Ride) -> Ride:
    """Note that what happens now is the disturbance."""
    ride.onset_s = ride.world.time
    return ride


def test_a_branch_that_nothing_disturbs_is_the_carry_to_the_bit(
    carry: Carry,
    undisturbed: Ride,
) -> None:
    carry.run(("carry", 1.4), nothing, [tau.tobytes() for tau in undisturbed.commanded])


def nothing(ride: Ride, commanded: list[bytes]) -> None:
    ride.finish()
    assert [tau.tobytes() for tau in ride.commanded] == commanded


def test_what_fails_in_a_branch_fails_here_and_nowhere_else(carry: Carry) -> None:
    with pytest.raises(AssertionError, match="ZeroDivisionError: in the copy"):
        carry.run(("carry", 1.4), fails)
    with pytest.raises(AssertionError, match="the copy ended with 3"):
        carry.run(("carry", 1.4), ends)
    carry.run(("carry", 1.4), is_whole)


def fails(ride: Ride) -> None:
    ride.carry.fault = Fault("lost", "in the copy")
    raise ZeroDivisionError("in the copy")


def ends(ride: Ride) -> None:
    os._exit(3)


def is_whole(ride: Ride) -> None:
    assert ride.carry.fault is None
    assert ride.carry.phase == "carry"


@pytest.mark.parametrize(
    "point",
    [("approach", 0.6), ("close", 0.05), ("squeeze", 0.2), ("carry", 1.4), ("retreat", 0.2)],
)
def test_a_request_of_another_mode_ends_the_carry_by_name_and_drops_nothing(
    carry: Carry,
    point: tuple[str, float],
) -> None:
    carry.run(point, another_mode)


def another_mode(ride: Ride) -> None:
    carry = ride.carry
    world = ride.world
    phase = ride.carry.phase
    sent = 0

    def lead(ride: Ride) -> None:  # the leader stands where the arms are, its hands as theirs
        nonlocal sent
        stack = ride.carry.stack
        if stack.source == "teleop" and stack.tick_next:
            sent += 1
            opening = stack.output.gripper.copy()
            assert (
                stack.propose(
                    "teleop",
                    JointCommand(stack.output.q_target, opening, world.time, sent),
                )
                is None
            )

    onset(ride).carry.stack.request("teleop")
    ride.finish(lead)
    assert carry.fault is not None
    assert (carry.fault.name, carry.fault.detail) == ("interrupted", "'teleop' was asked for")
    assert carry.fault.at_s - ride.onset_s <= 0.001 + 1e-9
    assert ride.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    assert np.abs(world.v).max() < 0.05
    assert carry.stack.output.active_source == "teleop", "the newcomer drives"
    assert carry.stack.manager.active == DEFAULT_CONTROLLERS, "a leader drives joints"
    handed_over = ride.sources.index("teleop")
    assert SOURCE not in ride.sources[handed_over:], "two sources took turns"
    if phase == "carry":
        assert not world.on_table()
        assert world.truth().pinch().min() > 20.0
        assert tilt_rad(world.object_pose(), world.scene.object) < 0.02


def test_a_request_in_the_middle_of_the_lift_may_have_to_be_made_again(carry: Carry) -> None:
    """Elbows swing for longer than a switch waits; the law holds the object during that time."""
    carry.run(("carry", 0.6), asked_in_the_lift)


def asked_in_the_lift(ride: Ride) -> None:
    carry = ride.carry
    stack = ride.carry.stack
    world = ride.world
    stack.request("teleop")
    ride.finish()
    assert carry.fault is not None
    assert carry.fault.name == "interrupted"
    assert ("teleop", "not_still") in {(r.source, r.name) for r in stack.refusals}
    assert (stack.source, stack.state) == (None, ArbiterState.STOPPED)
    assert stack.manager.active == OBJECT_CONTROLLERS
    assert world.truth().internal_force() > 35.0
    stack.request("teleop")
    for _ in range(100):
        carry.step()
    assert stack.source == "teleop"
    assert stack.manager.active == DEFAULT_CONTROLLERS
    assert not world.on_table()
    assert world.truth().pinch().min() > 20.0


def test_a_hold_in_the_air_keeps_the_object_squeezed_for_as_long_as_nobody_asks_for_the_arms(
    carry: Carry,
) -> None:
    """Also the negative control of the two tests of a lost object: there is no fault to find."""
    carry.run(("carry", 1.4), hold)


def hold(ride: Ride) -> None:
    carry = ride.carry
    world = ride.world
    carry.stack.request("hold")
    ride.finish()
    assert carry.fault is not None
    assert carry.fault.detail == "'hold' was asked for"
    assert carry.stack.state is ArbiterState.HOLDING
    assert np.abs(world.v).max() < 0.01
    for _ in range(1001):
        assert carry.stack.manager.active == OBJECT_CONTROLLERS
        assert world.truth().internal_force() > 35.0
        ride.step()
    assert not world.on_table()


@pytest.mark.parametrize("phase", ["approach", "carry"])
def test_a_halt_by_somebody_else_is_named_as_one(carry: Carry, phase: str) -> None:
    carry.run((phase, 0.6), halt)


def halt(ride: Ride) -> None:
    phase = ride.carry.phase
    world = ride.world
    onset(ride).carry.stack.halt("teleop")
    ride.finish()
    assert ride.carry.fault is not None
    assert (ride.carry.fault.name, ride.carry.fault.detail) == (
        "interrupted",
        "the arms were halted",
    )
    assert ride.carry.fault.at_s - ride.onset_s <= 0.001 + 1e-9
    assert ride.active[-1] == ("soft_stop",)
    assert np.abs(world.v).max() < 0.05
    if phase == "carry":
        assert world.truth().pinch().min() > 20.0, "the hands let go"


def hands_stay_apart(world: World) -> None:
    left, right = Kinematics().tcp_poses(world.q)
    apart_m = float(np.linalg.norm(left[:3, 3] - right[:3, 3]))
    assert apart_m > 2.0 * world.scene.object.grasp_offset_m - 0.04


def test_an_object_lost_while_the_arbiter_brakes_halts_the_arms(carry: Carry) -> None:
    """Without the object, braking along the path would push the two hands into each other."""
    carry.run(("carry", 1.4), snatch_while_braking)


def snatch_while_braking(ride: Ride) -> None:
    world = onset(ride).world
    ride.carry.stack.request("teleop")
    world.truth().qpos[:3] = (0.9, 0.6, 0.2)
    ride.finish()
    assert ride.carry.fault is not None
    assert ride.carry.fault.name == "interrupted"
    assert ("soft_stop",) in ride.active
    assert ride.active.index(("soft_stop",)) * world.dt <= ride.onset_s + 0.05
    assert np.abs(world.v).max() < 0.05
    hands_stay_apart(world)


def test_an_object_lost_after_a_hold_halts_the_arms(carry: Carry) -> None:
    """The trial is done, the law goes on squeezing: it is watched for as long as it does."""
    carry.run(("carry", 1.4), snatch_once_done)


def snatch_once_done(ride: Ride) -> None:
    lost_s = np.inf
    world = ride.world

    def snatch(ride: Ride) -> None:
        nonlocal lost_s
        if ride.carry.done and not np.isfinite(lost_s):
            assert ride.carry.stack.manager.active == OBJECT_CONTROLLERS
            assert world.truth().internal_force() > 35.0
            world.truth().qpos[:3] = (0.9, 0.6, 0.2)
            lost_s = world.time

    ride.carry.stack.request("hold")
    ride.finish(snatch)
    for _ in range(500):
        ride.step()
    assert ride.carry.fault is not None
    assert ride.carry.fault.detail == "'hold' was asked for", (
        "what ended the trial stays what ended it"
    )
    assert ("soft_stop",) in ride.active
    assert 0.0 < ride.active.index(("soft_stop",)) * world.dt - lost_s <= 0.05
    assert ride.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    assert np.abs(world.v).max() < 0.05
    hands_stay_apart(world)


def falls_silent(ride: Ride) -> None:
    ride.carry.stack.affirm = lambda source: None  # type: ignore[method-assign]


@pytest.mark.parametrize("point", [("approach", 0.4), ("carry", 1.2)])
def test_a_carry_that_falls_silent_is_braked_and_keeps_what_it_holds(
    carry: Carry,
    point: tuple[str, float],
) -> None:
    carry.run(point, silence)


def silence(ride: Ride) -> None:
    carry = ride.carry
    world = ride.world
    phase = ride.carry.phase
    falls_silent(onset(ride))
    ride.finish()
    assert carry.fault is not None
    assert carry.fault.name == "interrupted"
    assert "stale" in carry.fault.detail
    assert (
        carry.fault.at_s - ride.onset_s <= 0.1 + 2 * 0.02 + 0.002
    )  # what a command lives, heard and missed at its ticks
    assert np.abs(world.v).max() < 0.05
    assert carry.stack.source is None
    assert ride.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    if phase == "carry":
        assert not world.on_table()
        assert world.truth().internal_force() > 35.0


def test_without_the_watchdog_nobody_would_notice(carry: Carry) -> None:
    """The negative control: nothing but the arbiter's watchdog stops a silent carry."""
    carry.run(("carry", 1.2), silence_without_watchdog)


def silence_without_watchdog(ride: Ride) -> None:
    Driving.is_gone = lambda self, now_s: False  # type: ignore[method-assign]
    falls_silent(ride)
    ride.finish()
    assert ride.carry.fault is None


def test_an_object_command_that_comes_late_is_refused_and_ends_the_carry(carry: Carry) -> None:
    carry.run(("squeeze", 0.2), late_command)


def late_command(ride: Ride) -> None:
    propose = CarryPhases._propose
    world = ride.world

    def late(self: CarryPhases, phase: str, command: Command) -> None:
        if phase == "carry":
            command = replace(command, stamp_s=command.stamp_s - 0.2)
        propose(self, phase, command)

    CarryPhases._propose = late  # type: ignore[method-assign]
    ride.finish()
    assert ride.carry.fault is not None
    assert ride.carry.fault.name == "interrupted"
    assert ride.carry.fault.detail.startswith("stale: ObjectCommand is 0.2")
    assert world.object_pose()[2, 3] < world.scene.object.rest_height_m + 0.002
    assert world.truth().pinch().min() > 20.0
    assert ride.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9


@pytest.mark.parametrize("phase", ["approach", "close"])
def test_a_command_that_is_refused_as_it_is_proposed_ends_the_carry_in_that_step(
    world: World,
    phase: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    propose = CarryPhases._propose
    offered_s: list[float] = []

    def too_wide(self: CarryPhases, next_phase: str, command: Command) -> None:
        if next_phase == phase:
            command = replace(command, gripper=np.full(2, 1.5))
            offered_s.append(command.stamp_s)
        propose(self, next_phase, command)

    monkeypatch.setattr(CarryPhases, "_propose", too_wide)
    ride = ride_through(world)
    assert ride.carry.fault is not None
    assert ride.carry.fault.name == "interrupted"
    assert ride.carry.fault.detail.startswith("gripper_out_of_range: ")
    assert ride.carry.fault.at_s == offered_s[0]
    assert len(offered_s) == 1, "it goes on proposing"
    assert len(ride.carry.stack.refusals) == 1
    assert np.abs(world.v).max() < 0.05


@pytest.mark.parametrize("phase", PHASES)
def test_an_emergency_stop_stops_every_phase_and_leaves_the_hands(carry: Carry, phase: str) -> None:
    """The joints brake together: braking each for itself takes the pinch to 0 N in most stops."""
    carry.run((phase, 0.15 if phase != "carry" else 1.4), emergency_stop)


def emergency_stop(ride: Ride) -> None:
    carry = ride.carry
    world = ride.world
    phase = ride.carry.phase
    pinch_n: list[float] = []
    supervisor = carry.stack.supervisor
    assert supervisor is not None
    onset(ride)
    supervisor.estop("pressed")
    ride.finish(lambda _seen: pinch_n.append(float(world.truth().pinch().min())))
    assert carry.fault is not None
    assert carry.fault.name == "reflex"
    assert "emergency_stop" in carry.fault.detail
    assert carry.fault.at_s == pytest.approx(ride.onset_s)
    assert np.abs(world.v).max() < 0.05
    assert ride.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    openings = carry.stack.output.gripper
    closed = phase in ("close", "squeeze", "carry", "unload")
    assert np.array_equal(openings, np.zeros(2) if closed else np.ones(2)), (
        "the hands changed their mind"
    )
    if phase == "carry":
        assert not world.on_table()
        assert min(pinch_n) > 55.0, "the object slipped or was torn between the hands"


# Proposals ----------------------------------------------------------------------------------------


def test_a_joint_move_is_its_quintic_and_its_derivatives_are() -> None:
    rng = np.random.default_rng(3)
    q0 = HOME
    q1 = HOME + rng.uniform(-0.3, 0.3, 14)
    move = joint_move(q0, q1, DUAL_PANDA, PaceConfig(), 1e-3, 0.8124)
    assert move.q.shape == (814, 14)
    assert np.allclose(move.q[[0, -1]], [q0, q1], rtol=0.0, atol=1e-15)
    assert np.array_equal(move.v[[0, -1]], np.zeros((2, 14)))
    for k in (0, 1, 137, 400, 813):
        blend, rate, curvature = minimum_jerk(k / 813)
        assert np.allclose(move.q[k], q0 + blend * (q1 - q0), rtol=1e-13, atol=1e-13)
        assert np.allclose(move.v[k], rate * (q1 - q0) / 0.813, rtol=1e-13, atol=1e-13)
        assert np.allclose(move.a[k], curvature * (q1 - q0) / 0.813**2, rtol=1e-13, atol=1e-13)
    assert np.allclose(np.gradient(move.q[:-1], 1e-3, axis=0)[1:-1], move.v[1:-2], atol=1e-5)


@pytest.mark.parametrize("squeeze_n", [13.0, 40.0, 80.0])
def test_the_squeeze_is_asked_for_no_faster_than_controller_c_gives_it(
    scene: SceneConfig,
    squeeze_n: float,
) -> None:
    T = level_pose(*scene.task.start_xy_m, scene.object.rest_height_m, 0.0)
    q = grasp_posture(scene, DUAL_PANDA, T, HOME)
    rest_m = scene.object.rest_height_m
    path = plan_path(scene, DUAL_PANDA, PaceConfig(), (*scene.task.goal_xy_m, 0.0), T, q, rest_m)
    ends = {}
    for name in ("squeeze", "carry", "unload"):
        motion, squeeze = held_motion(name, path, np.eye(4), squeeze_n)
        times = np.arange(0.0, motion.duration_s + 1e-9, 1e-3)
        values = np.array([squeeze(float(t)) for t in times])
        assert np.abs(np.diff(values)).max() / 1e-3 <= 200.0 * (1.0 + 1e-9)
        ends[name] = (values[0], squeeze(motion.duration_s))
        most = min(1.15 * squeeze_n, 80.0) if name == "squeeze" else squeeze_n  # tried on the table
        assert values.max() == pytest.approx(most, rel=0.005)
        for t in (0.0, motion.duration_s):  # what the arbiter demands of a path
            assert np.abs(motion.at(t).twist).max() < 1e-12
    assert ends == {
        "squeeze": (0.0, squeeze_n),
        "carry": (squeeze_n, squeeze_n),
        "unload": (squeeze_n, 0.0),
    }
    # Each begins where the one before it ends.
    held = [held_motion(name, path, np.eye(4), squeeze_n)[0] for name in ends]
    for before, after in itertools.pairwise(held):
        end = before.at(before.duration_s).T_world_object
        start = after.at(0.0).T_world_object
        assert np.allclose(end, start, rtol=0.0, atol=1e-15)


# View, and lost sensors ---------------------------------------------------------------------------


class Screen:
    """A view that is always due, and keeps what it is to show."""

    name = "screen"
    url = None
    alive = True
    speed_max = 0.0

    def __init__(self) -> None:
        self.shown: list[Overlay] = []

    def open(self, model: Any) -> None: ...

    def offer(self, sliders: Any) -> bool:
        return False

    def due(self) -> bool:
        return True

    def update(self, data: Any, overlay: Overlay) -> None:
        self.shown.append(overlay)

    def close(self) -> None: ...


def test_who_watches_sees_the_source_the_phase_and_why_it_ended(carry: Carry) -> None:
    carry.run(("approach", 0.6), watched)


def watched(ride: Ride) -> None:
    screen: Any = Screen()
    world = ride.world
    bench: Any = SimpleNamespace(world=world, kinematics=Kinematics(), method="impedance")
    watch = trial_hook(screen, bench, "a title")

    def look(ride: Ride) -> None:
        if round(world.time / world.dt) % 100 == 0:
            watch(world, ride.carry)

    while not ride.reached(("carry", 1.4)):
        look(ride)
        ride.step()
    ride.carry.stack.request("hold")
    ride.finish(look)
    states = {(overlay.source, overlay.state) for overlay in screen.shown}
    assert {("impedance", "active, approach"), ("impedance", "active, carry")} <= states
    assert screen.shown[-1].state == "holding, done"
    assert screen.shown[-1].status == ride.carry.aborted
    assert "'hold' was asked for" in screen.shown[-1].status


def pose_is_nan(reading: Reading) -> Reading:
    if reading.pose is None:
        return reading
    return reading._replace(pose=reading.pose._replace(T_world_object=np.full((4, 4), np.nan)))


def force_is_nan(*hands: int) -> Callable[[Reading], Reading]:
    """Let hands (0 left, 1 right) feel no number."""

    def dies(reading: Reading) -> Reading:
        forces = reading.hand_forces.copy()
        forces[list(hands)] = np.nan
        return reading._replace(hand_forces=forces)

    return dies


DEAD = {
    "a camera that gives no number": pose_is_nan,
    "a left force sensor that gives no number": force_is_nan(0),
    "a right force sensor that gives no number": force_is_nan(1),
    "force sensors that give nothing": lambda r: r._replace(hand_forces=np.zeros((2, 3))),
    "fingers that feel nothing": lambda r: r._replace(pinch=np.zeros(2)),
}


def frozen_pose() -> Callable[[Reading], Reading]:
    """Repeat the first pose, on time."""
    poses: list[Any] = []

    def lies(reading: Reading) -> Reading:
        if reading.pose is None:
            return reading
        poses.append(reading.pose)
        return reading._replace(pose=poses[0])

    return lies


def silent_force() -> Callable[[Reading], Reading]:
    """Deliver the first forces again and again."""
    readings: list[Reading] = []

    def lies(reading: Reading) -> Reading:
        readings.append(reading)
        return readings[0]._replace(pose=reading.pose)

    return lies


def frozen_left_force() -> Callable[[Reading], Reading]:
    """Repeat the first force of the left hand."""
    forces: list[Array] = []

    def lies(reading: Reading) -> Reading:
        forces.append(reading.hand_forces[0].copy())
        return reading._replace(hand_forces=np.array([forces[0], reading.hand_forces[1]]))

    return lies


LYING: dict[str, tuple[str, str, Callable[[], Callable[[Reading], Reading]]]] = {
    "a silent camera": ("approach", "no pose for 5", lambda: lambda r: r._replace(pose=None)),
    "force sensors that are silent": ("approach", "no usable force for 4", silent_force),
    "a camera that repeats its picture": ("carry", "the pose stays the same", frozen_pose),
    "a force sensor that repeats its value": (
        "carry",
        "the left hand's force stays the same",
        frozen_left_force,
    ),
}


def from_now(lies: Callable[[Reading], Reading]) -> None:
    """Let the sensors of this process lie."""
    sense = Sensors.sense
    Sensors.sense = lambda self: lies(sense(self))  # type: ignore[method-assign]


@pytest.mark.parametrize("what", LYING)
def test_a_sensor_that_is_silent_or_frozen_is_named(carry: Carry, what: str) -> None:
    """The carry ends as `sensor_lost`, neither as a success nor as a slip."""
    carry.run((LYING[what][0], 0.6), lied_to, what)


def lied_to(ride: Ride, what: str) -> None:
    _, named, make = LYING[what]
    from_now(make())
    onset(ride).finish()
    fault = ride.carry.fault
    assert fault is not None
    assert (fault.name, fault.detail.startswith(named)) == ("sensor_lost", True), fault.text
    assert fault.at_s - ride.onset_s <= 0.05
    assert ride.torque_step_nm <= TAU_RATE_MAX * ride.world.dt + 1e-9
    assert np.abs(ride.world.v).max() < 0.05


def test_a_force_glitch_of_one_step_does_not_end_a_carry(carry: Carry) -> None:
    """1 kN or NaN for 1 ms is neither a slip nor a reflex."""
    carry.run(("carry", 0.3), glitches)


def glitches(ride: Ride) -> None:
    values = iter((1e3, -1e3, np.nan))
    due_s = ride.world.time

    def glitch(reading: Reading) -> Reading:
        nonlocal due_s
        if reading.stamp_s < due_s:
            return reading
        due_s += 0.15
        value = next(values, None)
        return (
            reading
            if value is None
            else reading._replace(hand_forces=np.full((2, 3), value), pinch=np.full(2, value))
        )

    from_now(glitch)
    ride.finish()
    assert next(values, None) is None, "a glitch was not tried"
    assert ride.carry.fault is None, ride.carry.aborted


def test_a_program_error_in_a_sensor_stops_the_arms_and_is_then_raised(carry: Carry) -> None:
    """The arms stop by a commanded torque in every tick; then the error is raised."""
    carry.run(("approach", 0.6), program_error)


def program_error(ride: Ride) -> None:
    def breaks(reading: Reading) -> Reading:
        raise ZeroDivisionError("no driver")

    from_now(breaks)
    with pytest.raises(ZeroDivisionError, match="no driver"):
        ride.finish()
    carry = ride.carry
    world = ride.world
    assert carry.fault is not None
    assert "ZeroDivisionError: no driver" in carry.fault.detail
    assert ride.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    assert np.abs(world.v).max() < 0.05


@pytest.mark.parametrize("what", DEAD)
def test_a_sensor_that_dies_in_the_air_stops_the_carry_by_name(carry: Carry, what: str) -> None:
    carry.run(("carry", 1.0), sensor_dies, what)


def sensor_dies(ride: Ride, what: str) -> None:
    from_now(DEAD[what])
    onset(ride).finish()
    assert ride.carry.fault is not None
    assert ride.carry.fault.name in ("slip", "object_lost", "sensor_lost")
    assert ride.carry.fault.at_s - ride.onset_s <= 0.05
    assert np.isfinite(ride.commanded).all()
    assert ride.torque_step_nm <= TAU_RATE_MAX * ride.world.dt + 1e-9
    assert np.abs(ride.world.v).max() < 0.05
