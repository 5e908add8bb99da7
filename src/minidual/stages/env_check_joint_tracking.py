"""How well the joints follow: one after another, in a step, and all at once in a swing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from minidual.control.loop import JointLoop
from minidual.robot.constants import DOF, DOF_PER_ARM, HOME, Q_LOWER, Q_UPPER, V_MAX, Array
from minidual.stages.env_check_environment import arm_contacts

_OPEN = np.ones(2)
_SETTLED_S = 0.2
"""The error after a step is the largest in the last this many seconds: a single instant may lie on a crossing."""

_CONTACTS_EVERY = 10
"""Contacts are named at every so many steps: a touch lasts longer, and names cost more than the step."""


@dataclass(frozen=True)
class Tracking:
    """A reference and what the joints did.

    Attributes:
        t: (T,) [s].
        reference: (T, 14) [rad].
        measured: (T, 14) [rad].
        qpos: (T, nq) state of the whole model, to draw it afterwards.
        contacts: Number of looks, 100 a second, at which an arm touched something.
        start: (14,) [rad] before the first step.
    """

    t: Array
    reference: Array
    measured: Array
    qpos: Array
    contacts: int = 0
    start: Array = field(default_factory=lambda: HOME)

    @property
    def error_norm(self) -> Array:
        """Norm of the 14-D error at each instant (T,) [rad]."""
        return np.linalg.norm(self.reference - self.measured, axis=1)

    @property
    def rms(self) -> float:
        """Root mean square over time of the 14-D error norm [rad]."""
        return float(np.sqrt(np.mean(self.error_norm**2)))

    @property
    def joint_rms(self) -> Array:
        """Root mean square over time of each joint's error (14,) [rad]."""
        return np.sqrt(np.mean((self.reference - self.measured) ** 2, axis=0))

    @property
    def settled(self) -> float:
        """Largest 14-D error norm in the last fifth of a second [rad]."""
        return float(self.error_norm[self.t > self.t[-1] - _SETTLED_S].max())

    @property
    def overshoot(self) -> float:
        """How far any joint went beyond its final reference, coming from its first position [rad]."""
        way = self.reference[-1] - self.measured[0]
        beyond = (self.measured - self.reference[-1]) * np.sign(way)
        return float(max(0.0, beyond[:, np.abs(way) > 1e-9].max(initial=0.0)))


def track(loop: JointLoop, steps: int, drive: Callable[[float], Array], *, contacts: bool = False) -> Tracking:
    """Run `steps` control steps; `drive(t)` commands the loop for time t and returns the desired q (14,)."""
    world = loop.world
    t, wanted, got, qpos = (np.empty((steps, *shape)) for shape in ((), (DOF,), (DOF,), (world.model.nq,)))
    touching, start, q_start = 0, world.time, world.q
    for k in range(steps):
        wanted[k] = drive(world.time - start + world.dt)
        t[k], got[k], qpos[k] = world.time - start, world.q, world.data.qpos
        touching += int(contacts and k % _CONTACTS_EVERY == 0 and bool(arm_contacts(world)))
    return Tracking(t, wanted, got, qpos, touching, q_start)


def step_response(loop: JointLoop, target: Array, duration_s: float) -> Tracking:
    """Reset the arms to home, command posture target (14,) at once and hold it."""
    loop.world.reset()
    loop.reset()

    def drive(_t: float) -> Array:
        loop.step(target, _OPEN)
        return target

    return track(loop, round(duration_s / loop.world.dt), drive)


def outward_step(step_rad: float) -> Array:
    """Return home with joint 1 of both arms turned outwards, with opposite signs (14,)."""
    q = HOME.copy()
    q[0] += step_rad
    q[DOF_PER_ARM] -= step_rad
    return q


def single_joint_steps(loop: JointLoop, step_rad: float, duration_s: float) -> list[Tracking]:
    """Step each joint alone from home, towards its farther limit; return what all joints did, one entry a joint."""
    responses = []
    for j in range(DOF):
        target = HOME.copy()
        target[j] += step_rad if Q_UPPER[j] - HOME[j] > HOME[j] - Q_LOWER[j] else -step_rad
        responses.append(step_response(loop, target, duration_s))
    return responses


def single_joint_errors(loop: JointLoop, step_rad: float, duration_s: float) -> Array:
    """Step each joint alone and return its own worst settled error, others included, (14,) [rad]."""
    return np.array([step.settled for step in single_joint_steps(loop, step_rad, duration_s)])


def sine_reference(amplitude_rad: float, frequency_hz: float, t: float) -> tuple[Array, Array, Array]:
    """Return (q, v, a), each (14,), of all joints swinging about home at once.

    q = home - A cos(w t) starts at rest. The arms swing alike, not mirrored: mirrored, the hands would meet.

    Raises:
        ValueError: The swing leaves a joint's position or velocity limits.
    """
    w = 2.0 * np.pi * frequency_hz
    if (HOME + amplitude_rad > Q_UPPER).any() or (HOME - amplitude_rad < Q_LOWER).any():
        raise ValueError(f"a swing of {amplitude_rad} rad about home leaves the joint limits")
    if (amplitude_rad * w > V_MAX).any():
        raise ValueError(f"a swing of {amplitude_rad} rad at {frequency_hz} Hz leaves the joints' velocity limits")
    swing = np.full(DOF, amplitude_rad)
    return HOME - swing * np.cos(w * t), swing * w * np.sin(w * t), swing * w**2 * np.cos(w * t)


def sine_response(loop: JointLoop, amplitude_rad: float, frequency_hz: float, duration_s: float) -> Tracking:
    """Swing all joints at once about home and return what they did, contacts counted."""
    loop.world.reset(sine_reference(amplitude_rad, frequency_hz, 0.0)[0])
    loop.reset()

    def drive(t: float) -> Array:
        q, v, a = sine_reference(amplitude_rad, frequency_hz, t - loop.world.dt)
        loop.follow(q, v, a, _OPEN)
        return sine_reference(amplitude_rad, frequency_hz, t)[0]

    return track(loop, round(duration_s / loop.world.dt), drive, contacts=True)
