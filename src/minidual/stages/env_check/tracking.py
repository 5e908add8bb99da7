"""How the arms follow steps and swings."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.pair import Array, Robot
from minidual.robot.trajectory import Trajectory
from minidual.stages.env_check.rig import TrackingRig

type OnStep = Callable[[World], None]
"""Called after each control step; read-only."""
type Contact = tuple[str, str, float]
"""Body, body and their distance [m]."""

_SETTLED_S = 0.2
_CONTACTS_EVERY = 10
"""Steps between contact checks, each of which costs more than a step."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """Reference and measurement of n joints over T steps.

    Attributes:
        t: (T,) [s].
        reference: (T, n) [rad].
        measured: (T, n) [rad].
        start: (n,) [rad] before the first step.
        contacts: Checks, every tenth step, with an arm in contact.
        step_us: Median wall time of a step [us].
        stopped: See `TrackingRig.stopped`.
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
        last = self.t > self.t[-1] - _SETTLED_S
        return float(self.error_norm[last].max())

    def share(self, joint: int) -> Array:
        """Return a joint's share of its step (T,), 1 at the target."""
        start = self.start[joint]
        return (self.measured[:, joint] - start) / (self.reference[-1, joint] - start)


def arm_contacts(world: World) -> list[Contact]:
    """Return the contacts of arm links."""
    prefixes = tuple(f"{side}_" for side in world.robot.sides)
    return [
        (first, second, distance_m)
        for first, second, distance_m in world.contact_pairs()
        if first.startswith(prefixes) or second.startswith(prefixes)
    ]


def track(rig: TrackingRig, reference: Array, on_step: OnStep | None = None) -> Tracking:
    """Run one control step per row of `reference` (T, n), the posture wanted after it."""
    world = rig.world
    start = rig.world.q
    measured = np.empty_like(reference)
    cost_us = np.empty(len(reference))
    contacts = 0
    for k in range(len(reference)):
        began_ns = time.perf_counter_ns()
        rig.step()
        cost_us[k] = (time.perf_counter_ns() - began_ns) / 1e3
        measured[k] = world.q
        if k % _CONTACTS_EVERY == 0 and arm_contacts(world):
            contacts += 1
        if on_step is not None:
            on_step(world)
    return Tracking(
        t=np.arange(1, len(reference) + 1) * np.float64(world.dt),
        reference=reference,
        measured=measured,
        start=start,
        contacts=contacts,
        step_us=float(np.median(cost_us)),
        stopped=rig.stopped,
    )


def step_response(rig: TrackingRig, target: Array, duration_s: float) -> Tracking:
    """Reset to home, then command `target` (n,) as a step."""
    rig.reset()
    rig.run_to_tick()
    rig.target = target
    steps = round(duration_s / rig.world.dt)
    return track(rig, np.tile(target, (steps, 1)))


def outward_step(robot: Robot, step_rad: float) -> Array:
    """Return home with joint 1 of both arms turned outwards (n,)."""
    q = robot.home.copy()
    q[0] += step_rad
    q[robot.dofs[0]] -= step_rad
    return q


def single_joint_steps(rig: TrackingRig, step_rad: float, duration_s: float) -> list[Tracking]:
    """Step each joint alone from home, towards its farther limit; return one entry per joint."""
    robot = rig.world.robot
    upper_is_farther = robot.q_upper - robot.home > robot.home - robot.q_lower
    steps_rad = np.where(upper_is_farther, step_rad, -step_rad)
    return [step_response(rig, robot.home + alone, duration_s) for alone in np.diag(steps_rad)]


def sine_reference(
    robot: Robot,
    amplitude_rad: float,
    rate_hz: float,
    t: float | Array,
) -> tuple[Array, Array, Array]:
    """Return (q, v, a) of all joints swinging about home, each (n,), or (T, n) for `t` (T, 1).

    q = home - A cos(w t), from rest. Both arms swing the same way: mirrored arms would meet.

    Raises:
        UsageError: The swing exceeds position or velocity limits.
    """
    w = 2.0 * np.pi * rate_hz
    home = robot.home
    room_rad = np.minimum(robot.q_upper - home, home - robot.q_lower)
    nearest = int(np.argmin(room_rad))
    if amplitude_rad > room_rad[nearest]:
        raise UsageError(
            f"a swing of {amplitude_rad:g} rad about home leaves the joint limits: "
            f"{robot.joint_names[nearest]} has room for {room_rad[nearest]:.3g} rad",
            remedy="choose another home, or a smaller env_check.sine_amplitude_rad",
        )
    slowest = int(np.argmin(robot.v_max))
    if amplitude_rad * w > robot.v_max[slowest]:
        raise UsageError(
            f"a swing of {amplitude_rad:g} rad at {rate_hz:g} Hz leaves the velocity limits: "
            f"{robot.joint_names[slowest]} turns at {robot.v_max[slowest]:g} rad/s, the swing at "
            f"{amplitude_rad * w:.3g}",
            remedy="choose a smaller env_check.sine_amplitude_rad or sine_frequency_hz",
        )
    amplitudes = np.full(robot.dof, amplitude_rad)
    q = home - amplitudes * np.cos(w * t)
    v = amplitudes * w * np.sin(w * t)
    a = amplitudes * w**2 * np.cos(w * t)
    return q, v, a


def start_swing(
    rig: TrackingRig,
    amplitude_rad: float,
    frequency_hz: float,
    duration_s: float,
) -> Trajectory:
    """Start a swing of all joints about home, at least `duration_s` long, rest to rest.

    Returns:
        The motion, which begins at its first sample.
    """
    # The swing rests after each half period.
    halves = np.ceil(2.0 * frequency_hz * duration_s - 1e-9)
    dt_s = rig.world.dt
    steps = round(0.5 * halves / (frequency_hz * dt_s))
    times = np.arange(steps + 1) * dt_s
    q, v, a = sine_reference(rig.world.robot, amplitude_rad, frequency_hz, times[:, None])
    rig.reset(q[0])
    motion = Trajectory(times, q, v, a, "both_arms")
    rig.swing(motion)
    return motion


def sine_response(
    rig: TrackingRig,
    amplitude_rad: float,
    frequency_hz: float,
    duration_s: float,
    on_step: OnStep | None = None,
) -> Tracking:
    """Swing all joints about home."""
    motion = start_swing(rig, amplitude_rad, frequency_hz, duration_s)
    steps = round(duration_s / rig.world.dt)
    return track(rig, motion.q[1 : 1 + steps], on_step)
