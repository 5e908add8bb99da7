"""Checks of a command that need no posture: shapes, limits, rest at both ends, motion between the samples."""

import math
from typing import NamedTuple

import numpy as np

from minidual.control.commands import (
    Command,
    JointCommand,
    ObjectCommand,
    Reason,
    TrajectoryCommand,
)
from minidual.control.impedance import SQUEEZE_MAX_N, ObjectState
from minidual.control.kernels import apart
from minidual.robot.pair import Array, Robot

OBJECT_MAX = 1.0, 3.0, 5.0, 15.0
"""Speed [m/s], rate of turning [rad/s] and their accelerations; just below the arms' own limits."""
_OBJECT_RATES = (
    ("too_fast", "m/s"),
    ("too_fast", "rad/s"),
    ("too_sharp", "m/s^2"),
    ("too_sharp", "rad/s^2"),
)
_LIMIT_TOLERANCE_RAD = 1e-6
_RATE_TOLERANCE = 1.0 + 1e-6  # the supervisor has none
_ZERO_RAD = 1e-12
_REST_RAD_PER_S = 0.01
_REST_OBJECT = 0.005
_OBJECT_SAMPLES = 61
_SAMPLE_S = 0.1
"""Least number of samples, and longest time between two."""
_JUMP_M = 0.02  # between two samples; a path with bounded jerk stays an order below
_JUMP_RAD = 0.1


def check(command: Command, robot: Robot) -> Reason | None:
    """Return the first reason for refusal, or None."""
    if isinstance(command, ObjectCommand):
        return _common(command) or _object(command)
    if command.group not in robot.groups:
        groups = ", ".join(sorted(robot.groups))
        return "unknown_group", f"no group '{command.group}'; there are {groups}"
    if isinstance(command, TrajectoryCommand):
        return _trajectory(command, robot)
    return _joints(command, robot)


def own_columns(command: TrajectoryCommand, robot: Robot) -> slice:
    """Return the columns of `motion` that the command drives."""
    width = np.shape(command.motion.q)[1]
    return robot.groups[command.group] if width == robot.dof else slice(0, width)


def check_openings(gripper: Array) -> Reason | None:
    """Return why openings (2,) are refused, or None."""
    if np.shape(gripper) != (2,):
        return "wrong_shape", f"gripper {np.shape(gripper)}; it must be (2,)"
    if not np.isfinite(gripper).all():
        return "not_finite", f"gripper {gripper}"
    if gripper.min() < 0.0 or gripper.max() > 1.0:
        return "gripper_out_of_range", f"gripper {gripper}; 0 (closed) to 1 (open)"
    return None


def _common(command: Command) -> Reason | None:
    if not np.isfinite(command.stamp_s):
        return "not_finite", f"gripper {command.gripper}, stamp {command.stamp_s}"
    return check_openings(command.gripper)


def _joints(command: JointCommand, robot: Robot) -> Reason | None:
    joints = robot.groups[command.group]
    width = len(robot.joint_names[joints])
    if np.shape(command.q) != (width,) or np.shape(command.gripper) != (2,):
        shapes = f"q {np.shape(command.q)} and gripper {np.shape(command.gripper)}"
        return "wrong_shape", f"{shapes}; group {command.group} needs ({width},) and (2,)"
    q = np.asarray(command.q, dtype=float)
    return _posture(q[None], joints, robot) or _common(command)


