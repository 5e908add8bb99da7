"""Tracking of single joints, a step and a swing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.loop import JointLoop
from minidual.plant.world import World
from minidual.robot.pair import Array, Robot

_OPEN = np.ones(2)
_SETTLED_S = 0.2
_CONTACTS_EVERY = 10
"""Steps between contact checks, whose names cost more than a step; contacts last longer."""


@dataclass(frozen=True)
class Tracking:
    """Reference and measurement of n joints over T steps.

    Attributes:
        t: (T,) [s].
        reference: (T, n) [rad].
        measured: (T, n) [rad].
        qpos: (T, nq) whole model, for drawing.
        contacts: Number of checks, every tenth step, with an arm in contact.
        start: (n,) [rad] before the first step.
    """

    t: Array
    reference: Array
    measured: Array
    qpos: Array
    contacts: int
    start: Array

    @property
    def error_norm(self) -> Array:
        """Error norm of all joints (T,) [rad]."""
        return np.linalg.norm(self.reference - self.measured, axis=1)

    @property
    def rms(self) -> float:
        """RMS of the error norm [rad]."""
        return float(np.sqrt(np.mean(self.error_norm**2)))

    @property
    def joint_rms(self) -> Array:
        """RMS error per joint (n,) [rad]."""
        return np.sqrt(np.mean((self.reference - self.measured) ** 2, axis=0))

    @property
    def settled(self) -> float:
        """Largest error norm in the last 0.2 s [rad]; one instant may be a zero crossing."""
        return float(self.error_norm[self.t > self.t[-1] - _SETTLED_S].max())

    @property
    def overshoot(self) -> float:
        """Largest overshoot of any joint beyond its final reference [rad]."""
        way = self.reference[-1] - self.measured[0]
        beyond = (self.measured - self.reference[-1]) * np.sign(way)
        return float(max(0.0, beyond[:, np.abs(way) > 1e-9].max(initial=0.0)))

    def share(self, joint: int) -> Array:
        """Return a joint's share of its step (T,), 1 at the target."""
        way = self.reference[-1, joint] - self.start[joint]
        return (self.measured[:, joint] - self.start[joint]) / way


def arm_contacts(world: World) -> list[tuple[str, str, float]]:
    """Return contacts (body, body, distance [m]) of arm links."""
    prefixes = tuple(f"{side}_" for side in world.robot.sides)
    return [pair for pair in world.contact_pairs() if pair[0].startswith(prefixes) or pair[1].startswith(prefixes)]


def track(loop: JointLoop, steps: int, drive: Callable[[float], Array], *, contacts: bool = False) -> Tracking:
    """Run `steps` control steps; `drive(t)` commands the loop and returns the desired q (n,)."""
    world = loop.world
    n = world.robot.dof
    t, wanted, got, qpos = (np.empty((steps, *shape)) for shape in ((), (n,), (n,), (world.model.nq,)))
    touching, start, q_start = 0, world.time, world.q
    for k in range(steps):
        wanted[k] = drive(world.time - start + world.dt)
        t[k], got[k], qpos[k] = world.time - start, world.q, world.data.qpos
        touching += int(contacts and k % _CONTACTS_EVERY == 0 and bool(arm_contacts(world)))
    return Tracking(t, wanted, got, qpos, touching, q_start)


def step_response(loop: JointLoop, target: Array, duration_s: float) -> Tracking:
    """Reset to home, then command `target` (n,) as a step."""
    loop.world.reset()
    loop.reset()

    def drive(_t: float) -> Array:
        loop.step(target, _OPEN)
        return target

    return track(loop, round(duration_s / loop.world.dt), drive)


def outward_step(robot: Robot, step_rad: float) -> Array:
    """Return home with joint 1 of both arms turned outwards (n,)."""
    q = robot.home.copy()
    q[0] += step_rad
    q[robot.dof_per_arm] -= step_rad
    return q


def single_joint_steps(loop: JointLoop, step_rad: float, duration_s: float) -> list[Tracking]:
    """Step each joint alone from home, towards its farther limit; return one entry per joint."""
    robot, responses = loop.world.robot, []
    for j in range(robot.dof):
        target = robot.home.copy()
        target[j] += step_rad if robot.q_upper[j] - target[j] > target[j] - robot.q_lower[j] else -step_rad
        responses.append(step_response(loop, target, duration_s))
    return responses


def sine_reference(robot: Robot, amplitude_rad: float, frequency_hz: float, t: float) -> tuple[Array, Array, Array]:
    """Return (q, v, a), each (n,), of all joints swinging about home.

    q = home - A cos(w t) starts at rest. The arms are not mirrored, or the hands would meet.

    Raises:
        ValueError: The swing exceeds position or velocity limits.
    """
    w, home = 2.0 * np.pi * frequency_hz, robot.home
    if (home + amplitude_rad > robot.q_upper).any() or (home - amplitude_rad < robot.q_lower).any():
        raise ValueError(f"a swing of {amplitude_rad} rad about home leaves the joint limits")
    if (amplitude_rad * w > robot.v_max).any():
        raise ValueError(f"a swing of {amplitude_rad} rad at {frequency_hz} Hz leaves the joints' velocity limits")
    swing = np.full(robot.dof, amplitude_rad)
    return home - swing * np.cos(w * t), swing * w * np.sin(w * t), swing * w**2 * np.cos(w * t)


def sine_response(loop: JointLoop, amplitude_rad: float, frequency_hz: float, duration_s: float) -> Tracking:
    """Swing all joints about home, counting contacts."""
    world = loop.world

    def reference(t: float) -> tuple[Array, Array, Array]:
        return sine_reference(world.robot, amplitude_rad, frequency_hz, t)

    def drive(t: float) -> Array:
        loop.follow(*reference(t - world.dt), _OPEN)
        return reference(t)[0]

    world.reset(reference(0.0)[0])
    loop.reset()
    return track(loop, round(duration_s / world.dt), drive, contacts=True)


@dataclass(frozen=True)
class JointResponse:
    """Response of one joint.

    Attributes:
        step_rad: Signed size of its step.
        rise_s: 10 % to 90 % rise time, NaN if never reached.
        overshoot_rad: Overshoot beyond the target.
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


def joint_responses(robot: Robot, steps: Sequence[Tracking], sine: Tracking) -> list[JointResponse]:
    """Return one row per joint."""
    peak = np.abs(sine.reference - sine.measured).max(axis=0)
    rows = []
    for j, step in enumerate(steps):
        way, share = float(step.reference[-1, j] - step.start[j]), step.share(j)
        first, last = share >= 0.1, share >= 0.9
        rise = float(step.t[np.argmax(last)] - step.t[np.argmax(first)]) if last.any() else float("nan")
        overshoot = max(0.0, float(np.max(share) - 1.0) * abs(way))
        rms = float(sine.joint_rms[j])
        rows.append(JointResponse(robot.joint_names[j], way, rise, overshoot, step.settled, rms, float(peak[j])))
    return rows
