"""Rise times and overshoot, the latency of commands, and the emergency stop."""

from dataclasses import replace

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.control.arbiter import CommandArbiter
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.env_check import tracking
from minidual.stages.env_check.responses import command_latency, emergency_stop, joint_responses
from minidual.stages.env_check.rig import TrackingRig
from minidual.stages.env_check.tracking import Tracking
from tests.support.env_check_samples import DOF, HOME, failing, judged, rig_of


class TestResponses:
    def test_the_rise_of_a_known_curve(self):
        t = np.arange(1000) * 1e-3
        measured = np.tile(HOME, (1000, 1))
        measured[:, 3] += 0.1 * (1.0 - np.exp(-t / 0.05))  # rises in 0.05 ln 9
        target = HOME + 0.1 * np.eye(DOF)[3]
        step = Tracking(t, np.tile(target, (1000, 1)), measured, HOME)
        assert joint_responses(DUAL_PANDA, [step] * DOF, step)[3].rise_s == pytest.approx(
            0.05 * np.log(9.0),
            abs=1.1e-3,
        )

    def test_overshoot_and_never_arriving_are_seen_on_either_side(self):
        t = np.arange(1000) * 1e-3
        for sign in (1.0, -1.0):
            target = HOME + sign * 0.1 * np.eye(DOF)[5]
            measured = np.tile(HOME, (1000, 1))
            measured[:, 5] += sign * 0.1 * (1.0 - np.exp(-t / 0.05) * np.cos(40.0 * t))
            beyond = sign * (measured[:, 5] - target[5])
            step = Tracking(t, np.tile(target, (1000, 1)), measured, HOME)
            still = replace(step, measured=np.tile(HOME, (1000, 1)))
            row = joint_responses(DUAL_PANDA, [step] * DOF, step)[5]
            assert row.overshoot_rad == pytest.approx(beyond.max(), rel=1e-9)
            assert row.step_rad == pytest.approx(sign * 0.1)
            assert np.isnan(joint_responses(DUAL_PANDA, [still] * DOF, step)[5].rise_s)


class TestLatency:
    def test_a_command_waits_for_the_arbiter_and_for_nothing_else(self, rig):
        latency = command_latency(rig, repeats_n=10)
        assert latency.ticks == (
            1,
            *range(20, 1, -1),
        )  # the later after a tick, the nearer the next one
        assert latency.late_steps == 0
        assert 0.0 < latency.wall_us < 5000.0

    def test_a_controller_that_lags_a_step_is_seen(self, rig):
        guard = rig.supervisor.guard
        requested = []

        def lagging(measurement, tau, *others):
            requested.append(tau.copy())
            two_ticks_old = requested[max(0, len(requested) - 3)]
            return guard(measurement, two_ticks_old, *others)

        rig.supervisor.guard = lagging
        latency = command_latency(rig, repeats_n=1)
        assert (min(latency.ticks), max(latency.ticks)) == (3, 22)
        check = judged(latency=latency)["latency.late_steps"]
        assert (check.observed, check.passed) == (2, False)

    def test_a_command_that_never_arrives_counts_as_late(self, rig, monkeypatch):
        monkeypatch.setattr(CommandArbiter, "propose", lambda *_: None)
        assert set(command_latency(rig, repeats_n=1).ticks) == {60}

    def test_a_source_that_does_not_get_the_arms_is_told(self, world, kinematics, monkeypatch):
        monkeypatch.setattr(ControlStack, "request", lambda *_: None)
        never = TrackingRig(world, kinematics, Config())
        step = tracking.step_response(never, HOME, 0.1)
        check = judged(step=step)["control.stopped"]
        assert check.passed is False
        assert "the arms were not given" in check.remedy

    def test_an_emergency_stop_brings_swinging_arms_to_rest(self, rig):
        stop = emergency_stop(rig, 0.3, 0.5)
        assert stop.ticks == 1
        assert stop.speed_rad_s > 0.85
        assert 0.05 < stop.rest_s < 0.5

    def test_another_reflex_is_no_emergency_stop(self, world, kinematics, monkeypatch):
        slow = rig_of(world, kinematics, velocity_scale=0.2)
        assert emergency_stop(slow, 0.3, 0.5).ticks == 0  # stopped before it was pressed
        monkeypatch.setattr(
            Supervisor,
            "estop",
            lambda self, *_: setattr(self, "_deadline_s", -1.0),
        )
        assert (
            emergency_stop(rig_of(world, kinematics), 0.3, 0.5).ticks == 0
        )  # in the tick of the call

    def test_a_supervisor_that_ignores_the_button_is_seen(self, rig, monkeypatch):
        monkeypatch.setattr(Supervisor, "estop", lambda *_: None)
        stop = emergency_stop(rig, 0.3, 0.5)
        assert np.isnan(stop.rest_s)
        assert failing(judged(stop=stop)) == {"stop.ticks", "stop.rest_s"}
