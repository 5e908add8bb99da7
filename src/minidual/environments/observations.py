"""Observations by name: the terms of which a policy's input is made.

A term is a function of `ObservationInputs`, scaled so that usual values lie within +-1; all are
clipped to +-5.
Terms of the truth are labelled `privileged`: for critics and measurements, never for a policy that
runs. Other distributions add rows through the entry point group `minidual.observations`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.environments.actions import Actions
from minidual.environments.senses import Sensed, hand_yaw, nearest_turn, yaw_of
from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.robot.pair import Array, Robot
from minidual.tasks.task import Task

CLIP = 5.0
_FINE_M = 0.02
"""Distance in which a fine copy of a distance saturates."""


class Truth(NamedTuple):
    """True state, for terms that are privileged.

    Attributes:
        objects: Poses (N, k, 4, 4).
        twist: Of the first object (N, 6).
        pinch_n: Of the weaker finger of each hand (N, 2).
        offset: Offset (N, 6) of the pose sensor [m, rad].
    """

    objects: Array
    twist: Array
    pinch_n: Array
    offset: Array


class ObservationInputs(NamedTuple):
    """What terms are computed from.

    Attributes:
        sensed: Readings.
        actions: The action in force.
        task: What is to be done.
        truth: For privileged terms; None for a policy that runs.
    """

    sensed: Sensed
    actions: Actions
    task: Task
    truth: Truth | None = None


class Term(NamedTuple):
    """One row.

    Attributes:
        size: Numbers for a robot.
        unit: What 1 stands for.
        read: Returns (N, size).
        privileged: Whether it reads the truth.
    """

    size: Callable[[Robot], int]
    unit: str
    read: Callable[[ObservationInputs], Array]
    privileged: bool = False


def _joints(inputs: ObservationInputs) -> Array:
    robot = inputs.actions.arms.robot
    middle = 0.5 * (robot.q_lower + robot.q_upper)
    return (inputs.sensed.q - middle) / (0.5 * (robot.q_upper - robot.q_lower))


def _joint_torques(inputs: ObservationInputs) -> Array:
    return inputs.sensed.torque / inputs.actions.arms.robot.tau_max


def _grippers(inputs: ObservationInputs) -> Array:
    return np.concatenate([inputs.sensed.gripper, inputs.actions.opening], axis=1)


def _grip_forces(inputs: ObservationInputs) -> Array:
    return inputs.sensed.grip_n / 60.0


def _hand_wrenches(inputs: ObservationInputs) -> Array:
    scale = np.repeat([20.0, 2.0], 3)
    return (inputs.sensed.wrench / scale).reshape(len(inputs.sensed.q), -1)


def _hands(inputs: ObservationInputs) -> Array:
    Ts = inputs.sensed.hands
    yaw = hand_yaw(Ts)[..., None]
    rows = np.concatenate([2.0 * Ts[..., :3, 3], yaw - np.pi / 2.0], axis=2)
    return rows.reshape(len(Ts), -1)


def _leads(inputs: ObservationInputs) -> Array:
    """Return how far the targets of the hands are ahead of them, in the object's directions."""
    hands = inputs.sensed.hands
    target = inputs.actions.hands
    ahead = target[..., :3, 3] - hands[..., :3, 3]
    turn = nearest_turn(hand_yaw(target) - hand_yaw(hands))
    along = _in_plane(ahead, _yaw(inputs)[:, None])
    rows = np.concatenate([10.0 * along, 10.0 * ahead[..., 2:], 5.0 * turn[..., None]], axis=2)
    return rows.reshape(len(hands), -1)


def _sensed_object(inputs: ObservationInputs) -> Array:
    T = inputs.sensed.objects[:, 0]
    yaw = _yaw(inputs)
    return np.concatenate([2.0 * T[:, :3, 3], np.stack([np.cos(yaw), np.sin(yaw)], axis=1)], axis=1)


def _to_grasps(inputs: ObservationInputs) -> Array:
    """Return where each hand is as seen from its grasp, coarse and fine.

    The height of an object that stands is known: only its sensed rise counts.
    """
    sensed = inputs.sensed
    body = inputs.task.objects[inputs.task.carried]
    place = sensed.objects[:, 0, :3, 3].copy()
    place[:, 2] = body.body.rest_height_m + _rise(inputs)
    yaw = _yaw(inputs)
    rows: list[Array] = []
    for hand, side in enumerate(inputs.actions.arms.robot.sides):
        T_grasp = body.grasps[side]
        away = sensed.hands[:, hand, :3, 3] - place
        across = _in_plane(away, yaw) - T_grasp[:2, 3]
        above = away[:, 2:] - T_grasp[2, 3]
        grasp_yaw = yaw + hand_yaw(T_grasp)
        turn = nearest_turn(hand_yaw(sensed.hands[:, hand]) - grasp_yaw)
        off = np.concatenate([across, above], axis=1)
        rows += [5.0 * off, 2.0 * turn[:, None], np.tanh(off / _FINE_M)]
    return np.concatenate(rows, axis=1)


def _to_goal(inputs: ObservationInputs) -> Array:
    sensed = inputs.sensed
    yaw = _yaw(inputs)
    way = sensed.goal[:, :2] - sensed.objects[:, 0, :2, 3]
    along = _in_plane(way, yaw)
    symmetry = inputs.task.objects[inputs.task.carried].symmetry
    turn = nearest_turn(sensed.goal[:, 2] - yaw, symmetry)
    turns = np.stack([2.0 * turn, 2.0 * yaw], axis=1)
    return np.concatenate([5.0 * along, np.tanh(along / 0.03), turns], axis=1)


