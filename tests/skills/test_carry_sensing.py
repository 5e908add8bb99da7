"""A carry reads sensors alone, and its estimate is better than a reading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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
from minidual.robot.pair import inverse
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.impedance_carry import ImpedanceCarry
from tests.support.carries import impedance_carry
from tests.support.carry_trials import sample_trial
from tests.support.panda import HOME


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
    watch = CarryWatch(world, Kinematics(), world.scene, CarryConfig(), senses)
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
    carry = impedance_carry(blind, Kinematics(), CarryConfig(), nowhere, sensors=senses)
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
        carry = impedance_carry(
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
