"""How the arms follow steps and swings, and the contacts of their links."""

import time

import numpy as np
import pytest

from minidual.errors import UsageError
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.env_check import tracking
from minidual.stages.env_check.tracking import Tracking, arm_contacts
from tests.support.env_check_samples import DOF, HOME, failing, judged, rig_of


class TestTracking:
    def test_the_step_is_reached_to_rounding(self, rig):
        step = tracking.step_response(rig, tracking.outward_step(DUAL_PANDA, 0.3), 2.0)
        assert step.settled < 1e-6
        assert step.stopped == ""
        assert step.error_norm[0] == pytest.approx(0.3 * np.sqrt(2), rel=1e-3)
        assert step.reference[-1][[0, 7]] == pytest.approx(HOME[[0, 7]] + [0.3, -0.3])

    def test_with_the_motors_off_it_is_not_and_the_supervisor_says_so(self, rig, monkeypatch):
        command = rig.world.command
        monkeypatch.setattr(rig.world, "command", lambda tau, fingers: command(0.0 * tau, fingers))
        step = tracking.step_response(rig, tracking.outward_step(DUAL_PANDA, 0.3), 1.0)
        assert step.settled > 0.3
        assert step.stopped
        assert judged(step=step)["control.stopped"].passed is False

    def test_an_error_that_crosses_zero_is_still_an_error(self):
        t = np.arange(1000) * 1e-3
        swinging = np.zeros((1000, DOF))
        swinging[:, 0] = 0.1 * np.sin(2 * np.pi * 5.0 * (t - t[-1]))  # zero at the last instant
        crossing = Tracking(t, np.zeros((1000, DOF)), swinging, HOME)
        assert crossing.error_norm[-1] < 1e-9
        assert crossing.settled == pytest.approx(0.1, rel=0.01)

    def test_each_joint_alone_arrives(self, rig):
        assert max(step.settled for step in tracking.single_joint_steps(rig, 0.1, 0.6)) < 0.001

    def test_a_blocked_joint_does_not_and_its_neighbours_do(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.joint("left_panda_joint5").frictionloss = 50.0  # more than its motor can
        blocked = rig_of(World(scene, model=spec.compile()), kinematics)
        errors = np.array([step.settled for step in tracking.single_joint_steps(blocked, 0.1, 0.6)])
        assert errors[4] > 0.05
        assert np.delete(errors, 4).max() < 0.005

    def test_the_swing_is_followed_in_real_time(self, rig):
        sine = tracking.sine_response(rig, 0.3, 0.5, 2.0)
        assert sine.rms < 0.002
        assert (sine.contacts, sine.stopped) == (0, "")
        assert np.ptp(sine.measured, axis=0) == pytest.approx(np.full(DOF, 0.6), abs=0.01)
        assert 0.0 < sine.step_us < 1000.0

    def test_a_swing_may_end_between_two_rests(self, rig):
        assert tracking.sine_response(rig, 0.3, 0.5, 0.7).rms < 0.002

    def test_a_slack_and_slow_controller_fails_the_swing(self, rig, monkeypatch):
        update = rig.stack.manager.update

        def weak(q, v):
            time.sleep(0.0012)
            return 0.7 * update(q, v)

        motion = tracking.start_swing(rig, 0.3, 0.5, 0.3)
        monkeypatch.setattr(rig.stack.manager, "update", weak)
        sine = tracking.track(rig, motion.q[1:301])
        assert sine.rms > 0.02
        assert sine.step_us > 1000.0
        assert {"tracking.sine_rms_rad", "control.step_median_us"} <= failing(judged(sine=sine))

    def test_the_swings_reference_is_consistent_and_starts_at_rest(self):
        h = 1e-6
        for t in (0.0, 0.3, 1.7):
            _, v, a = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, t)
            after = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, t + h)
            before = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, t - h)
            assert (after[0] - before[0]) / (2 * h) == pytest.approx(v, abs=1e-8)
            assert (after[1] - before[1]) / (2 * h) == pytest.approx(a, abs=1e-8)
        assert not tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, 0.0)[1].any()
        with pytest.raises(UsageError, match="velocity limits"):
            tracking.sine_reference(DUAL_PANDA, 0.5, 1.0, 0.0)
        with pytest.raises(UsageError, match="joint limits"):
            tracking.sine_reference(DUAL_PANDA, 2.0, 0.1, 0.0)


class TestContacts:
    def test_none_at_home_though_the_rod_touches_the_table(self, world):
        assert world.data.ncon > 0
        assert arm_contacts(world) == []

    def test_a_hand_in_the_table_is_counted_and_named(self, world):
        q = HOME.copy()
        q[1], q[3] = 1.0, -1.6
        world.reset(q)
        pairs = arm_contacts(world)
        assert pairs
        assert any("table" in pair[:2] for pair in pairs)

    def test_arms_that_reach_across_collide(self, world):
        q = HOME.copy()
        q[0], q[7] = -0.9, 0.9
        world.reset(q)
        assert any(
            a.startswith("left_") and b.startswith("right_") for a, b, _ in arm_contacts(world)
        )
