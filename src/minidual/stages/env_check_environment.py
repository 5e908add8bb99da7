"""Measurements that tell whether the simulated robot is what the rest of the toolkit takes it for.

Each is a function of a world (or its model) that returns numbers; limits and verdicts are the stage's business.
They touch the world through the interface that every controller uses, so a fault in a map or a motor shows here
first, where it has a name, and not as a grasp that fails for no visible reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.plant.world import World
from minidual.robot.constants import (
    ARMS,
    DOF,
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


def drivable_joints(model: mujoco.MjModel) -> list[str]:
    """Return those of the 14 arm joints that the model has as hinges with a torque motor on them."""
    driven = {
        model.joint(int(model.actuator_trnid[i, 0])).name
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        and int(model.actuator_biastype[i]) == int(mujoco.mjtBias.mjBIAS_NONE)
    }
    hinges = {
        model.joint(i).name for i in range(model.njnt) if int(model.jnt_type[i]) == int(mujoco.mjtJoint.mjJNT_HINGE)
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


def arm_contacts(world: World) -> list[tuple[str, str, float]]:
    """Return the contacts (body, body, distance [m]) in which a link of an arm takes part."""
    prefixes = tuple(f"{arm}_" for arm in ARMS)
    return [pair for pair in world.contact_pairs() if pair[0].startswith(prefixes) or pair[1].startswith(prefixes)]


def model_agreement(world: World, kinematics: Kinematics, rng: np.random.Generator, states_n: int) -> dict[str, float]:
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
