"""Sensors have the stated noise and delay, and the controller reads nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from minidual.config.control import CarryConfig, SensingConfig
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import inverse, pose, rot_x, rot_z
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.skills.object_estimate import HeldEstimate, RestingEstimate
from tests.support.carry_trials import PERFECT_SENSING, sample_trial
from tests.support.panda import HOME


@dataclass
class Bench:
    """What sensors may ask of a world, and nothing else."""

    dt: float = 0.001
    time: float = 0.0
    T: np.ndarray = field(default_factory=lambda: pose(rot_z(0.3), (0.5, 0.1, 0.01)))
    felt: np.ndarray = field(
        default_factory=lambda: np.array([[1.0, -40.0, 2.0], [0.0, 40.0, 2.0]]),
    )
    pinches: tuple[float, float] = (60.0, 50.0)

    def truth(self, name: object = None) -> Bench:
        return self

    def pose(self) -> np.ndarray:
        return self.T.copy()

    def look(self) -> np.ndarray:
        return np.r_[np.zeros(6), self.felt.ravel(), self.pinches, 0.0]


def sensors(world: Any, rng: int = 0, **changes: float) -> Sensors:
    return Sensors(world, SensingConfig(**changes), np.random.default_rng(rng))


def test_noise_has_the_stated_deviation_no_bias_and_no_memory() -> None:
    bench = Bench()
    senses = sensors(bench, pose_rate_hz=1000.0)
    readings = [senses.sense() for _ in range(6000)]
    forces = np.array([r.hand_forces for r in readings[100:]]).reshape(-1, 6) - bench.felt.ravel()
    positions = (
        np.array([r.pose.T_world_object[:3, 3] for r in readings if r.pose]) - bench.T[:3, 3]
    )
    turns = np.array(
        [pin.log3(r.pose.T_world_object[:3, :3] @ bench.T[:3, :3].T) for r in readings if r.pose],
    )
    for errors, deviation in ((forces, 1.0), (positions, 0.0005), (turns, np.radians(0.3))):
        n = len(errors)
        assert np.allclose(errors.std(axis=0), deviation, rtol=0.04)
        assert np.abs(errors.mean(axis=0)).max() < 4.5 * deviation / np.sqrt(n)
        neighbours = (errors[1:] * errors[:-1]).mean(axis=0) / deviation**2
        assert np.abs(neighbours).max() < 4.5 / np.sqrt(n)
    pinch = np.array([r.pinch for r in readings[100:]])
    assert np.allclose(pinch.mean(axis=0), bench.pinches, atol=0.1)
    assert np.allclose(pinch.std(axis=0), 1.0, rtol=0.05)


def test_a_bias_stays_for_a_trial_and_differs_between_trials() -> None:
    offsets = []
    for trial in range(200):
        senses = sensors(Bench(), trial, pose_noise_m=0.0, pose_noise_rad=0.0, pose_bias_m=0.001)
        found = [
            r.pose.T_world_object[:3, 3] for r in (senses.sense() for _ in range(60)) if r.pose
        ]
        assert np.ptp(np.array(found), axis=0).max() < 1e-12
        offsets.append(found[0] - Bench().T[:3, 3])
    assert np.allclose(np.std(offsets, axis=0), 0.001, rtol=0.2)


@pytest.mark.parametrize("delay_s", [0.0, 0.003, 0.010, 0.025])
def test_the_delay_is_exact_in_steps(delay_s: float) -> None:
    bench = Bench()
    senses = sensors(
        bench,
        pose_noise_m=0.0,
        pose_noise_rad=0.0,
        force_noise_n=0.0,
        delay_s=delay_s,
    )
    ticks = round(delay_s / bench.dt)
    assert senses.delay_ticks == ticks
    fresh = []
    for k in range(100):  # step k: the truth says k
        bench.felt = np.full((2, 3), float(k))
        bench.T = pose(np.eye(3), (float(k), 0.0, 0.0))
        reading = senses.sense()
        assert reading.hand_forces[0, 0] == max(0, k - ticks)
        if reading.pose is not None and k:
            assert reading.pose.age_ticks == ticks
            assert reading.pose.T_world_object[0, 3] == k - ticks
            fresh.append(k)
    assert np.all(np.diff(fresh) == 10)  # 100 Hz
    assert (fresh[0] - ticks) % 10 == 0


def test_switched_off_it_is_the_truth() -> None:
    bench = Bench()
    senses = Sensors(bench, PERFECT_SENSING, np.random.default_rng(0))  # type: ignore[arg-type]
    for k in range(30):
        bench.T = pose(rot_z(0.01 * k), (0.1 * k, 0.0, 0.0))
        reading = senses.sense()
        assert reading.pose is not None
        assert np.allclose(reading.pose.T_world_object, bench.T, atol=1e-15)
        assert np.array_equal(reading.hand_forces, bench.felt)
        assert np.array_equal(reading.pinch, bench.pinches)


def test_same_stream_same_noise_and_the_draws_do_not_depend_on_the_amounts() -> None:
    def errors(seed: int, noise_m: float) -> np.ndarray:
        config = SensingConfig(pose_noise_m=noise_m)
        senses = Sensors(Bench(), config, stream(seed, "sensing/x", 3))  # type: ignore[arg-type]
        readings = [senses.sense() for _ in range(200)]
        return (
            np.array([r.pose.T_world_object[:3, 3] for r in readings if r.pose]) - Bench().T[:3, 3]
        )

    assert np.array_equal(errors(1, 0.0005), errors(1, 0.0005))
    assert not np.array_equal(errors(1, 0.0005), errors(2, 0.0005))
    assert np.allclose(errors(1, 0.0010), 2.0 * errors(1, 0.0005), atol=1e-12)


def test_the_mean_of_a_resting_object_falls_with_the_root_of_the_samples() -> None:
    bench = Bench()
    errors = []
    turns = []
    for trial in range(40):
        senses = sensors(bench, trial, pose_rate_hz=1000.0, delay_s=0.0)
        first = senses.sense().pose
        assert first is not None
        estimate = RestingEstimate(first.T_world_object)
        for _ in range(99):
            sample = senses.sense().pose
            assert sample is not None
            estimate.add(sample.T_world_object)
        errors.append(estimate.T_world_object[:3, 3] - bench.T[:3, 3])
        turns.append(pin.log3(estimate.T_world_object[:3, :3] @ bench.T[:3, :3].T))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.0005 / 10, rel=0.25)
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(np.radians(0.3) / 10, rel=0.25)


def test_a_mean_that_forgets_follows_an_object_that_closing_hands_shift() -> None:
    before = pose(np.eye(3), (0.5, 0.0, 0.1))
    after = pose(rot_x(0.1), (0.5, 0.003, 0.1))
    steady = RestingEstimate(before)
    forgets = RestingEstimate(before)
    for T, n in ((before, 100), (after, 20)):
        for _ in range(n):
            steady.add(T)
            forgets.add(T, 0.2)
    assert np.linalg.norm(steady.T_world_object[:3, 3] - after[:3, 3]) > 0.002
    assert np.linalg.norm(forgets.T_world_object[:3, 3] - after[:3, 3]) < 0.0001
    assert np.linalg.norm(pin.log3(forgets.T_world_object[:3, :3].T @ after[:3, :3])) < 0.002


def _held_pose(kinematics: Kinematics, q: np.ndarray) -> np.ndarray:
    """An object carried by both hands: midway between them, along the line that joins them."""
    left, right = kinematics.tcp_poses(q)
    y = left[:3, 3] - right[:3, 3]
    y /= np.linalg.norm(y)
    x = left[:3, 1] + right[:3, 1]
    x -= (x @ y) * y
    x /= np.linalg.norm(x)
    frame = pose(np.column_stack([x, y, np.cross(x, y)]), 0.5 * (left[:3, 3] + right[:3, 3]))
    return frame @ pose(rot_x(0.4), (0.002, 0.01, -0.004))


def test_the_twist_of_the_estimate_is_that_of_an_object_held_by_both_hands(
    kinematics: Kinematics,
) -> None:
    rng = np.random.default_rng(2)
    q = HOME + 0.1 * rng.standard_normal(14)
    T = _held_pose(kinematics, q)
    twist = 0.3 * rng.standard_normal(6)
    hands = [
        np.r_[twist[:3] + np.cross(twist[3:], hand[:3, 3] - T[:3, 3]), twist[3:]]
        for hand in kinematics.tcp_poses(q)
    ]
    v = np.linalg.pinv(np.vstack(kinematics.tcp_jacobians(q))) @ np.concatenate(hands)
    estimate = HeldEstimate(kinematics, q, T, delay_ticks=0, least_gain=0.1)
    assert np.allclose(estimate.update(q, v, None).twist, twist, atol=1e-9)
    h = 1e-6
    after = estimate.update(q + h * v, v, None).T_world_object.copy()
    before = estimate.update(q - h * v, v, None).T_world_object.copy()
    assert np.allclose((after[:3, 3] - before[:3, 3]) / (2 * h), twist[:3], atol=1e-6)
    assert np.allclose(pin.log3(after[:3, :3] @ before[:3, :3].T) / (2 * h), twist[3:], atol=1e-6)


def test_the_estimate_follows_the_hands_at_once_and_an_old_sample_does_not_pull_it_back(
    kinematics: Kinematics,
) -> None:
    delay = 10
    direction = np.r_[0.3 * np.ones(7), -0.2 * np.ones(7)]
    T_start = _held_pose(kinematics, HOME)
    estimate = HeldEstimate(kinematics, HOME, T_start, delay_ticks=delay, least_gain=0.2)
    truth: list[np.ndarray] = []
    for k in range(200):
        q = HOME + 0.001 * k * direction
        truth.append(_held_pose(kinematics, q))
        sample = truth[k - delay] if k >= delay and k % 10 == 0 else None
        state = estimate.update(q, direction, sample, delay)
        assert np.allclose(state.T_world_object, truth[k], atol=1e-9)
    assert (
        np.linalg.norm(truth[-1][:3, 3] - truth[-1 - delay][:3, 3]) > 0.0005
    )  # the raw sample was that far behind


def test_a_slip_in_the_hands_shows_in_the_innovation_and_is_learnt(kinematics: Kinematics) -> None:
    T = _held_pose(kinematics, HOME)
    estimate = HeldEstimate(kinematics, HOME, T, delay_ticks=0, least_gain=0.1)
    slipped = T.copy()
    slipped[2, 3] -= 0.01
    for _ in range(60):
        estimate.update(HOME, np.zeros(14), T)
    estimate.update(HOME, np.zeros(14), slipped)
    assert estimate.innovation[0] == pytest.approx(0.01)
    for _ in range(80):
        estimate.update(HOME, np.zeros(14), slipped)
    assert np.allclose(estimate.state.T_world_object, slipped, atol=1e-5)


@pytest.mark.parametrize("turned", [False, True])
def test_one_frame_that_is_far_off_moves_no_estimate_and_two_do(
    kinematics: Kinematics,
    turned: bool,
) -> None:
    """A marker that is taken for another one does not move the estimate, nor look like slip."""
    T = _held_pose(kinematics, HOME)
    estimate = HeldEstimate(kinematics, HOME, T, delay_ticks=0, least_gain=0.1)
    odd = T @ (pose(rot_x(np.pi), (0.0, 0.0, 0.0)) if turned else pose(np.eye(3), (0.3, 0.0, 0.0)))
    for _ in range(3):
        estimate.update(HOME, np.zeros(14), odd)
        assert max(estimate.innovation) > 0.2, "the faults see it all the same"
        assert np.allclose(estimate.state.T_world_object, T, atol=1e-9)
        estimate.update(HOME, np.zeros(14), T)
        assert max(estimate.innovation) < 1e-6
    estimate.update(HOME, np.zeros(14), odd)
    estimate.update(HOME, np.zeros(14), odd)
    assert not np.allclose(estimate.state.T_world_object, T, atol=1e-3)


class Blind:
    """A world that refuses to say anything about the object."""

    HIDDEN = ("truth", "object_pose", "on_table", "contact_pairs", "touches", "data", "model")

    def __init__(self, world: World) -> None:
        self._world = world

    def __getattr__(self, name: str) -> Any:
        if name in self.HIDDEN:
            raise AssertionError(f"the controller read {name}")
        return getattr(self._world, name)


def _errors(world: World, carry: ImpedanceCarry) -> tuple[float, float]:
    T = world.object_pose()
    estimate = carry.watch.estimate.T_world_object
    return (
        float(np.linalg.norm(T[:3, 3] - estimate[:3, 3])),
        float(np.linalg.norm(pin.log3(T[:3, :3].T @ estimate[:3, :3]))),
    )


def test_a_first_force_that_is_no_number_is_forgotten(world: World) -> None:
    """The filter does not keep a NaN: the hands feel what they close on."""
    world.reset()
    senses = Sensors(world, SensingConfig(), stream(1, "sensing/first", 0))
    listen = senses.sense
    blind = iter([True])
    senses.sense = lambda: (  # type: ignore[method-assign]
        listen()._replace(hand_forces=np.full((2, 3), np.nan)) if next(blind, False) else listen()
    )
    watch = CarryWatch(world, Kinematics(), CarryConfig(), senses)
    for _ in range(20):
        world.step()
        watch.sensing.sense()
    watch.sensing.take_hold()
    watch.sensing.sense()
    assert np.isfinite(watch.sensing.felt_n)


def test_a_whole_carry_never_reads_the_truth_and_its_estimate_beats_the_raw_reading(
    world: World,
    scene: SceneConfig,
) -> None:
    trial = sample_trial(scene, 11, "sensing-test", 0)
    world.reset(poses=trial.start)
    rng = stream(11, "sensing/sensing-test", 0)
    senses = Sensors(world, SensingConfig(), rng)
    heard: list[Any] = []
    listen: Callable[[], Any] = senses.sense

    def sense() -> Any:
        heard.append(listen())
        return heard[-1]

    senses.sense = sense  # type: ignore[method-assign]
    nowhere = replace(trial, start=(9.0, 9.0, 9.0))  # not even where the trial began
    blind: Any = Blind(world)
    carry = ImpedanceCarry(blind, Kinematics(), CarryConfig(), nowhere, sensors=senses)
    fused = []
    raw = []
    speeds = []
    while not carry.done:
        carry.step()
        if carry.phase == "carry":
            fused.append(_errors(world, carry))
            speeds.append(carry.watch.estimate.twist - world.truth().twist())
            if heard[-1].pose is not None:
                seen = inverse(world.object_pose()) @ heard[-1].pose.T_world_object
                raw.append((np.linalg.norm(seen[:3, 3]), np.linalg.norm(pin.log3(seen[:3, :3]))))
    assert carry.fault is None
    fused_rms, raw_rms = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (fused, raw))
    assert fused_rms[0] < 0.0005  # of a sensor with 0.9 mm of noise in space, 10 ms late
    assert fused_rms[0] < 0.2 * raw_rms[0]
    assert fused_rms[1] < 0.3 * raw_rms[1]
    # Differences of the raw samples would be noise: 0.5 mm every 10 ms is 70 mm/s.
    assert np.sqrt(np.mean(np.square(np.array(speeds)[:, :3]))) < 0.005


def test_the_blind_world_does_refuse(world: World) -> None:
    with pytest.raises(AssertionError, match="object_pose"):
        _ = Blind(world).object_pose()
    assert np.array_equal(Blind(world).q, HOME)


def test_noise_belongs_to_the_trial_and_the_seed(world: World, scene: SceneConfig) -> None:
    def where(seed: int, index: int) -> bytes:
        trial = sample_trial(scene, 11, "sensing-test", 0)
        world.reset(poses=trial.start)
        carry = ImpedanceCarry(
            world,
            Kinematics(),
            CarryConfig(),
            replace(trial, index=index),
            seed=seed,
        )
        for _ in range(300):
            carry.step()
        return carry.watch.estimate.T_world_object.tobytes()

    assert where(1, 0) == where(1, 0)
    assert where(1, 0) != where(2, 0)
    assert where(1, 0) != where(1, 1)
