"""Tracking, latency and emergency stop of arms under the whole control stack."""

import itertools
import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from minidual.config.root import Config
from minidual.control.commands import JointCommand, TrajectoryCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.robot.trajectory import Trajectory
from minidual.skills.supervised import trial_supervisor

OnStep = Callable[[World], None] | None
_SOURCE = "policy"
_OPEN = np.ones(2)
_WAIT_STEPS = 240
"""Steps within which a requested source gets the arms."""
_STEP_MAX_RAD = 0.5  # the arbiter's bound here: a step response needs a step, not a ramp
_SETTLED_S = 0.2
_CONTACTS_EVERY = 10  # steps between contact checks, each of which costs more than a step
_NUDGE_RAD = 0.02
_CHANGED_SHARE = 0.1  # of the supervisor's torque step (1 Nm): a nudge asks for 0.3 Nm at once, still arms for 0.013
_SETTLE_STEPS = 120
_STILL_RAD_S = 0.01
_REST_MAX_S = 2.0


class TrackingRig:
    """One command source, arbiter, controller, supervisor and world.

    Measuring continues after a stop.

    Attributes:
        target: (n,) [rad], proposed at every arbiter tick.
    """

    def __init__(self, world: World, kinematics: Kinematics, config: Config) -> None:
        self.world = world
        rate_hz = config.teleop.rate_hz
        self.supervisor = trial_supervisor(config.supervisor, world.dt, world.robot)
        arbiter = config.arbiter.model_copy(update={"switch_step_max_rad": _STEP_MAX_RAD})
        self.stack = ControlStack(
            world,
            kinematics,
            arbiter,
            rate_hz=rate_hz,
            supervisor=self.supervisor,
        )
        self.period = self.stack.every
        self._sequence = itertools.count(1)
        self.reset()

    def reset(self, q: Array | None = None) -> None:
        """Start at rest at `q` (n,), by default home, and request the source."""
        self.world.reset(q)
        self.stack.reset()
        self.target = self.world.q
        self._swinging = False
        self.stack.request(_SOURCE)
        for _ in range(_WAIT_STEPS):
            if self.stack.source != _SOURCE:
                self.step()

    @property
    def stopped(self) -> str:
        """The supervisor's reflex, or why the source does not drive; "" if it does."""
        if self.stack.reflex is not None:
            return self.stack.reflex.message
        return (
            ""
            if self.stack.source == _SOURCE
            else f"the arms were not given: the arbiter is {self.stack.state}"
        )

    def propose(self) -> None:
        """Propose the target, stamped now."""
        self.stack.propose(
            _SOURCE,
            JointCommand(self.target.copy(), _OPEN, self.world.time, next(self._sequence)),
        )

    def swing(self, motion: Trajectory) -> None:
        """Start a trajectory from the current posture."""
        self._swinging = True
        self.stack.propose(
            _SOURCE,
            TrajectoryCommand(motion, _OPEN, self.world.time, next(self._sequence)),
        )

    def step(self) -> None:
        """Run one control step; keep the source alive."""
        if self.stack.tick_next and self._swinging:
            self.stack.affirm(_SOURCE)
        elif self.stack.tick_next:
            self.propose()
        with suppress(ReflexError):
            self.stack.step()

    def run(self, steps: int) -> None:
        """Run control steps."""
        for _ in range(steps):
            self.step()

    def run_to_tick(self) -> None:
        """Run until the next step has an arbiter tick."""
        while not self.stack.tick_next:
            self.step()


class Tracking(NamedTuple):
    """Reference and measurement of n joints over T steps.

    Attributes:
        t: (T,) [s].
        reference, measured: (T, n) [rad].
        start: (n,) [rad] before the first step.
        contacts: Checks, every tenth step, with an arm in contact.
        step_us: Median wall time of a step [us].
        stopped: See TrackingRig.
    """

    t: Array
    reference: Array
    measured: Array
    start: Array
    contacts: int = 0
    step_us: float = 0.0
    stopped: str = ""

    @property
    def error_norm(self) -> Array:
        """Error norm of all joints (T,) [rad]."""
        return np.linalg.norm(self.reference - self.measured, axis=1)

    @property
    def rms(self) -> float:
        """RMS of the error norm [rad]."""
        return float(np.sqrt(np.mean(self.error_norm**2)))

    @property
    def settled(self) -> float:
        """Largest error norm in the last 0.2 s [rad]."""
        return float(self.error_norm[self.t > self.t[-1] - _SETTLED_S].max())

    def share(self, joint: int) -> Array:
        """Return a joint's share of its step (T,), 1 at the target."""
        return (self.measured[:, joint] - self.start[joint]) / (
            self.reference[-1, joint] - self.start[joint]
        )


