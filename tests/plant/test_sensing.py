"""Simulated sensors have the stated noise, bias, rate and delay."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from minidual.config.control import SensingConfig
from minidual.config.seeds import stream
from minidual.plant.sensing import Sensors
from minidual.robot.pair import pose, rot_z
from tests.support.carry_trials import PERFECT_SENSING
from tests.support.sensed_bench import SensedBench, sensors


def test_noise_has_the_stated_deviation_no_bias_and_no_memory() -> None:
    bench = SensedBench()
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
        senses = sensors(
            SensedBench(), trial, pose_noise_m=0.0, pose_noise_rad=0.0, pose_bias_m=0.001
        )
        found = [
            r.pose.T_world_object[:3, 3] for r in (senses.sense() for _ in range(60)) if r.pose
        ]
        assert np.ptp(np.array(found), axis=0).max() < 1e-12
        offsets.append(found[0] - SensedBench().T[:3, 3])
    assert np.allclose(np.std(offsets, axis=0), 0.001, rtol=0.2)


@pytest.mark.parametrize("delay_s", [0.0, 0.003, 0.010, 0.025])
def test_the_delay_is_exact_in_steps(delay_s: float) -> None:
    bench = SensedBench()
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
    bench = SensedBench()
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
        senses = Sensors(SensedBench(), config, stream(seed, "sensing/x", 3))  # type: ignore[arg-type]
        readings = [senses.sense() for _ in range(200)]
        return (
            np.array([r.pose.T_world_object[:3, 3] for r in readings if r.pose])
            - SensedBench().T[:3, 3]
        )

    assert np.array_equal(errors(1, 0.0005), errors(1, 0.0005))
    assert not np.array_equal(errors(1, 0.0005), errors(2, 0.0005))
    assert np.allclose(errors(1, 0.0010), 2.0 * errors(1, 0.0005), atol=1e-12)
