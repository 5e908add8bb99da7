"""Each fault of a carry is detected within 50 ms, has its name, and stops the arms softly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from minidual.config.control import CarryConfig, CarryFaultConfig
from minidual.config.scene import SceneConfig
from minidual.control.impedance import ObjectImpedance, SingularPostureError
from minidual.motion.ik import PoseUnreachableError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills import carry_phases
from minidual.skills.faults import CLOSED, OPENING, Fault, FaultMonitor
from minidual.skills.impedance_carry import ImpedanceCarry
from tests.support.branches import Branches
from tests.support.carries import impedance_carry
from tests.support.carry_trials import rod_trial, sample_trial
from tests.support.panda import A_MAX, DOF, TAU_MAX, TAU_RATE_MAX

DETECTED_S = 0.05


POINTS = (
    ("approach", 0.0),
    ("approach", 0.5),
    ("descend", 0.1),
    ("descend", 0.3),
    ("close", 0.0),
    ("squeeze", 0.1),
    *(("carry", after_s) for after_s in (0.2, 0.4, 0.8, 1.0, 1.4)),
    ("open", 0.0),
    ("retreat", 0.1),
    ("done", 0.0),
)
"""Where tests branch off from the one carry: a phase, and for how long it has lasted [s]."""


Finger = Callable[[float, list[float]], float]


@dataclass
class Run:
    """A carry, and what was seen of it."""

    carry: ImpedanceCarry
    onset_s: float = np.inf
    torque_step_nm: float = 0.0
    saturated_s: float = 0.0
    speeds: list[np.ndarray] = field(default_factory=list)
    began_s: dict[str, float] = field(default_factory=dict)
    finger: Finger | None = None
    """Where the left hand's fingers go instead of where they are told to."""

    def __post_init__(self) -> None:
        self.world = self.carry.plant
        command = self.world.command
        told = list[float]()

        def commands(tau: np.ndarray, fingers: np.ndarray) -> None:
            told.append(float(fingers[0]))
            command(
                tau,
                fingers
                if self.finger is None
                else np.array([self.finger(told[-1], told), fingers[1]]),
            )

        self.world.command = commands  # type: ignore[method-assign]
        self._told = Kinematics().gravity(self.world.q)
        self._run_length = np.zeros(DOF)

    @property
    def latency_s(self) -> float:
        assert self.carry.fault is not None
        return self.carry.fault.at_s - self.onset_s

    def reached(self, point: tuple[str, float]) -> bool:
        """Return whether a phase has lasted for so long."""
        began_s = self.began_s.setdefault(self.carry.phase, self.world.time)
        return self.carry.phase == point[0] and self.world.time >= began_s + point[1]

    def step(self) -> None:
        world = self.world
        carry = self.carry
        carry.step()
        commanded = world.data.ctrl[world.joints.ctrl].copy()
        self.torque_step_nm = max(self.torque_step_nm, float(np.abs(commanded - self._told).max()))
        self._told = commanded
        self._run_length = np.where(
            np.abs(commanded) >= 0.999 * TAU_MAX,
            self._run_length + world.dt,
            0.0,
        )
        self.saturated_s = max(self.saturated_s, float(self._run_length.max()))
        if carry.fault is not None:
            self.speeds.append(world.v.copy())

    def finish(self, onset: Callable[[World], bool] | None = None) -> None:
        """Go on to the end; `onset` tells from the truth when the fault begins, by default now."""
        while not self.carry.done and self.world.time < 14.0:
            if not np.isfinite(self.onset_s) and (onset is None or onset(self.world)):
                self.onset_s = self.world.time
            self.step()

    def deceleration(self, first: int) -> np.ndarray:
        """Return each joint's largest mean deceleration over 20 ms after the fault, by its limit."""
        v = np.array(self.speeds[:first])
        slower = np.abs(v[:-20]) - np.abs(v[20:])
        return slower.max(axis=0) / 0.02 / A_MAX


type Carry = Branches[Run, tuple[str, float]]


