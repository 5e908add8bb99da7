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

_PULSE_SHARE = 0.1
"""Share of a motor's torque limit in a pulse."""


def drivable_joints(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Return the arm joints that are hinges with a torque motor."""
    drivable = []
    for name in robot.joint_names:
        with suppress(UsageError):  # no such joint, no actuator, or a servo
            map_joints(model, [name], torque=True)
            if int(model.joint(name).type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE):
                drivable.append(name)
    return drivable


def torque_pulse_mapping(
    world: World,
    supervisor: Supervisor,
    kinematics: Kinematics,
    *,
    tolerance: float = 0.01,
) -> tuple[int, ...]:
    """Return the joint that a one-step torque pulse on each command moves, -1 for none.

    A joint moves as predicted if all accelerations are those of one step from rest,
    (M + dt D) dv = dt tau, within `tolerance` of the largest. The largest acceleration alone
    does not tell: coupling can move a neighbour more than the joint.
    """
    robot = world.robot
    n = robot.dof
    world.reset()
    damped_inertia = kinematics.mass_matrix(robot.home) + world.dt * robot.arm.damping * np.eye(n)
    predicted = np.linalg.inv(damped_inertia)
    gravity = kinematics.gravity(robot.home)
    rest, _ = _after_one_step(world, supervisor, np.zeros(n), gravity)
    response = np.empty((n, n))  # acceleration of joint i for 1 Nm on command j
    for j in range(n):
        # Gravity takes a part of the motor's torque already: push away from the limit.
        away = -1.0 if gravity[j] > 0.0 else 1.0
        pulse = _PULSE_SHARE * float(robot.tau_max[j]) * away * np.eye(n)[j]
        v, applied = _after_one_step(world, supervisor, pulse, gravity)
        with np.errstate(invalid="ignore"):  # NaN: the supervisor let no pulse through
            response[:, j] = (v - rest) / ((applied[j] - gravity[j]) * world.dt)
    world.reset()
    scale = np.abs(predicted).max(axis=0)
    errors = np.abs(response[:, :, None] - predicted[:, None, :]).max(axis=0)
    relative_errors = errors / scale  # (command, joint)
    nearest = relative_errors.argmin(axis=1)
    return tuple(
        int(i) if relative_errors[j, i] <= tolerance else -1 for j, i in enumerate(nearest)
    )


def _after_one_step(
    world: World,
    supervisor: Supervisor,
    pulse: Array,
    gravity: Array,
) -> tuple[Array, Array]:
    """Apply `gravity + pulse` (n,) [Nm] for one step from rest at home.

    Returns:
        Velocities (n,) [rad/s], and the torques (n,) [Nm] that the supervisor let through.
    """
    world.reset()
    supervisor.reset()
    measurement = Reader(world, supervisor.config).reset()
    fingers = world.fingers
    try:
        applied = supervisor.guard(measurement, gravity + pulse, gravity)
    except ReflexError as error:  # its joint does not move as predicted
        applied = error.tau
    world.command(applied, fingers)
    world.step()
    return world.v, applied


def model_agreement(
    world: World,
    kinematics: Kinematics,
    rng: np.random.Generator,
    states_n: int,
) -> dict[str, float]:
    """Compare MuJoCo with Pinocchio at random states.

    Returns:
        Largest absolute difference of `position_m` and `rotation` (TCPs), `inertia_kg_m2` and
        `bias_nm`.
    """
    robot = world.robot
    rows = world.joints.qvel
    names = ("position_m", "rotation", "inertia_kg_m2", "bias_nm")
    largest: dict[str, float] = dict.fromkeys(names, 0.0)
    full_inertia = np.zeros((world.model.nv, world.model.nv))

    def compare(name: str, a: Array, b: Array) -> None:
        difference = np.abs(a - b).max()
        largest[name] = float(np.maximum(largest[name], difference))  # propagates NaN

    for _ in range(states_n):
        q = rng.uniform(robot.q_lower, robot.q_upper)
        v = rng.uniform(-robot.v_max, robot.v_max)
        world.reset(q)
        world.data.qvel[rows] = v
        mujoco.mj_forward(world.model, world.data)
        mujoco.mj_fullM(world.model, world.data, full_inertia)
        for T_world_tcp, name in zip(kinematics.tcp_poses(q), robot.tcp_names, strict=True):
            body = world.data.body(name)
            compare("position_m", T_world_tcp[:3, 3], body.xpos)
            compare("rotation", T_world_tcp[:3, :3], body.xmat.reshape(3, 3))
        compare("inertia_kg_m2", full_inertia[np.ix_(rows, rows)], kinematics.mass_matrix(q))
        compare("bias_nm", world.data.qfrc_bias[rows], kinematics.bias(q, v))
    world.reset()
    return largest
