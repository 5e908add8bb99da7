"""Measurements of motors and engine agreement."""

from contextlib import suppress

import mujoco
import numpy as np

from minidual.control.measurement import Reader
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.addresses import map_joints
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot


def drivable_joints(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Return the arm joints that are hinges with a torque motor."""
    found = []
    for name in robot.joint_names:
        with suppress(UsageError):  # no such joint, no actuator, or a servo
            map_joints(model, [name], torque=True)
            if int(model.joint(name).type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE):
                found.append(name)
    return found


def torque_pulse_mapping(
    world: World,
    supervisor: Supervisor,
    kinematics: Kinematics,
    *,
    tolerance: float = 0.01,
) -> tuple[int, ...]:
    """Return the joint that a one-step torque pulse on each command moves, -1 if none as predicted.

    One step from rest: (M + dt D) dv = dt tau. Coupling can move a neighbour more than the joint.
    """
    robot = world.robot
    n = world.robot.dof
    world.reset()
    predicted = np.linalg.inv(
        kinematics.mass_matrix(robot.home) + world.dt * robot.arm.damping * np.eye(n),
    )
    gravity = kinematics.gravity(robot.home)
    fingers = world.fingers

    def after(tau: Array) -> tuple[Array, Array]:
        world.reset()
        supervisor.reset()
        measurement = Reader(world, supervisor.config).reset()
        try:
            applied = supervisor.guard(measurement, gravity + tau, gravity)
        except ReflexError as error:  # its joint does not move as predicted
            applied = error.tau
        world.command(applied, fingers)
        world.step()
        return world.v, applied

    rest, _ = after(np.zeros(n))
    response = np.empty((n, n))  # acceleration of joint i for 1 Nm on command j
    for j in range(n):
        # A tenth of what the motor can. Gravity already uses part of it; push away from the limit.
        size = 0.1 * float(robot.tau_max[j]) * (-1.0 if gravity[j] > 0.0 else 1.0)
        v, applied = after(size * np.eye(n)[j])
        with np.errstate(invalid="ignore"):  # NaN: no pulse was let through
            response[:, j] = (v - rest) / ((applied[j] - gravity[j]) * world.dt)
    scale = np.abs(predicted).max(axis=0)
    distance = (
        np.abs(response[:, :, None] - predicted[:, None, :]).max(axis=0) / scale
    )  # (command, joint)
    world.reset()
    return tuple(
        int(i) if distance[j, i] <= tolerance else -1 for j, i in enumerate(distance.argmin(axis=1))
    )


def model_agreement(
    world: World,
    kinematics: Kinematics,
    rng: np.random.Generator,
    states_n: int,
) -> dict[str, float]:
    """Compare MuJoCo with Pinocchio at random states.

    Returns:
        Largest absolute difference of `position_m` and `rotation` (TCPs), `inertia_kg_m2` and `bias_nm`.
    """
    robot = world.robot
    rows = world.joints.qvel
    largest: dict[str, float] = dict.fromkeys(
        ("position_m", "rotation", "inertia_kg_m2", "bias_nm"),
        0.0,
    )
    full = np.zeros((world.model.nv, world.model.nv))

    def compare(name: str, a: Array, b: Array) -> None:
        largest[name] = float(np.maximum(largest[name], np.abs(a - b).max()))  # keeps NaN

    for _ in range(states_n):
        q = rng.uniform(robot.q_lower, robot.q_upper)
        v = rng.uniform(-robot.v_max, robot.v_max)
        world.reset(q)
        world.data.qvel[rows] = v
        mujoco.mj_forward(world.model, world.data)
        mujoco.mj_fullM(world.model, world.data, full)
        for T, name in zip(kinematics.tcp_poses(q), robot.tcp_names, strict=True):
            body = world.data.body(name)
            compare("position_m", T[:3, 3], body.xpos)
            compare("rotation", T[:3, :3], body.xmat.reshape(3, 3))
        compare("inertia_kg_m2", full[np.ix_(rows, rows)], kinematics.mass_matrix(q))
        compare("bias_nm", world.data.qfrc_bias[rows], kinematics.bias(q, v))
    world.reset()
    return largest