@pytest.fixture(scope="module")
def carry(scene: SceneConfig) -> Iterator[Carry]:
    """One carry; each test branches off and disturbs its own copy, also of the compiled model."""

    def start() -> Run:
        world = World(scene)
        trial = sample_trial(scene, 5, "faults", 3)
        world.reset(poses=trial.start)
        return Run(impedance_carry(world, Kinematics(), CarryConfig(), trial, seed=5))

    with Branches(start, Run.step, Run.reached, POINTS) as made:
        yield made


def rod_moves(velocity: tuple[float, float, float]) -> Callable[[World], None]:
    def disturb(world: World) -> None:
        world.truth().qvel[:3] = velocity

    return disturb


def rod_vanishes(world: World) -> None:
    world.truth().qpos[:3] = (0.9, 0.6, 0.2)


def grows_smooth(friction: float) -> Callable[[World], None]:
    def disturb(world: World) -> None:
        world.model.geom_friction[:, 0] = friction

    return disturb


def motors_off(arm: str) -> Callable[[World], None]:
    def disturb(world: World) -> None:
        for i in range(world.model.nu):
            if world.model.actuator(i).name.startswith(arm) and world.model.actuator(
                i,
            ).name.endswith("_motor"):
                world.model.actuator_gainprm[i, 0] = 0.0

    return disturb


def a_hand_has_closed_past(world: World) -> bool:
    return float((0.08 * world.gripper).min()) < 2.0 * world.scene.object.radius_m


SCENARIOS = {
    "kicked before the grasp": ("knocked_away", "descend", 0.1, rod_moves((0.6, 0.0, 0.0)), None),
    "kicked after the release": ("knocked_away", "retreat", 0.1, rod_moves((0.6, 0.0, 0.0)), None),
    "gone when the hands close": (
        "missed_grasp",
        "close",
        0.0,
        rod_vanishes,
        a_hand_has_closed_past,
    ),
    "torn from the hands": ("object_lost", "carry", 1.4, rod_vanishes, None),
    "pads grow smooth": ("slip", "carry", 1.4, grows_smooth(0.1), None),
    "pads grow a little too smooth": ("slip", "carry", 0.4, grows_smooth(0.23), None),
    "left motors off in the air": ("lost_arm", "carry", 1.4, motors_off("left"), None),
    "right motors off on the way": ("lost_arm", "approach", 0.5, motors_off("right"), None),
}


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_fault_is_told_in_time_by_name_and_stopped_softly(carry: Carry, scenario: str) -> None:
    carry.run(SCENARIOS[scenario][1:3], is_told_in_time, scenario)


def is_told_in_time(run: Run, scenario: str) -> None:
    name, _, _, disturb, onset = SCENARIOS[scenario]
    world = run.world
    disturb(world)
    run.finish(onset)
    fault = run.carry.fault
    assert fault is not None
    assert fault.name == name
    assert 0.0 <= run.latency_s <= DETECTED_S
    assert run.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    if name == "lost_arm":  # the dead arm falls, and sooner or later it strikes the other one
        alive = slice(7, DOF) if fault.detail.startswith("left") else slice(0, 7)
        # the sensor's word halts the arms, the torque that is missing is a reflex with a firmer stop
        assert run.deceleration(300)[alive].max() < 0.9 + 1e-9
        return
    assert run.saturated_s <= 0.02
    assert run.deceleration(2000).max() < (1.5 if name == "slip" else 0.7)
    assert np.abs(run.speeds[-1]).max() < 0.05


def test_an_object_that_is_shifted_in_the_approach_is_followed(carry: Carry) -> None:
    carry.run(("approach", 0.5), is_followed)


def is_followed(run: Run) -> None:
    world = run.world
    before_m = world.object_pose()[0, 3]
    rod_moves((0.6, 0.0, 0.0))(world)
    while run.carry.phase == "approach":
        run.step()
    assert world.object_pose()[0, 3] - before_m > 0.02, "not shifted"
    run.finish()
    assert run.carry.fault is None
    x_m, y_m, _ = sample_trial(world.scene, 5, "faults", 3).goal["rod"]
    np.testing.assert_allclose(world.object_pose()[:2, 3], (x_m, y_m), atol=0.002)


