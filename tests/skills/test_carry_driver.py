"""Carries disturbed at random: pushes, mass, friction, delays, noise, dropped readings, halts, emergency stops.

The supervisor is that of the trials, with distances, stopping distances and the held rod. In every tick a finite torque
near the last one; at the end the arms rest, and the rod lies at its goal or a fault has its name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from minidual.config.control import CarryConfig, SensingConfig, SupervisorConfig
from minidual.config.seeds import stream
from minidual.plant.protocol import Reading
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.faults import CLOSED, OPENING
from minidual.skills.supervised import trial_supervisor
from minidual.skills.things import thing_of
from tests.support.carries import impedance_carry
from tests.support.carry_trials import sample_trial
from tests.support.panda import TAU_MAX, TAU_RATE_MAX

BODIES = ("rod", "left_panda_hand", "right_panda_hand", "left_panda_link4", "right_panda_link4")
REST_TICKS = 600
PUSHED_TICKS = 1000
GOAL_M = 0.03


class DroppingSensors(Sensors):
    """Delivers no pose, or old forces, until a time."""

    pose_from_s = forces_from_s = 0.0
    _last: Reading

    def sense(self) -> Reading:
        reading = super().sense()
        now_s = self._world.time
        if now_s < self.pose_from_s:
            reading = reading._replace(pose=None)
        if now_s < self.forces_from_s:
            last = self._last
            return reading._replace(
                hand_forces=last.hand_forces,
                pinch=last.pinch,
                stamp_s=last.stamp_s,
            )
        self._last = reading
        return reading


class Disturbed:
    """One carry and what happens to it, from a seed."""

    def __init__(self, world: World, seed: int) -> None:
        self.world = world
        self.rng = np.random.default_rng(seed)
        rng = self.rng
        rod = world.model.body("rod").id
        self.trial = sample_trial(world.scene, seed, "driver", 0)
        world.reset(poses=self.trial.start)
        noise = float(rng.uniform(0.0, 2.0))
        delay_ticks = int(rng.integers(0, 21))
        sensing = SensingConfig(
            pose_noise_m=0.0005 * noise,
            pose_noise_rad=0.005 * noise,
            force_noise_n=noise,
            delay_s=1e-3 * delay_ticks,
        )
        heavier = rng.uniform(0.5, 3.0)
        world.model.body_mass[rod] *= heavier
        world.model.body_inertia[rod] *= heavier
        world.model.geom_friction[:, 0] *= rng.uniform(0.5, 1.3)
        mujoco.mj_setConst(world.model, mujoco.MjData(world.model))
        self.sensors = DroppingSensors(world, sensing, stream(seed, "sensing/driver", 0))
        shapes = (thing_of(world.scene.object).shape,)
        self.supervisor = trial_supervisor(SupervisorConfig(), world.dt, world.robot, shapes=shapes)
        config = CarryConfig(sensing=sensing)
        self.carry = impedance_carry(
            world,
            Kinematics(),
            config,
            self.trial,
            sensors=self.sensors,
            supervisor=self.supervisor,
        )
        self.push_ends_s = np.inf
        kinds: tuple[Callable[[], None], ...] = (
            *[self.push] * 4,
            *[self.drop] * 2,
            self.halt,
            self.hold,
            self.estop,
        )
        times = np.sort(rng.uniform(0.3, 7.0, rng.integers(1, 4)))
        self.events = [(float(t), kinds[rng.integers(len(kinds))]) for t in times]

    def push(self) -> None:
        body = self.world.model.body(BODIES[self.rng.integers(len(BODIES))]).id
        self.world.data.xfrc_applied[body, :3] = self.rng.uniform(-25.0, 25.0, 3)
        self.push_ends_s = self.world.time + float(self.rng.uniform(0.02, 0.2))

    def drop(self) -> None:
        until_s = self.world.time + float(self.rng.uniform(0.002, 0.06))
        setattr(self.sensors, ("pose_from_s", "forces_from_s")[self.rng.integers(2)], until_s)

    def halt(self) -> None:
        self.carry.stack.halt("teleop")

    def hold(self) -> None:
        self.carry.stack.request("hold")

    def estop(self) -> None:
        self.supervisor.estop()

    def play(self) -> str:
        """Carry to the end, check every tick; return the fault's name or "carried"."""
        world = self.world
        carry = self.carry
        told = Kinematics().gravity(world.q)
        rested = 0
        needed = REST_TICKS
        while not carry.done or rested < needed:
            assert world.time < 16.0, "neither done nor stopped"
            while self.events and world.time >= self.events[0][0]:
                self.events.pop(0)[1]()
            if world.time >= self.push_ends_s:
                world.data.xfrc_applied[:] = 0.0
            carry.step()
            tau = world.data.ctrl[world.joints.ctrl].copy()
            assert np.isfinite(tau).all()
            assert np.max(np.abs(tau) / TAU_MAX) <= 1.0 + 1e-9
            assert np.abs(tau - told).max() <= TAU_RATE_MAX * world.dt + 1e-9
            told = tau
            rested = rested + carry.done
            if (
                carry.done and world.data.xfrc_applied.any()
            ):  # stopped arms give way to a push and come back
                rested = 0
                needed = PUSHED_TICKS
        assert np.abs(world.v).max() < 0.05, "not at rest"
        if carry.fault is not None:
            assert carry.fault.name in (*OPENING, *CLOSED)
            return carry.fault.name
        T = world.object_pose()
        (x, y, _) = self.trial.goal["rod"]
        away_m = float(np.hypot(T[0, 3] - x, T[1, 3] - y))
        assert away_m < GOAL_M, (
            f"the rod lies {1e3 * away_m:.0f} mm from its goal, and nobody says why"
        )
        assert abs(T[2, 3] - world.scene.object.rest_height_m) < 0.005
        return "carried"


def play(world: World, seed: int) -> str:
    model = world.model
    kept = model.body_mass.copy(), model.body_inertia.copy(), model.geom_friction.copy()
    try:
        return Disturbed(world, seed).play()
    finally:
        world.data.xfrc_applied[:] = 0.0
        model.body_mass[:], model.body_inertia[:], model.geom_friction[:] = kept
        mujoco.mj_setConst(model, mujoco.MjData(model))


@pytest.mark.parametrize("seed", [5, 7, 101])
def test_a_disturbed_carry_ends_at_rest_and_says_what_happened(world: World, seed: int) -> None:
    assert play(world, seed)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(8))
def test_of_two_hundred_disturbed_carries_none_loses_its_object_in_silence(
    world: World,
    block: int,
) -> None:
    ends = Counter(play(world, seed) for seed in range(100 + 25 * block, 125 + 25 * block))
    assert ends["carried"] > 0
    assert len(ends) > 3, f"the disturbances hardly disturb: {ends}"