def arm_contacts(world: World) -> list[tuple[str, str, float]]:
    """Return contacts (body, body, distance [m]) of arm links."""
    prefixes = tuple(f"{side}_" for side in world.robot.sides)
    return [
        pair
        for pair in world.contact_pairs()
        if pair[0].startswith(prefixes) or pair[1].startswith(prefixes)
    ]


def track(rig: TrackingRig, reference: Array, on_step: OnStep = None) -> Tracking:
    """Run one control step per row of `reference` (T, n), the posture wanted after it."""
    world = rig.world
    start = rig.world.q
    measured = np.empty_like(reference)
    cost = np.empty(len(reference))
    touching = 0
    for k in range(len(reference)):
        began = time.perf_counter_ns()
        rig.step()
        cost[k] = (time.perf_counter_ns() - began) / 1e3
        measured[k] = world.q
        touching += k % _CONTACTS_EVERY == 0 and bool(arm_contacts(world))
        if on_step is not None:
            on_step(world)
    t = np.arange(1, len(reference) + 1) * np.float64(world.dt)
    return Tracking(t, reference, measured, start, touching, float(np.median(cost)), rig.stopped)


def step_response(rig: TrackingRig, target: Array, duration_s: float) -> Tracking:
    """Reset to home, then command `target` (n,) as a step."""
    rig.reset()
    rig.run_to_tick()
    rig.target = target
    return track(rig, np.tile(target, (round(duration_s / rig.world.dt), 1)))


def outward_step(robot: Robot, step_rad: float) -> Array:
    """Return home with joint 1 of both arms turned outwards (n,)."""
    q = robot.home.copy()
    q[0] += step_rad
    q[robot.dof_per_arm] -= step_rad
    return q


def single_joint_steps(rig: TrackingRig, step_rad: float, duration_s: float) -> list[Tracking]:
    """Step each joint alone from home, towards its farther limit; return one entry per joint."""
    robot = rig.world.robot
    away = np.where(robot.q_upper - robot.home > robot.home - robot.q_lower, step_rad, -step_rad)
    return [step_response(rig, robot.home + alone, duration_s) for alone in np.diag(away)]


def sine_reference(
    robot: Robot,
    amplitude_rad: float,
    rate_hz: float,
    t: float | Array,
) -> tuple[Array, Array, Array]:
    """Return (q, v, a) of all joints swinging about home, each (n,), or (T, n) for `t` (T, 1).

    q = home - A cos(w t), from rest. Arms that were mirrored would meet.

    Raises:
        ValueError: The swing exceeds position or velocity limits.
    """
    w = 2.0 * np.pi * rate_hz
    home = robot.home
    if (home + amplitude_rad > robot.q_upper).any() or (home - amplitude_rad < robot.q_lower).any():
        raise ValueError(f"a swing of {amplitude_rad} rad about home leaves the joint limits")
    if (amplitude_rad * w > robot.v_max).any():
        raise ValueError(
            f"a swing of {amplitude_rad} rad at {rate_hz} Hz leaves the joints' velocity limits",
        )
    swing = np.full(robot.dof, amplitude_rad)
    return home - swing * np.cos(w * t), swing * w * np.sin(w * t), swing * w**2 * np.cos(w * t)


def start_swing(
    rig: TrackingRig,
    amplitude_rad: float,
    frequency_hz: float,
    duration_s: float,
) -> Trajectory:
    """Start a swing of all joints about home, at least `duration_s` long, rest to rest; return it."""
    halves = np.ceil(
        2.0 * frequency_hz * duration_s - 1e-9,
    )  # the swing rests after each half period
    times = np.arange(round(0.5 * halves / (frequency_hz * rig.world.dt)) + 1) * rig.world.dt
    reference = sine_reference(rig.world.robot, amplitude_rad, frequency_hz, times[:, None])
    rig.reset(reference[0][0])
    motion = Trajectory(times, *reference, "both_arms")
    rig.swing(motion)
    return motion


