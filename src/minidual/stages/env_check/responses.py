"""How joints answer to steps, the arbiter to commands, and the arms to an emergency stop."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.robot.pair import Robot
from minidual.stages.env_check.rig import TrackingRig
from minidual.stages.env_check.tracking import Tracking, start_swing

_NUDGE_RAD = 0.02
_CHANGED_SHARE = 0.1
"""Share of the supervisor's torque step (1 Nm) that counts as a changed torque.

A nudge changes it by 0.3 Nm at once, arms at rest by 0.013 Nm.
"""
_SETTLE_STEPS = 120
_STILL_RAD_S = 0.01
_REST_MAX_S = 2.0


@dataclass(frozen=True)
class JointResponse:
    """Response of one joint, a row of joints.csv.

    Attributes:
        joint: Name.
        step_rad: Signed size of its step.
        rise_s: From 10 % to 90 % of the step; NaN if never reached.
        overshoot_rad: Beyond the target.
        settled_rad: Largest error norm of all joints in the last 0.2 s.
        sine_rms_rad: RMS error in the swing.
        sine_peak_rad: Largest error in the swing.
    """

    joint: str
    step_rad: float
    rise_s: float
    overshoot_rad: float
    settled_rad: float
    sine_rms_rad: float
    sine_peak_rad: float


def joint_responses(
    robot: Robot,
    steps: Sequence[Tracking],
    sine: Tracking,
) -> list[JointResponse]:
    """Return the response of each joint to a step of its own, and in the swing of all."""
    errors = sine.reference - sine.measured
    responses = []
    for j, step in enumerate(steps):
        step_rad = float(step.reference[-1, j] - step.start[j])
        largest_share = float(np.max(step.share(j)) - 1.0)
        responses.append(
            JointResponse(
                joint=robot.joint_names[j],
                step_rad=step_rad,
                rise_s=_rise_time(step, j),
                overshoot_rad=max(0.0, largest_share * abs(step_rad)),
                settled_rad=step.settled,
                sine_rms_rad=float(np.sqrt(np.mean(errors[:, j] ** 2))),
                sine_peak_rad=float(np.abs(errors[:, j]).max()),
            ),
        )
    return responses


def _rise_time(step: Tracking, joint: int) -> float:
    """Return the time from 10 % to 90 % of a step [s], NaN if it does not get there."""
    share = step.share(joint)
    above_10 = share >= 0.1
    above_90 = share >= 0.9
    if not above_90.any():
        return math.nan
    return float(step.t[np.argmax(above_90)] - step.t[np.argmax(above_10)])


class CommandLatency(NamedTuple):
    """Latency of commands.

    Attributes:
        ticks: Control steps from `propose` to the first changed torque, by instant after an
            arbiter tick: at best 1, then one period down to 2.
        wall_us: Median wall time of `propose` and the step with the arbiter tick [us].
    """

    ticks: tuple[int, ...]
    wall_us: float

    @property
    def late_steps(self) -> int:
        """Largest delay beyond the arbiter's next tick."""
        period = len(self.ticks)
        soonest = [1, *(period - k + 1 for k in range(1, period))]
        return max(steps - least for steps, least in zip(self.ticks, soonest, strict=True))


def command_latency(rig: TrackingRig, *, repeats_n: int = 100) -> CommandLatency:
    """Measure command latency at each instant of the arbiter's period.

    The left joint 1 is nudged to and fro.
    """
    rig.reset()
    nudges = rig.world.robot.home[0] + 0.5 * _NUDGE_RAD * np.array([-1.0, 1.0])
    ticks = []
    for phase in range(rig.period):
        rig.run(_SETTLE_STEPS)
        rig.run_to_tick()
        rig.run(phase)
        rig.target[0] = nudges[phase % 2]
        rig.propose()
        ticks.append(_steps_until_torque(rig))
    wall_us = np.empty(repeats_n)
    for k in range(repeats_n):
        rig.run_to_tick()
        rig.target[0] = nudges[k % 2]
        began_ns = time.perf_counter_ns()
        rig.step()
        wall_us[k] = (time.perf_counter_ns() - began_ns) / 1e3
    return CommandLatency(tuple(ticks), float(np.median(wall_us)))


def _steps_until_torque(rig: TrackingRig) -> int:
    """Return the control steps until a torque changes, at most three periods."""
    changed_nm = _CHANGED_SHARE * rig.supervisor.bounds.tau_step
    steps_max = 3 * rig.period
    for count in range(1, steps_max + 1):
        before = rig.stack.applied.copy()
        rig.stack.step()
        if np.max(np.abs(rig.stack.applied - before)) > changed_nm:
            return count
    return steps_max


class StopResponse(NamedTuple):
    """Response of moving arms to an emergency stop.

    Attributes:
        ticks: Control steps to the reflex `emergency_stop`; 1 is the next, 0 means none.
        rest_s: From the reflex until all joints are below 0.01 rad/s; NaN after 2 s.
        speed_rad_s: Fastest joint at the call.
    """

    ticks: int
    rest_s: float
    speed_rad_s: float


def emergency_stop(rig: TrackingRig, amplitude_rad: float, frequency_hz: float) -> StopResponse:
    """Swing all joints, stop at the fastest instant, and measure until rest."""
    world = rig.world
    start_swing(rig, amplitude_rad, frequency_hz, 1.0 / frequency_hz)
    quarter_period = round(0.25 / (frequency_hz * world.dt))
    rig.run(quarter_period)
    speed_rad_s = float(np.max(np.abs(world.v)))
    ticks = 0
    rig.supervisor.estop("environment check")
    for k in range(1, round(_REST_MAX_S / world.dt) + 1):
        rig.step()
        reflex = rig.supervisor.reflex
        if reflex is None:
            continue
        if ticks == 0 and reflex.name == "emergency_stop":
            ticks = k
        if np.max(np.abs(world.v)) < _STILL_RAD_S:
            return StopResponse(ticks, world.time - reflex.time_s, speed_rad_s)
    return StopResponse(ticks, math.nan, speed_rad_s)