def test_an_object_that_is_shifted_a_third_time_is_a_fault(carry: Carry) -> None:
    carry.run(("approach", 0.5), is_followed_twice)


def is_followed_twice(run: Run) -> None:
    """The rod is kicked to and fro, each time the hands set out to follow it."""
    for kick in (0.6, -0.6, 0.6):
        assert run.carry.fault is None
        rod_moves((kick, 0.0, 0.0))(run.world)
        while not run.carry.watch.shifted and run.carry.fault is None:
            run.step()
        while run.carry.watch.shifted and run.carry.fault is None:
            run.step()
    run.finish()
    assert run.carry.fault is not None
    assert (run.carry.fault.name, run.carry.phase) == ("knocked_away", "done")
    assert run.world.time < 8.0, "it never grasped"


def test_an_object_that_is_taken_off_the_table_is_not_followed(carry: Carry) -> None:
    carry.run(("approach", 0.5), is_not_followed)


def is_not_followed(run: Run) -> None:
    run.world.truth().qpos[2] += 0.1
    run.finish()
    assert run.carry.fault is not None
    assert run.carry.fault.name == "knocked_away"


GRIPPERS: dict[str, tuple[str, str, float, Finger, float]] = {
    "does not close": ("gripper_stuck", "close", 0.0, lambda target, told: 0.04, 0.1),
    "answers 0.1 s late": ("gripper_stuck", "close", 0.0, lambda target, told: told[-100], 0.1),
    "blocked at 60 mm": (
        "gripper_stuck",
        "close",
        0.0,
        lambda target, told: max(target, 0.03),
        0.3,
    ),
    "jitters": (
        "gripper_jitter",
        "carry",
        0.2,
        lambda target, told: target + 0.004 * (len(told) // 25 % 2),
        0.3,
    ),
    "does not open": ("gripper_stuck", "open", 0.0, lambda target, told: -0.004, 0.2),
}


@pytest.mark.parametrize("what", GRIPPERS)
def test_a_gripper_that_does_not_do_what_it_is_told_is_named(carry: Carry, what: str) -> None:
    """The fault is the gripper's, neither `missed_grasp` nor `slip`, and is found within 0.3 s."""
    carry.run(GRIPPERS[what][1:3], gripper_is_named, what)


def gripper_is_named(run: Run, what: str) -> None:
    name, _, _, run.finger, latency_s = GRIPPERS[what]
    run.finish()
    assert run.carry.fault is not None
    assert run.carry.fault.name == name
    assert run.carry.fault.detail.startswith("the left hand")
    assert 0.0 < run.latency_s <= latency_s
    assert np.abs(run.speeds[-1]).max() < 0.05


def motors_off_after(arm: str, at_s: float) -> Callable[[World], bool]:
    """Return an onset: the motors of an arm die at a time."""

    def later(world: World) -> bool:
        if world.time < at_s:
            return False
        motors_off(arm)(world)
        return True

    return later


def test_motors_that_die_in_a_stop_do_not_rename_its_fault(carry: Carry) -> None:
    carry.run(("descend", 0.1), motors_die_after_a_kick)


def motors_die_after_a_kick(run: Run) -> None:
    world = run.world
    rod_moves((0.6, 0.0, 0.0))(world)
    run.finish(motors_off_after("left", world.time + 0.2))
    assert run.carry.fault is not None
    assert run.carry.fault.name == "knocked_away"


def test_an_undisturbed_trial_raises_nothing(carry: Carry) -> None:
    """The negative control of all of them; the stage runs two hundred more."""
    carry.run(("done", 0.0), nothing_is_raised)


def nothing_is_raised(run: Run) -> None:
    assert run.carry.fault is None
    assert run.carry.done
    assert run.torque_step_nm <= TAU_RATE_MAX * run.world.dt + 1e-9


def test_noise_alone_never_moves_a_resting_object() -> None:
    """10,000 samples of the standard noise, checked as in a trial, raise no false alarm."""
    rng = np.random.default_rng(0)
    monitor = FaultMonitor(CarryFaultConfig(), dt_s=0.001, width_m=0.0177, pinch_n=60.0)
    for _ in range(10_000):
        away = float(np.linalg.norm(0.0005 * rng.standard_normal(3)))
        angle = float(np.linalg.norm(0.005236 * rng.standard_normal(3)))
        assert monitor.resting((away, angle)) is None
        assert monitor.held_pose((away, angle)) is None


@pytest.fixture
def monitor() -> FaultMonitor:
    made = FaultMonitor(CarryFaultConfig(), dt_s=0.001, width_m=0.02, pinch_n=60.0)
    for _ in range(100):  # a tenth of a second of an object that lies still
        assert made.resting((0.0008, 0.008)) is None
    return made


def _until_told(look: Callable[[], Fault | None], *, calls: int = 50) -> tuple[str, int]:
    for k in range(1, calls + 1):
        fault = look()
        if fault is not None:
            return fault.name, k
    raise AssertionError("nothing was told")


def _hand_tells(
    monitor: FaultMonitor,
    told: str,
    gap_m: Callable[[float], float],
) -> Callable[[], Fault | None]:
    """Return a look every 4 ms at hands of which the right one's gap is `gap_m(t)`."""
    fine = (60.0, 60.0)
    ticks = iter(range(1000))

    def look() -> Fault | None:
        t = 0.004 * next(ticks)
        return monitor.grippers(t, told, (0.02, gap_m(t)), fine, 0.024 if told != "open" else 0.076)

    return look


def test_a_hand_that_moves_as_it_is_told_has_no_fault(monitor: FaultMonitor) -> None:
    gaps: dict[str, Callable[[float], float]] = {
        "close": lambda t: max(0.02, 0.08 - 0.16 * t),
        "open": lambda t: 0.08 if t > 0.4 else max(0.02, 0.02 + 0.16 * (t - 0.1)),
        "": lambda t: 0.02 + 0.0001 * float(np.sin(100.0 * t)),
    }
    for told, gap_m in gaps.items():
        for k in range(200):
            gap = gap_m(0.004 * k)
            fault = monitor.grippers(
                10.0 + 0.004 * k,
                told,
                (gap, gap),
                (60.0, 60.0),
                0.076 if told == "open" else 0.024,
            )
            assert fault is None
    nothing = (np.nan, np.nan)
    assert monitor.grippers(20.0, "close", nothing, nothing, 0.024) is None
    blind = monitor.grippers(20.2, "close", nothing, nothing, 0.024)
    assert blind is not None
    assert blind.name == "gripper_stuck"


@pytest.mark.parametrize("phase", range(5))
def test_a_pinch_that_swings_by_little_more_than_a_step_jitters_at_any_phase(
    monitor: FaultMonitor,
    phase: int,
) -> None:
    """The swing of 13 N counts, not the distance of 6.5 N from the pinch at rest."""
    told_s = None
    for k in range(200):
        t = 4e-3 * k
        swing = (
            6.5 * np.sign(np.sin(2.0 * np.pi * 20.0 * (t - 0.2) + 1.2 * phase)) if t >= 0.2 else 0.0
        )
        fault = monitor.grippers(10.0 + t, "", (0.018, 0.018), (60.0 + swing, 60.0), 0.022)
        if fault is not None:
            told_s = t - 0.2
            assert fault.name == "gripper_jitter"
            break
    assert told_s is not None
    assert told_s < 0.17


def test_a_pinch_that_had_crept_before_its_hand_opens_counts_from_where_it_is(
    monitor: FaultMonitor,
) -> None:
    """The change counts from the pinch at the order, not from that of the last step."""

    def look(k: int, told: str, pinch_n: float) -> Fault | None:
        return monitor.grippers(10.0 + 4e-3 * k, told, (0.018, 0.018), (pinch_n, pinch_n), 0.076)

    for k in range(100):
        assert look(k, "", 60.0 + 0.11 * k) is None
    for k in range(100, 150):  # 70.9 to 46 N within 0.2 s
        assert look(k, "open", 71.0 - 0.5 * (k - 100)) is None


@pytest.mark.parametrize("swing_n", [5.5, 11.5])
def test_a_pinch_that_swings_by_less_than_a_step_or_rises_slowly_does_not_jitter(
    monitor: FaultMonitor,
    swing_n: float,
) -> None:
    rng = np.random.default_rng(0)
    for k in range(1000):
        t = 4e-3 * k
        pinch = (
            40.0
            + 5.0 * t
            + 0.5 * swing_n * np.sign(np.sin(2.0 * np.pi * 20.0 * t))
            + rng.normal(0.0, 0.02)
        )
        assert monitor.grippers(10.0 + t, "", (0.018, 0.018), (pinch, 60.0), 0.022) is None


def test_every_row_of_the_table_can_be_told(monitor: FaultMonitor) -> None:
    fine = np.full(2, 60.0)
    gaps = np.full(2, 0.02)
    holds = {"pinch_n": fine, "gap_m": gaps, "spread_m": 0.24, "tilt_rad": 0.0}
    assert monitor.holding(**holds) is None
    for _ in range(12):  # what the sensor's noise is like
        assert monitor.resting((0.0005, 0.005)) is None
    told = {
        "missed_grasp": _until_told(
            lambda: monitor.closing(np.array([0.02, 0.01]), np.zeros(2), 0.1),
        ),
        "knocked_away": _until_told(lambda: monitor.resting((0.01, 0.0))),
        "object_lost": _until_told(
            lambda: monitor.holding(**{**holds, "pinch_n": np.array([60.0, 3.0])}),
        ),
        "slip": _until_told(lambda: monitor.squeezing(40.0, 10.0)),
        "tilted": _until_told(lambda: monitor.holding(**{**holds, "tilt_rad": 0.5})),
        "sensor_lost": _until_told(lambda: monitor.silent("pose", 0.06, 0.05)),
        "lost_arm": _until_told(
            lambda: monitor.motors(np.full(DOF, 5.0), np.r_[np.full(7, 5.0), np.zeros(7)]),
        ),
        "gripper_stuck": _until_told(_hand_tells(monitor, "close", lambda t: 0.08), calls=25),
        "gripper_jitter": _until_told(
            _hand_tells(monitor, "", lambda t: 0.02 + 0.002 * np.sin(126.0 * t)),
            calls=50,
        ),
    }
    for name, (said, calls) in told.items():
        assert said == name
        assert calls <= 5 or name.startswith("gripper")
    assert set(told) | {
        "unreachable",
        "singular",
        "joint_limit",
        "off_path",
        "reflex",
        "interrupted",
    } == {
        *OPENING,
        *CLOSED,
    }
    assert monitor.silent("pose", 0.05, 0.05) is None
    assert _until_told(lambda: monitor.silent("pose", float("nan"), 0.05))[0] == "sensor_lost"
    assert _until_told(lambda: monitor.frozen("the pinch", True, 3)) == ("sensor_lost", 3)
    assert monitor.frozen("the pinch", False, 3) is None
    assert _until_told(lambda: monitor.held_pose((0.0, 0.1)))[0] == "slip"
    assert _until_told(lambda: monitor.holding(**{**holds, "spread_m": 0.25}))[0] == "slip"
    assert (
        monitor.closing(gaps, np.array([60.0, 3.0]), 1.6) is not None
    )  # a finger that stands on the object


def test_a_reading_that_is_no_number_is_a_fault_and_no_good_reading(monitor: FaultMonitor) -> None:
    nan = float("nan")
    fine = np.full(2, 60.0)
    gaps = np.full(2, 0.02)
    holds = {"pinch_n": fine, "gap_m": gaps, "spread_m": 0.24, "tilt_rad": 0.0}
    assert monitor.holding(**holds) is None
    blind: dict[str, dict[str, object]] = {
        "object_lost": {"pinch_n": np.array([60.0, nan])},
        "tilted": {"tilt_rad": nan},
        "slip": {"spread_m": nan},
    }
    for name, reading in blind.items():
        assert (
            _until_told(lambda reading=reading: monitor.holding(**{**holds, **reading}))[0] == name
        )
        assert monitor.holding(**holds) is None
    assert (
        _until_told(lambda: monitor.holding(**{**holds, "gap_m": np.array([nan, 0.02])}))[0]
        == "object_lost"
    )
    assert (
        _until_told(lambda: monitor.closing(np.array([nan, 0.02]), fine, 0.1))[0] == "missed_grasp"
    )
    assert _until_told(lambda: monitor.squeezing(40.0, nan))[0] == "slip"
    dead = np.r_[np.zeros(9), nan, np.zeros(4)]
    assert _until_told(lambda: monitor.motors(np.zeros(DOF), dead))[0] == "lost_arm"
    for innovation in ((nan, 0.0), (0.0, nan)):
        assert (
            _until_told(lambda innovation=innovation: monitor.resting(innovation))[0]
            == "knocked_away"
        )
        assert _until_told(lambda innovation=innovation: monitor.held_pose(innovation))[0] == "slip"


def test_a_single_bad_reading_is_not_a_fault(monitor: FaultMonitor) -> None:
    for _ in range(20):
        assert monitor.resting((0.02, 0.0)) is None
        assert monitor.resting((0.0, 0.0)) is None
        assert monitor.squeezing(40.0, 0.0) is None
        assert monitor.squeezing(40.0, 39.0) is None


def test_an_unreachable_goal_is_told_before_the_object_is_lifted(scene: SceneConfig) -> None:
    far = scene.model_copy(
        update={"task": scene.task.model_copy(update={"goal_xy_m": (0.9, -0.6)})},
    )
    world = World(far)
    trial = sample_trial(far, 5, "faults", 0)
    world.reset(poses=trial.start)
    carry = impedance_carry(world, Kinematics(), CarryConfig(), trial, seed=5)
    highest = 0.0
    while not carry.done:
        carry.step()
        highest = max(highest, float(world.object_pose()[2, 3]))
    assert carry.fault is not None
    assert carry.fault.name == "unreachable"
    assert highest < far.object.radius_m + 0.002


def test_a_rod_out_of_reach_is_a_fault_before_the_arms_move(world: World) -> None:
    trial = rod_trial("faults", 0, (0.95, 0.6, 0.0), (0.5, 0.0, 0.0))
    world.reset(poses=trial.start)
    carry = impedance_carry(world, Kinematics(), CarryConfig(), trial, seed=5)
    q = world.q
    while not carry.done:
        carry.step()
    assert carry.fault is not None
    assert (carry.fault.name, carry.fault.at_s) == ("unreachable", 0.0)
    assert "the left hand cannot reach position [0.952, 0.72, 0.092] m" in carry.fault.detail
    assert np.abs(world.q - q).max() < 0.01


@pytest.mark.parametrize("phase", ["approach", "open"])
def test_a_grasp_that_is_lost_on_the_way_is_a_fault(carry: Carry, phase: str) -> None:
    carry.run((phase, 0.0), grasp_lost)


def grasp_lost(run: Run) -> None:
    def none(*_args: object, **_options: object) -> None:
        raise PoseUnreachableError("the left hand misses its grasp")

    carry_phases.grasp_posture = none
    run.finish()
    fault = run.carry.fault
    assert fault is not None
    assert (fault.name, fault.detail) == ("unreachable", "the left hand misses its grasp")


def test_a_singular_posture_stops_the_arms_softly_with_the_object_held(carry: Carry) -> None:
    carry.run(("carry", 1.0), singular_in_the_air)


def singular_in_the_air(run: Run) -> None:
    def singular(*_args: object, **_options: object) -> None:
        raise SingularPostureError("a hand has lost a direction of motion")

    ObjectImpedance.torque = singular  # type: ignore[method-assign]
    world = run.world
    run.finish()
    assert run.carry.fault is not None
    assert run.carry.fault.name == "singular"
    assert run.latency_s <= 0.001 + 1e-9
    assert run.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    assert np.abs(run.speeds[-1]).max() < 0.05
    assert world.truth().pinch().min() > 20.0
    assert not world.on_table()


def test_a_halt_on_the_way_down_stops_above_the_table(carry: Carry) -> None:
    """At half of the joints' limits, plans that brake at theirs ended on the table: 479 N."""
    carry.run(("descend", 0.3), blind_on_the_way_down)


def blind_on_the_way_down(run: Run) -> None:
    sensors = run.carry.watch.sensing._sensors
    kinematics = Kinematics()
    lowest_m = np.inf
    sense = sensors.sense
    sensors.sense = lambda: sense()._replace(pose=None)  # type: ignore[method-assign]
    while not run.carry.done:
        run.step()
        lowest_m = min(lowest_m, *(float(T[2, 3]) for T in kinematics.tcp_poses(run.world.q)))
    assert run.carry.fault is not None
    assert run.carry.fault.name == "sensor_lost"
    assert lowest_m > 0.0115  # fingers touch the table at 9.5 mm


def test_a_path_that_the_law_stops_ends_the_carry_by_its_name(carry: Carry) -> None:
    carry.run(("squeeze", 0.1), path_stopped)


def path_stopped(run: Run) -> None:
    world = run.world
    run.carry.stack.output.executions[0].stop(("joint_limit", "a joint is near its limit"))
    run.finish()
    assert run.carry.fault is not None
    assert run.carry.fault.name == "joint_limit"
    assert np.abs(world.v).max() < 0.02
    assert world.truth().pinch().min() > 50.0


@pytest.mark.parametrize("force_n", [15.0, 40.0])
def test_an_object_that_falls_behind_its_path_stops_it(carry: Carry, force_n: float) -> None:
    """The path stops within 50 mm, before a next one could be refused."""
    carry.run(("carry", 1.0), held_back, force_n)


def held_back(run: Run, force_n: float) -> None:
    world = run.world
    away_m = list[float]()
    until_s = run.world.time + 1.0
    while not run.carry.done and world.time < 14.0:
        world.data.xfrc_applied[world.truth().body, 1] = (
            -force_n if run.carry.phase == "carry" and world.time < until_s else 0.0
        )
        run.step()
        desired = run.carry.stack.impedance.desired
        if desired is not None and run.carry.phase == "carry":
            away_m.append(
                float(np.linalg.norm(world.object_pose()[:3, 3] - desired.T_world_object[:3, 3])),
            )
    if force_n < 20.0:  # the spring gives way, as it is meant to
        assert run.carry.fault is None
        assert 0.02 < max(away_m) < 0.04
        return
    assert run.carry.fault is not None
    assert run.carry.fault.name == "off_path"
    assert max(away_m) < 0.05
    assert "bounds 0.04 m, 0.15 rad" in run.carry.fault.detail
    assert world.truth().pinch().min() > 50.0
    assert not world.on_table()
    assert np.abs(world.v).max() < 0.05


def test_a_singular_posture_when_the_law_is_to_take_over_leaves_the_object_where_it_lies(
    carry: Carry,
) -> None:
    carry.run(("close", 0.0), singular_at_the_start)


def singular_at_the_start(run: Run) -> None:
    def singular(*_args: object, **_options: object) -> None:
        raise SingularPostureError("the left hand has lost a direction of motion")

    ObjectImpedance.engage = singular  # type: ignore[method-assign]
    world = run.world
    run.finish()
    fault = run.carry.fault
    assert fault is not None
    assert (fault.name, fault.detail) == (
        "singular",
        "the left hand has lost a direction of motion",
    )
    assert run.torque_step_nm <= TAU_RATE_MAX * world.dt + 1e-9
    assert np.abs(run.speeds[-1]).max() < 0.05
    assert run.carry.stack.manager.active == ("soft_stop",)
    assert world.on_table()
