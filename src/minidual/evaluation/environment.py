"""Measurements that tell whether the simulated robot is what the rest of the toolkit takes it for.

Each is a function of a world (or its model) that returns numbers; limits and verdicts are the stage's business.
They touch the world through the interface that every controller uses, so a fault in a map or a motor shows here
first, where it has a name, and not as a grasp that fails for no visible reason.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.control.loop import JointLoop
from minidual.robot.constants import (
    ARMS,
    DOF,
    DOF_PER_ARM,
    HOME,
    JOINT_DAMPING,
    JOINT_NAMES,
    Q_LOWER,
    Q_UPPER,
    TAU_MAX,
    V_MAX,
    Array,
)
from minidual.robot.kinematics import Kinematics
from minidual.sim.world import World

_OPEN = np.ones(2)
_SETTLED_S = 0.2
"""The error after a step is the largest in the last this many seconds: a single instant may lie on a crossing."""

_CONTACTS_EVERY = 10
"""Contacts are named at every so many steps: a touch lasts longer, and names cost more than the step."""


def drivable_joints(model: mujoco.MjModel) -> list[str]:
    """Return those of the 14 arm joints that the model has as hinges with a torque motor on them."""
    driven = {
        model.joint(int(model.actuator_trnid[i, 0])).name
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        and int(model.actuator_biastype[i]) == int(mujoco.mjtBias.mjBIAS_NONE)
    }
    hinges = {
        model.joint(i).name
        for i in range(model.njnt)
        if int(model.jnt_type[i]) == int(mujoco.mjtJoint.mjJNT_HINGE)
    }
    return [name for name in JOINT_NAMES if name in driven and name in hinges]


@dataclass(frozen=True)
class Mapping:
    """Which joint each torque command moves.

    Attributes:
        moved: (14,) index of the joint that command j moves, -1 if it moves none as the dynamics predict.
        response: (14, 14) acceleration of joint i for 1 Nm on command j [rad/s^2/Nm].
        error: (14,) largest deviation of each column from the prediction, as a share of its largest entry.
    """

    moved: tuple[int, ...]
    response: Array
    error: Array

    @property
    def mapped(self) -> int:
        """Number of commands that move their own joint."""
        return sum(int(joint == j) for j, joint in enumerate(self.moved))


def torque_pulse_mapping(
    world: World, kinematics: Kinematics, *, pulse_share: float = 0.1, tolerance: float = 0.01
) -> Mapping:
    """Give each torque command a pulse of one step, alone, and see which joint answers.

    The answer to command j must be column j of the inverse inertia matrix. Coupling moves the neighbours too, and
    from some postures more than the joint itself, so comparing columns says what comparing magnitudes cannot.
    One step from rest at home: (M + dt D) dv = dt tau, with the damping D taken implicitly by the integrator.
    """
    world.reset()
    inertia = kinematics.mass_matrix(HOME) + world.dt * JOINT_DAMPING * np.eye(DOF)
    predicted = np.linalg.inv(inertia)
    gravity = kinematics.gravity(HOME)
    fingers = world.data.ctrl[world.fingers.ctrl][::2].copy()

    def velocity_after(tau: Array) -> Array:
        world.reset()
        world.command(gravity + tau, fingers)
        world.step()
        return world.v

    rest = velocity_after(np.zeros(DOF))
    response = np.empty((DOF, DOF))
    for j in range(DOF):
        # Gravity already uses part of the motor; push away from the limit.
        size = pulse_share * float(TAU_MAX[j]) * (-1.0 if gravity[j] > 0.0 else 1.0)
        response[:, j] = (velocity_after(size * np.eye(DOF)[j]) - rest) / (size * world.dt)
    scale = np.abs(predicted).max(axis=0)
    distance = np.abs(response[:, :, None] - predicted[:, None, :]).max(axis=0) / scale  # (command, joint)
    nearest = distance.argmin(axis=1)
    moved = tuple(int(i) if distance[j, i] <= tolerance else -1 for j, i in enumerate(nearest))
    world.reset()
    return Mapping(moved, response, np.diag(distance).copy())


@dataclass(frozen=True)
class Tracking:
    """A reference and what the joints did.

    Attributes:
        t: (T,) [s].
        reference: (T, 14) [rad].
        measured: (T, 14) [rad].
        qpos: (T, nq) state of the whole model, to draw it afterwards.
        contacts: Number of looks, 100 a second, at which an arm touched something.
    """

    t: Array
    reference: Array
    measured: Array
    qpos: Array
    contacts: int = 0

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


def track(
    loop: JointLoop, steps: int, drive: Callable[[float], Array], *, contacts: bool = False
) -> Tracking:
    """Run `steps` control steps; `drive(t)` commands the loop for time t and returns the desired q (14,)."""
    world = loop.world
    t, wanted, got, qpos = (np.empty((steps, *shape)) for shape in ((), (DOF,), (DOF,), (world.model.nq,)))
    touching, start = 0, world.time
    for k in range(steps):
        wanted[k] = drive(world.time - start + world.dt)
        t[k], got[k], qpos[k] = world.time - start, world.q, world.data.qpos
        touching += int(contacts and k % _CONTACTS_EVERY == 0 and bool(arm_contacts(world)))
    return Tracking(t, wanted, got, qpos, touching)


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


def single_joint_errors(loop: JointLoop, step_rad: float, duration_s: float) -> Array:
    """Step each joint alone and return its own worst settled error, others included, (14,) [rad].

    The step goes towards the farther joint limit.
    """
    errors = np.empty(DOF)
    for j in range(DOF):
        target = HOME.copy()
        target[j] += step_rad if Q_UPPER[j] - HOME[j] > HOME[j] - Q_LOWER[j] else -step_rad
        errors[j] = step_response(loop, target, duration_s).settled
    return errors


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
        raise ValueError(
            f"a swing of {amplitude_rad} rad at {frequency_hz} Hz leaves the joints' velocity limits"
        )
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


def arm_contacts(world: World) -> list[tuple[str, str, float]]:
    """Return the contacts (body, body, distance [m]) in which a link of an arm takes part."""
    prefixes = tuple(f"{arm}_" for arm in ARMS)
    return [
        pair for pair in world.contact_pairs() if pair[0].startswith(prefixes) or pair[1].startswith(prefixes)
    ]


def model_agreement(
    world: World, kinematics: Kinematics, rng: np.random.Generator, states_n: int
) -> dict[str, float]:
    """Compare MuJoCo with Pinocchio at random states.

    Returns:
        Largest absolute difference of `position_m` and `rotation` (of both tool centre points), `inertia_kg_m2`
        (mass matrix) and `bias_nm` (Coriolis, centrifugal and gravity torques).
    """
    largest = dict.fromkeys(("position_m", "rotation", "inertia_kg_m2", "bias_nm"), 0.0)
    tcp_bodies = [world.model.body(f"{arm}_panda_hand_tcp").id for arm in ARMS]
    full = np.zeros((world.model.nv, world.model.nv))
    for _ in range(states_n):
        q = rng.uniform(Q_LOWER, Q_UPPER)
        v = rng.uniform(-V_MAX, V_MAX)
        world.reset(q)
        world.data.qvel[world.joints.qvel] = v
        mujoco.mj_forward(world.model, world.data)
        mujoco.mj_fullM(world.model, world.data, full)
        found = {"position_m": 0.0, "rotation": 0.0}
        for T, body in zip(kinematics.tcp_poses(q), tcp_bodies, strict=True):
            position = np.abs(T[:3, 3] - world.data.xpos[body]).max()
            rotation = np.abs(T[:3, :3] - world.data.xmat[body].reshape(3, 3)).max()
            found["position_m"] = max(found["position_m"], float(position))
            found["rotation"] = max(found["rotation"], float(rotation))
        inertia = full[np.ix_(world.joints.qvel, world.joints.qvel)]
        found["inertia_kg_m2"] = float(np.abs(inertia - kinematics.mass_matrix(q)).max())
        bias = world.data.qfrc_bias[world.joints.qvel]
        found["bias_nm"] = float(np.abs(bias - kinematics.bias(q, v)).max())
        largest = {name: max(largest[name], found[name]) for name in largest}
    world.reset()
    return largest


@dataclass(frozen=True)
class StepCost:
    """Wall time of one step [us], the bare physics of the same model in the same run beside it."""

    median_us: float
    p99_us: float
    bare_median_us: float

    @property
    def ratio(self) -> float:
        """Whole step over bare physics."""
        return self.median_us / self.bare_median_us


def control_step_cost(loop: JointLoop, steps_n: int, *, block: int = 50) -> StepCost:
    """Time control and physics of single steps while the arms swing, in turns with bare `mj_step`."""
    world = loop.world
    world.reset()
    loop.reset()
    bare_data = mujoco.MjData(world.model)
    reference = [sine_reference(0.1, 0.5, k * world.dt) for k in range(steps_n)]
    whole, bare = np.empty(steps_n), np.empty(steps_n)
    for start in range(0, steps_n, block):
        stop = min(start + block, steps_n)
        for k in range(start, stop):
            began = time.perf_counter_ns()
            loop.follow(*reference[k], _OPEN)
            whole[k] = time.perf_counter_ns() - began
        mujoco.mj_copyData(bare_data, world.model, world.data)
        for k in range(start, stop):
            began = time.perf_counter_ns()
            mujoco.mj_step(world.model, bare_data)
            bare[k] = time.perf_counter_ns() - began
    world.reset()
    return StepCost(
        float(np.median(whole)) / 1e3, float(np.percentile(whole, 99)) / 1e3, float(np.median(bare)) / 1e3
    )