def _posture(q: Array, joints: slice, robot: Robot) -> Reason | None:
    """Check postures (k, m) of some joints."""
    names = robot.joint_names[joints]
    at = " in sample {}" if len(q) > 1 else ""
    finite = np.isfinite(q)
    if not finite.all():
        row, index = np.unravel_index(int(np.argmin(finite)), q.shape)
        return "not_finite", f"{names[index]} = {q[row, index]}{at.format(row)}"
    if np.abs(q).max() < _ZERO_RAD:
        detail = "every joint at 0.0 rad: a source that has not been given its values, or lost them"
        return "all_zero", detail
    lower = robot.q_lower[joints]
    upper = robot.q_upper[joints]
    outside = (q < lower - _LIMIT_TOLERANCE_RAD) | (q > upper + _LIMIT_TOLERANCE_RAD)
    if not outside.any():
        return None
    row, index = np.unravel_index(int(np.argmax(outside)), q.shape)
    value = f"{names[index]} = {q[row, index]:.7f} rad{at.format(row)}"
    return "out_of_limits", f"{value}; {lower[index]:.4f} to {upper[index]:.4f}"


class _Samples(NamedTuple):
    """The driven joints of a trajectory: (k, m) positions, velocities, accelerations, and the joints."""

    q: Array
    v: Array
    a: Array
    dt_s: float
    joints: slice
    names: tuple[str, ...]


def _trajectory(command: TrajectoryCommand, robot: Robot) -> Reason | None:
    motion = command.motion
    shape = np.shape(motion.q)
    joints = robot.groups[command.group]
    widths = tuple(dict.fromkeys((robot.dof, joints.stop - joints.start)))
    if len(shape) != 2 or shape[0] < 2 or shape[1] not in widths:
        needed = f"group {command.group} needs n >= 2 samples of {' or '.join(map(str, widths))}"
        return "wrong_shape", f"trajectory {shape}; {needed}"
    columns = own_columns(command, robot)
    samples = _Samples(
        motion.q[:, columns],
        motion.v[:, columns],
        motion.a[:, columns],
        motion.dt_s,
        joints,
        robot.joint_names[joints],
    )
    reason = _posture(samples.q, joints, robot) or _common(command)
    if reason is not None:
        return reason
    if not (np.isfinite(samples.v).all() and np.isfinite(samples.a).all()):
        return "not_finite", "a velocity or an acceleration of the trajectory"
    return (
        _between_samples(samples, robot)
        or _rests_at_ends(samples)
        or _rates(samples, robot)
        or _consistent(samples, robot)
    )


def _between_samples(samples: _Samples, robot: Robot) -> Reason | None:
    """Check the Bezier points, within which all that lies between the samples is."""
    way = samples.v * samples.dt_s / 3.0
    after = samples.q[:-1] + way[:-1]
    before = samples.q[1:] - way[1:]
    return _posture(np.concatenate([after, before]), samples.joints, robot)


def _rests_at_ends(samples: _Samples) -> Reason | None:
    for place, row in (("starts", 0), ("ends", -1)):
        index = int(np.argmax(np.abs(samples.v[row])))
        speed = samples.v[row, index]
        if abs(speed) > _REST_RAD_PER_S:
            moves = f"{samples.names[index]} at {speed:.3f} rad/s"
            return "not_at_rest", f"the trajectory {place} with {moves}; it must rest there"
    return None


def _rates(samples: _Samples, robot: Robot) -> Reason | None:
    """Compare speeds and accelerations, as stated and from sample to sample, with the joints' limits."""
    return _rate(
        "too_fast",
        "rad/s",
        samples.q,
        samples.v,
        robot.v_max[samples.joints],
        samples,
    ) or _rate(
        "too_sharp",
        "rad/s^2",
        samples.v,
        samples.a,
        robot.a_max[samples.joints],
        samples,
    )


def _rate(
    name: str,
    unit: str,
    values: Array,
    rates: Array,
    limits: Array,
    samples: _Samples,
) -> Reason | None:
    differences = np.abs(np.diff(values, axis=0)).max(axis=0) / samples.dt_s
    largest = np.maximum(differences, np.abs(rates).max(axis=0))
    index = int(np.argmax(largest / limits))
    if largest[index] <= _RATE_TOLERANCE * limits[index]:
        return None
    rate = f"{samples.names[index]} at {largest[index]:.3f} {unit}"
    return name, f"{rate}; limit {limits[index]:.3f}"