def sine_response(
    rig: TrackingRig,
    swing_rad: float,
    rate_hz: float,
    duration_s: float,
    on_step: OnStep = None,
) -> Tracking:
    """Swing all joints about home."""
    motion = start_swing(rig, swing_rad, rate_hz, duration_s)
    return track(rig, motion.q[1 : 1 + round(duration_s / rig.world.dt)], on_step)


JointResponse = dict[str, Any]
"""Response of one joint.

`joint`; `step_rad`, signed size of its step; `rise_s`, 10 % to 90 %, NaN if never reached; `overshoot_rad` beyond the
target; `settled_rad`, largest error norm of all joints in the last 0.2 s; `sine_rms_rad` and `sine_peak_rad`, error in
the swing.
"""


def joint_responses(robot: Robot, steps: list[Tracking], sine: Tracking) -> list[JointResponse]:
    """Return one row per joint."""
    errors = sine.reference - sine.measured
    rows = []
    for j, step in enumerate(steps):
        way = float(step.reference[-1, j] - step.start[j])
        share = step.share(j)
        first = share >= 0.1
        last = share >= 0.9
        rise_s = (
            float(step.t[np.argmax(last)] - step.t[np.argmax(first)]) if last.any() else math.nan
        )
        row = {"joint": robot.joint_names[j], "step_rad": way, "rise_s": rise_s}
        row |= {
            "overshoot_rad": max(0.0, float(np.max(share) - 1.0) * abs(way)),
            "settled_rad": step.settled,
        }
        row |= {"sine_rms_rad": float(np.sqrt(np.mean(errors[:, j] ** 2)))}
        rows.append(row | {"sine_peak_rad": float(np.abs(errors[:, j]).max())})
    return rows


class CommandLatency(NamedTuple):
    """Latency of commands.

    Attributes:
        ticks: Control steps from `propose` to the first changed torque, by instant after an arbiter tick: at best 1,
            then one period down to 2.
        wall_us: Median wall time of `propose` and the step with the arbiter tick [us].
    """

    ticks: tuple[int, ...]
    wall_us: float

    @property
    def late_steps(self) -> int:
        """Largest delay beyond the arbiter's tick."""
        return max(
            found - (len(self.ticks) - k if k else 0) - 1 for k, found in enumerate(self.ticks)
        )


def command_latency(rig: TrackingRig, *, repeats_n: int = 100) -> CommandLatency:
    """Measure command latency at each instant of the arbiter's period, by nudging the left joint 1."""
    rig.reset()
    nudges = rig.world.robot.home[0] + 0.5 * _NUDGE_RAD * np.array([-1.0, 1.0])
    ticks = []
    wall = np.empty(repeats_n)
    for phase in range(rig.period):
        rig.run(_SETTLE_STEPS)
        rig.run_to_tick()
        rig.run(phase)
        rig.target[0] = nudges[phase % 2]
        rig.propose()
        ticks.append(_steps_until_torque(rig))
    for k in range(repeats_n):
        rig.run_to_tick()
        rig.target[0] = nudges[k % 2]
        began = time.perf_counter_ns()
        rig.step()
        wall[k] = (time.perf_counter_ns() - began) / 1e3
    return CommandLatency(tuple(ticks), float(np.median(wall)))


def _steps_until_torque(rig: TrackingRig) -> int:
    changed_nm = _CHANGED_SHARE * rig.supervisor.bounds.tau_step
    for count in range(1, 3 * rig.period + 1):
        before = rig.stack.applied.copy()
        rig.stack.step()
        if np.max(np.abs(rig.stack.applied - before)) > changed_nm:
            return count
    return 3 * rig.period


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
    rig.run(round(0.25 / (frequency_hz * world.dt)))
    speed = float(np.max(np.abs(world.v)))
    ticks = 0
    rig.supervisor.estop("environment check")
    for k in range(1, round(_REST_MAX_S / world.dt) + 1):
        rig.step()
        reflex = rig.supervisor.reflex
        if ticks == 0 and reflex is not None and reflex.name == "emergency_stop":
            ticks = k
        if reflex is not None and np.max(np.abs(world.v)) < _STILL_RAD_S:
            return StopResponse(ticks, world.time - reflex.time_s, speed)
    return StopResponse(ticks, math.nan, speed)