def _height(inputs: ObservationInputs) -> Array:
    rise = _rise(inputs)
    highest = np.minimum(inputs.sensed.highest_m, 0.15)
    return np.stack([10.0 * rise, np.tanh(rise / 0.01), 10.0 * highest], axis=1)


def _tilt(inputs: ObservationInputs) -> Array:
    return 20.0 * inputs.sensed.objects[:, 0, :2, 2]


def _time(inputs: ObservationInputs) -> Array:
    return inputs.sensed.time_s[:, None] / 10.0


def _relative_pose(inputs: ObservationInputs) -> Array:
    """Return the second object's pose in the first one, sensed: position and two of its axes."""
    objects = inputs.sensed.objects
    return _pose_between(objects[:, 0], objects[:, 1])


def _true_relative_pose(inputs: ObservationInputs) -> Array:
    truth = _truth(inputs)
    return _pose_between(truth.objects[:, 0], truth.objects[:, 1])


def _true_object(inputs: ObservationInputs) -> Array:
    truth = _truth(inputs)
    T = truth.objects[:, 0]
    yaw = yaw_of(T)
    turns = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return np.concatenate([2.0 * T[:, :3, 3], turns, 20.0 * T[:, :2, 2], truth.twist], axis=1)


def _true_pinch(inputs: ObservationInputs) -> Array:
    return _truth(inputs).pinch_n / 60.0


def _true_offset(inputs: ObservationInputs) -> Array:
    scale = np.repeat([0.01, 0.03], 3)
    return _truth(inputs).offset / scale


def _truth(inputs: ObservationInputs) -> Truth:
    if inputs.truth is None:
        raise UsageError(
            "a privileged term of the observation needs the truth, which a method has not"
        )
    return inputs.truth


def _yaw(inputs: ObservationInputs) -> Array:
    return yaw_of(inputs.sensed.objects[:, 0])


def _rise(inputs: ObservationInputs) -> Array:
    return inputs.sensed.objects[:, 0, 2, 3] - inputs.sensed.first[:, 0, 2, 3]


def _in_plane(vectors: Array, yaw: Array) -> Array:
    """Return the horizontal parts (..., 2) of vectors (..., 2 or more) in axes turned by yaws (...)."""
    c = np.cos(yaw)
    s = np.sin(yaw)
    x = vectors[..., 0]
    y = vectors[..., 1]
    return np.stack([c * x + s * y, c * y - s * x], axis=-1)


def _pose_between(T_first: Array, T_second: Array) -> Array:
    R = T_first[:, :3, :3].transpose(0, 2, 1)
    away = np.einsum("nij,nj->ni", R, T_second[:, :3, 3] - T_first[:, :3, 3])
    turned = R @ T_second[:, :3, :3]
    return np.concatenate([10.0 * away, turned[:, :, 0], turned[:, :, 1]], axis=1)


def _fixed(size: int) -> Callable[[Robot], int]:
    return lambda robot: size


def _each_joint(robot: Robot) -> int:
    return robot.dof


OBSERVATIONS: Registry[Term] = Registry(
    "observation",
    {
        "joints": Term(_each_joint, "half of a joint's range, from its middle", _joints),
        "joint_torques": Term(_each_joint, "limit of the motor", _joint_torques),
        "grippers": Term(_fixed(4), "openings, as measured and as told", _grippers),
        "grip_forces": Term(_fixed(2), "60 N", _grip_forces),
        "hand_wrenches": Term(_fixed(12), "20 N and 2 Nm, world axes", _hand_wrenches),
        "hands": Term(_fixed(8), "0.5 m and 1 rad", _hands),
        "leads": Term(_fixed(8), "0.1 m and 0.2 rad", _leads),
        "sensed_object": Term(_fixed(5), "0.5 m; cosine and sine of its yaw", _sensed_object),
        "to_grasps": Term(_fixed(14), "0.2 m, 0.5 rad and, fine, 20 mm", _to_grasps),
        "to_goal": Term(_fixed(6), "0.2 m; fine, 30 mm; 0.5 rad", _to_goal),
        "height": Term(_fixed(3), "0.1 m; fine, 10 mm; highest, 0.1 m", _height),
        "tilt": Term(_fixed(2), "0.05 rad", _tilt),
        "time": Term(_fixed(1), "10 s", _time),
        "relative_pose": Term(_fixed(9), "0.1 m; two axes", _relative_pose),
        "privileged_object": Term(
            _fixed(13), "0.5 m; 0.05 rad; 1 m/s and 1 rad/s", _true_object, privileged=True
        ),
        "privileged_relative_pose": Term(
            _fixed(9), "0.1 m; two axes", _true_relative_pose, privileged=True
        ),
        "privileged_pinch": Term(_fixed(2), "60 N", _true_pinch, privileged=True),
        "privileged_offset": Term(
            _fixed(6), "10 mm and 0.03 rad of the sensor's offset", _true_offset, privileged=True
        ),
    },
    group="minidual.observations",
)
LIFT = ("to_grasps", "leads", "grippers", "grip_forces", "to_goal", "height", "tilt", "time")
"""Terms that a policy of `pot_lift` reads: 40 numbers."""


def size_of(names: Sequence[str], robot: Robot) -> int:
    """Return the length of an observation."""
    return sum(OBSERVATIONS[name].size(robot) for name in names)


def observe(names: Sequence[str], inputs: ObservationInputs) -> npt.NDArray[np.float32]:
    """Return the observation (N, k) of these terms, clipped to +-5; NaN becomes 0."""
    rows = [OBSERVATIONS[name].read(inputs) for name in names]
    values = np.nan_to_num(np.concatenate(rows, axis=1), nan=0.0, posinf=CLIP, neginf=-CLIP)
    return np.clip(values, -CLIP, CLIP).astype(np.float32)