def _consistent(samples: _Samples, robot: Robot) -> Reason | None:
    """Check that velocities belong to positions, and the speed between two samples."""
    mean = np.diff(samples.q, axis=0) / samples.dt_s
    ends = samples.v[1:] + samples.v[:-1]
    bend = np.abs(mean - 0.5 * ends).max(axis=0) / robot.a_max[samples.joints]
    if bend.max() > 0.25 * _RATE_TOLERANCE * samples.dt_s:  # more than any course may bend
        name = samples.names[int(np.argmax(bend))]
        return "too_sharp", f"{name}: its velocities do not belong to its positions"
    peak = np.abs(3.0 * mean - ends).max(axis=0) / robot.v_max[samples.joints]
    if peak.max() > _RATE_TOLERANCE:
        name = samples.names[int(np.argmax(peak))]
        return "too_fast", f"{name} at up to {peak.max():.1f} times its limit between two samples"
    return None


def _object(command: ObjectCommand) -> Reason | None:
    duration_s = command.motion.duration_s
    if not (np.isfinite(duration_s) and duration_s > 0.0):
        return "not_finite", f"duration {duration_s} s; it must be finite and > 0"
    samples_n = max(_OBJECT_SAMPLES, math.ceil(duration_s / _SAMPLE_S) + 1)
    step_s = duration_s / (samples_n - 1)
    last: ObjectState | None = None
    for t in np.linspace(0.0, duration_s, samples_n):
        state = command.motion.at(float(t)).copied()
        reason = _object_sample(state, command.squeeze_n(float(t)), t)
        if reason is None:
            reason = _object_motion(last, state, step_s, t)
        if reason is None and t in (0.0, duration_s):
            reason = _object_rests(state, t)
        if reason is not None:
            return reason
        last = state
    return None


def _object_sample(state: ObjectState, squeeze_n: float, t_s: float) -> Reason | None:
    finite = all(np.isfinite(values).all() for values in state)
    if not (finite and np.isfinite(squeeze_n)):
        return "not_finite", f"object path or squeeze at {t_s:.3f} s"
    if not 0.0 <= squeeze_n <= SQUEEZE_MAX_N:
        range_n = f"0 to {SQUEEZE_MAX_N:.0f} N"
        return "squeeze_out_of_range", f"{squeeze_n:.1f} N at {t_s:.3f} s; {range_n}"
    return None


def _object_motion(
    last: ObjectState | None,
    state: ObjectState,
    step_s: float,
    t_s: float,
) -> Reason | None:
    """Compare the motion since the last sample with its twist, and all rates with OBJECT_MAX."""
    mean_speed = 0.0
    if last is not None:
        way = np.empty(6)
        moved_m, _ = apart(state.T_world_object, last.T_world_object, way)
        mean_speed = moved_m / step_s
        jump = way - 0.5 * step_s * (last.twist + state.twist)
        jump_m = float(np.linalg.norm(jump[:3]))
        jump_rad = float(np.linalg.norm(jump[3:]))
        if not (jump_m <= _JUMP_M and jump_rad <= _JUMP_RAD):
            size = f"{1e3 * jump_m:.0f} mm, {jump_rad:.2f} rad by {t_s:.3f} s"
            return "pose_jump", f"{size} that its twist does not explain"
    vectors = np.concatenate([state.twist, state.acceleration]).reshape(4, 3)
    rates = np.linalg.norm(vectors, axis=1).tolist()
    rates[0] = max(mean_speed, rates[0])
    for rate, limit, (name, unit) in zip(rates, OBJECT_MAX, _OBJECT_RATES, strict=True):
        if rate > limit:
            return name, f"object at {rate:.2f} {unit}; limit {limit}"
    return None


def _object_rests(state: ObjectState, t_s: float) -> Reason | None:
    if float(np.abs(state.twist).max()) <= _REST_OBJECT:
        return None
    return "not_at_rest", f"the object moves at {t_s:.3f} s; a path must begin and end at rest"
