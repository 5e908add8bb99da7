"""One validated measurement a tick: what is read, what is refused at a start, what is a fault, and what is not."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.control import CarryConfig, SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand
from minidual.control.measurement import Measurement, Reader
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.cycle import thing_of
from minidual.skills.supervised import trial_supervisor
from tests.support.carries import impedance_carry
from tests.support.carry_trials import sample_trial
from tests.support.panda import DOF, HOME
from tests.support.stacks import (
    OPEN,
    Arms,
    breaks,
    hand_over,
    move,
    nan_of,
    run,
    stack_on,
    supervised,
    trajectory,
)

NOTHING = np.zeros(DOF)
UNKNOWN = np.full(DOF, np.nan)
WAY = np.tile([0.8, 0.4, 0.0, 0.5, 0.0, 0.4, 0.5], 2)


class Spoken:
    """A plant at rest that says what the test sets; a value that is a function is called."""

    robot = DUAL_PANDA
    dt = 1e-3

    def __init__(self) -> None:
        self.says: dict[str, Any] = {
            "health": "",
            "time": 0.0,
            "stamp_s": 0.0,
            "q": HOME,
            "v": NOTHING,
            "fingers": np.full(2, 0.04),
            "grip": np.zeros(2),
        }

    def __getattr__(self, name: str) -> Any:
        value = self.__dict__["says"][name]
        return value() if callable(value) else value


class Read:
    """A reader and its plant."""

    def __init__(self) -> None:
        self.plant = Spoken()
        self.reader = Reader(self.plant, SupervisorConfig())  # type: ignore[arg-type]
        self.first = self.reader.reset()

    def at(self, time_s: float, **says: Any) -> Measurement:
        """Return the measurement at a time; its stamp is the time unless told."""
        self.plant.says.update({"time": time_s, "stamp_s": time_s} | says)
        return self.reader.read(NOTHING, UNKNOWN)

    def fault_at(self, time_s: float, **says: Any) -> str:
        fault = self.at(time_s, **says).fault
        return "" if fault is None else f"{fault.reflex}.{fault.detail}"


@pytest.fixture
def read() -> Read:
    return Read()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("health", "drive 3 is off", "the plant cannot be driven: drive 3 is off"),
        ("q", UNKNOWN, "the arms are not measured"),
        ("v", np.where(np.arange(DOF) == 3, np.inf, 0.0), "the arms are not measured"),
        ("fingers", np.array([0.01, np.nan]), "the hands are not measured"),
        ("grip", np.array([np.nan, 0.0]), "the hands are not measured"),
        ("stamp_s", -1.0, "1.000 s old"),
        ("stamp_s", np.nan, "nan s old"),
        ("time", breaks, "the plant is not measured: ZeroDivisionError: the bus is gone"),
    ],
)
def test_control_does_not_begin_without_a_whole_measurement(
    read: Read,
    name: str,
    value: Any,
    message: str,
) -> None:
    read.plant.says[name] = value
    with pytest.raises(UsageError, match=message):
        read.reader.reset()


def test_a_measurement_says_what_was_read_and_when(read: Read) -> None:
    q = HOME + 1e-4
    measurement = read.at(0.001, stamp_s=0.0005, q=q, v=0.1 + NOTHING)
    assert measurement.fault is None
    assert measurement.period_s == 0.001
    assert measurement.fresh_s == 0.0005
    assert measurement.age_s == 0.0005
    np.testing.assert_array_equal(measurement.q, q)
    np.testing.assert_array_equal(measurement.v, 0.1)
    assert measurement.blind_arms == ()


def test_a_plant_may_protect_or_reuse_the_arrays_that_it_returns(read: Read) -> None:
    strided = np.zeros((DOF, 2))
    strided[:, 0] = HOME
    q = strided[:, 0]
    first = read.at(0.001, q=q)
    q += 1e-4
    q.flags.writeable = False
    second = read.at(0.002, q=q)
    np.testing.assert_array_equal(first.q, HOME)
    np.testing.assert_array_equal(second.q, HOME + 1e-4)
    assert second.fault is None


def test_a_reading_that_was_overtaken_is_not_used(read: Read) -> None:
    read.at(0.001)
    measurement = read.at(0.002, stamp_s=0.0005, q=HOME + 1.0)
    assert measurement.fresh_s == 0.0
    assert measurement.stamp_s == 0.001
    np.testing.assert_array_equal(measurement.q, HOME)


def test_readings_may_be_as_old_as_the_bound(read: Read) -> None:
    assert read.fault_at(0.020, stamp_s=0.0) == ""
    measurement = read.at(0.021, stamp_s=0.0)
    assert measurement.fault is not None
    assert measurement.fault[:2] == ("measurement", "stale")
    assert measurement.blind.all()
    assert measurement.blind_arms == (0, 1)


@pytest.mark.parametrize("stamp_s", [100.0, np.inf, -1.0])
def test_a_stamp_far_from_the_clock_is_stale(read: Read, stamp_s: float) -> None:
    assert read.fault_at(0.03, stamp_s=stamp_s) == "measurement.stale"


@pytest.mark.parametrize("time_s", [0.001, -5.0, np.nan])
def test_a_clock_that_does_not_grow_is_a_fault(read: Read, time_s: float) -> None:
    read.at(0.001)
    measurement = read.at(time_s, stamp_s=0.002)
    assert measurement.fault is not None
    assert measurement.fault[:2] == ("measurement", "clock")
    assert np.isfinite(measurement.time_s)
    assert measurement.period_s == 0.001


def test_a_clock_that_began_anew_is_one_fault(read: Read) -> None:
    read.at(3600.0)
    read.reader.reset()
    assert read.fault_at(0.0) == "measurement.clock"
    assert read.fault_at(0.001) == ""


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("health", breaks),
        ("time", breaks),
        ("time", lambda: None),
        ("stamp_s", lambda: "x"),
        ("q", breaks),
        ("q", HOME[:13]),
        ("q", np.array(["x"] * DOF)),
        ("v", NOTHING[:7]),
        ("fingers", lambda: None),
        ("grip", np.zeros(1)),
    ],
)
def test_a_reading_that_fails_is_a_failure_of_the_plant_and_the_measurement_is_finite(
    read: Read,
    name: str,
    value: Any,
) -> None:
    measurement = read.at(0.001, **{name: value})
    assert measurement.fault is not None
    assert measurement.fault.reflex == "plant_failed"
    assert np.isfinite(np.concatenate(measurement[4:8])).all()
    if name not in ("q", "v"):
        np.testing.assert_array_equal(measurement.q, HOME)


def test_an_ill_plant_is_named(read: Read) -> None:
    fault = read.at(0.001, health="drive 3 is off").fault
    assert fault is not None
    assert (fault.reflex, fault.text) == ("plant_failed", "drive 3 is off")


@pytest.mark.parametrize("name", ["fingers", "grip"])
def test_the_last_reading_of_a_hand_stands_in_for_20_ms(read: Read, name: str) -> None:
    read.at(0.001, fingers=np.full(2, 0.01), grip=np.full(2, 60.0))
    gone = {name: np.array([np.nan, 0.02])}
    for tick in range(2, 22):
        measurement = read.at(1e-3 * tick, **gone)
        assert measurement.fault is None
        assert measurement.fingers_m[0] == 0.01
        assert measurement.grip_n[0] == 60.0
    assert read.fault_at(0.023, **gone) == "measurement.stale"


def test_ticks_that_come_late_are_counted(read: Read) -> None:
    for time_s in (0.001, 0.002, 0.005, 0.0064, 0.009):
        read.at(time_s)
    assert read.reader.overruns_n == 2


# On arms ----------------------------------------------------------------------------------------------------


class Net:
    """Delivers what a plant measured `late(tick)` ticks ago, with its true stamp."""

    def __init__(self, plant: Arms, late: Callable[[int], int] = lambda tick: 0) -> None:
        self.plant = plant
        self.late = late
        self._tick = 0
        self._sent = deque([(plant.q.copy(), plant.v.copy(), plant.time)], maxlen=60)

    def step(self) -> None:
        self.plant.step()
        self._tick += 1
        self._sent.append((self.plant.q.copy(), self.plant.v.copy(), self.plant.time))

    def _arrived(self) -> tuple[Array, Array, float]:
        return self._sent[-1 - min(self.late(self._tick), len(self._sent) - 1)]

    @property
    def q(self) -> Array:
        return self._arrived()[0].copy()

    @property
    def v(self) -> Array:
        return self._arrived()[1].copy()

    @property
    def stamp_s(self) -> float:
        return self._arrived()[2]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["plant"], name)


def reordered(share: float, most: int) -> Callable[[int], int]:
    """Return a lateness by tick: up to `most` ticks for a share of the packets."""
    rng = np.random.default_rng(0)
    late = np.where(rng.random(8000) < share, rng.integers(1, most + 1, 8000), 0).tolist()
    return late.__getitem__


def arrives_every(period: int) -> Callable[[int], int]:
    return lambda tick: tick % period


@pytest.mark.parametrize(
    "late",
    [
        reordered(0.5, 8),
        lambda tick: 5 if tick % 20 == 0 else 0,
        arrives_every(2),
        arrives_every(12),
        arrives_every(19),
    ],
    ids=["half of them", "each 20th", "every 2 ms", "every 12 ms", "every 19 ms"],
)
def test_sound_motion_goes_on_when_packets_are_late_or_rare(
    scene: SceneConfig,
    late: Callable[[int], int],
) -> None:
    net = Net(Arms(scene), late)
    stack = supervised(net)  # type: ignore[arg-type]
    hand_over(stack, "moveit")
    goal = HOME + 0.5 * WAY
    assert stack.propose("moveit", trajectory(stack, move(HOME, goal, 0.9))) is None
    assert run(stack, 1300) == []
    assert np.abs(net.plant.q - goal).max() < 0.02


@pytest.mark.parametrize(("share", "most"), [(0.05, 15), (0.5, 8)])
def test_a_stop_rests_when_packets_overtake_one_another(
    scene: SceneConfig,
    share: float,
    most: int,
) -> None:
    net = Net(Arms(scene))
    stack = supervised(net)  # type: ignore[arg-type]
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + WAY, 0.9))) is None
    run(stack, 430)
    assert np.abs(net.plant.v).max() > 1.5
    stack.supervisor.estop()
    net.late = reordered(share, most)
    assert run(stack, 1500) == ["emergency_stop"]
    assert np.abs(net.plant.v).max() < 0.05
    assert not stack.measurement.blind.any()


@pytest.mark.parametrize("late", [14, 19])
def test_late_measurements_are_no_contact_after_a_start_and_a_recovery(
    scene: SceneConfig,
    late: int,
) -> None:
    """Torques before the start are not known to the observer."""
    net = Net(Arms(scene), lambda tick: late)
    stack = supervised(net)  # type: ignore[arg-type]
    assert run(stack, 200) == []
    stack.supervisor.estop()
    assert run(stack, 400) == ["emergency_stop"]
    stack.recover()
    assert run(stack, 200) == []


def test_measurements_that_grow_late_are_named_by_their_age(scene: SceneConfig) -> None:
    net = Net(Arms(scene))
    stack = supervised(net)  # type: ignore[arg-type]
    assert run(stack, 100) == []
    net.late = lambda tick: min(50, tick // 10)
    assert run(stack, 1000) == ["measurement.stale"]
    assert np.abs(net.plant.v).max() < 0.01


def test_a_sensor_that_freezes_among_overtaken_packets_is_named(scene: SceneConfig) -> None:
    net = Net(Arms(scene), reordered(0.2, 8))
    stack = supervised(net)  # type: ignore[arg-type]
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + WAY, 0.9))) is None
    assert run(stack, 300) == []
    frozen = net.plant.q[3]
    arrived = net._arrived

    def stuck() -> tuple[Array, Array, float]:
        q, v, stamp_s = arrived()
        q = q.copy()
        q[3] = frozen
        return q, v, stamp_s

    net._arrived = stuck  # type: ignore[method-assign]
    assert run(stack, 100) == ["measurement.implausible"]


@pytest.mark.parametrize("name", ["q", "v"])
def test_no_torque_is_nan_without_bounds(scene: SceneConfig, name: str) -> None:
    plant = Arms(scene)
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    plant.lies[name] = nan_of(3)
    assert run(stack, 300) == ["measurement.not_finite"]
    assert np.isfinite(plant.torques).all()
    assert np.abs(plant.true_q - HOME).max() < 0.005


@pytest.mark.parametrize("begins", ["recover", "reset"])
@pytest.mark.parametrize("name", ["q", "v"])
def test_a_first_tick_that_is_not_measured_begins_where_the_arms_are(
    scene: SceneConfig,
    begins: str,
    name: str,
) -> None:
    plant = Arms(scene)
    plant.q = HOME + 0.3
    stack = supervised(plant)
    assert run(stack, 50) == []
    if begins == "recover":
        stack.supervisor.estop()
        assert run(stack, 300) == ["emergency_stop"]
        stack.recover()
    else:
        stack.reset()
    run(stack, 1)  # of the reset's own measurement
    rest = plant.true_q.copy()
    plant.lies[name] = nan_of(*range(DOF))
    assert run(stack, 1) == ["measurement.not_finite"]
    plant.lies.clear()
    run(stack, 500)
    assert np.abs(plant.true_v).max() < 0.05
    assert np.abs(plant.true_q - rest).max() < 0.005


class CoarseWorld(World):
    """Its encoders have `bits` a turn, and `step_rad_s` of velocity."""

    bits = 20
    step_rad_s = 1e-3

    @property
    def q(self) -> Array:
        quantum = 2.0 * np.pi / 2**self.bits
        return np.round(super().q / quantum) * quantum

    @property
    def v(self) -> Array:
        return np.round(super().v / self.step_rad_s) * self.step_rad_s


@pytest.mark.parametrize(("bits", "step_rad_s"), [(20, 1e-3), (16, 2e-3)])
def test_coarse_encoders_carry(
    scene: SceneConfig,
    kinematics: Kinematics,
    bits: int,
    step_rad_s: float,
) -> None:
    """A joint that stands reads the same for long."""
    world = CoarseWorld(scene)
    world.bits = bits
    world.step_rad_s = step_rad_s
    trial = sample_trial(scene, 0, "driver", 0)
    world.reset(poses=trial.start)
    shapes = (thing_of(scene.object).shape,)
    supervisor = trial_supervisor(SupervisorConfig(), world.dt, world.robot, shapes=shapes)
    carry = impedance_carry(world, kinematics, CarryConfig(), trial, supervisor=supervisor)
    while not carry.done and world.time < 15.0:
        carry.step()
    assert carry.aborted is None
    assert carry.done


def test_a_leader_that_moves_one_joint_goes_on_with_coarse_encoders(scene: SceneConfig) -> None:
    world = CoarseWorld(scene)
    world.bits = 17
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "teleop")
    q = world.q
    for tick in range(2000):
        if stack.tick_next:
            target = q.copy()
            target[3] += 0.3 * (1.0 - np.cos(2.0 * np.pi * tick / 3000))
            assert stack.propose("teleop", JointCommand(target, OPEN, world.time, tick + 1)) is None
        assert run(stack, 1) == []
    assert stack.source == "teleop"
