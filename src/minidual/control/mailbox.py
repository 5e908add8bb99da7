"""Posture-independent command checks, and the latest valid command of one source, per arm."""

import copy
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from minidual.control.commands import (
    Command,
    JointCommand,
    ObjectCommand,
    Reason,
    TimedCommand,
    TrajectoryCommand,
)
from minidual.control.impedance import SQUEEZE_MAX_N, ObjectState
from minidual.control.kernels import apart
from minidual.robot.pair import Array, Robot

OBJECT_MAX = 1.0, 3.0, 5.0, 15.0
"""Speed [m/s], rate of turning [rad/s] and their accelerations; just below the arms' own limits."""
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
        return (
            "unknown_group",
            f"no group '{command.group}'; there are {', '.join(sorted(robot.groups))}",
        )
    if isinstance(command, TrajectoryCommand):
        return _trajectory(command, robot)
    joints = robot.groups[command.group]
    names = robot.joint_names[joints]
    if np.shape(command.q) != (len(names),) or np.shape(command.gripper) != (2,):
        given = f"q {np.shape(command.q)} and gripper {np.shape(command.gripper)}"
        return "wrong_shape", f"{given}; group {command.group} needs ({len(names)},) and (2,)"
    return _posture(np.asarray(command.q, dtype=float)[None], joints, robot) or _common(command)


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


def _posture(q: Array, joints: slice, robot: Robot) -> Reason | None:
    names = robot.joint_names[joints]
    at = " in sample {}" if len(q) > 1 else ""
    finite = np.isfinite(q)
    if not finite.all():
        row, index = np.unravel_index(int(np.argmin(finite)), q.shape)
        return "not_finite", f"{names[index]} = {q[row, index]}{at.format(row)}"
    if np.abs(q).max() < _ZERO_RAD:
        return (
            "all_zero",
            "every joint at 0.0 rad: a source that has not been given its values, or lost them",
        )
    lower = robot.q_lower[joints]
    upper = robot.q_upper[joints]
    outside = (q < lower - _LIMIT_TOLERANCE_RAD) | (q > upper + _LIMIT_TOLERANCE_RAD)
    if outside.any():
        row, index = np.unravel_index(int(np.argmax(outside)), q.shape)
        value = f"{names[index]} = {q[row, index]:.4f} rad{at.format(row)}"
        return "out_of_limits", f"{value}; {lower[index]:.4f} to {upper[index]:.4f}"
    return None


def _trajectory(command: TrajectoryCommand, robot: Robot) -> Reason | None:
    motion = command.motion
    joints = robot.groups[command.group]
    names = robot.joint_names[joints]
    v_max = robot.v_max[joints]
    shape = np.shape(motion.q)
    widths = (robot.dof,) if command.group == "both_arms" else (robot.dof, robot.dof_per_arm)
    if len(shape) != 2 or shape[0] < 2 or shape[1] not in widths:
        needed = f"group {command.group} needs n >= 2 samples of {' or '.join(map(str, widths))}"
        return "wrong_shape", f"trajectory {shape}; {needed}"
    columns = own_columns(command, robot)
    q = motion.q[:, columns]
    v = motion.v[:, columns]
    a = motion.a[:, columns]
    if (reason := _posture(q, joints, robot) or _common(command)) is not None:
        return reason
    if not (np.isfinite(v).all() and np.isfinite(a).all()):
        return "not_finite", "a velocity or an acceleration of the trajectory"
    way = v * motion.dt_s / 3.0  # what is between the samples lies within these points
    if (
        reason := _posture(np.concatenate([q[:-1] + way[:-1], q[1:] - way[1:]]), joints, robot)
    ) is not None:
        return reason
    for place, row in (("starts", 0), ("ends", -1)):
        index = int(np.argmax(np.abs(v[row])))
        if abs(v[row, index]) > _REST_RAD_PER_S:
            moves = f"{names[index]} at {v[row, index]:.3f} rad/s"
            return "not_at_rest", f"the trajectory {place} with {moves}; it must rest there"
    rates = (
        (q, v, v_max, "too_fast", "rad/s"),
        (v, a, robot.a_max[joints], "too_sharp", "rad/s^2"),
    )
    for x, rate, limit, name, unit in rates:  # as stated, and between samples
        largest = np.maximum(
            np.abs(np.diff(x, axis=0)).max(axis=0) / motion.dt_s,
            np.abs(rate).max(axis=0),
        )
        index = int(np.argmax(largest / limit))
        if largest[index] > _RATE_TOLERANCE * limit[index]:
            return name, f"{names[index]} at {largest[index]:.3f} {unit}; limit {limit[index]:.3f}"
    mean = np.diff(q, axis=0) / motion.dt_s
    ends = v[1:] + v[:-1]
    beside = np.abs(mean - 0.5 * ends).max(axis=0) / robot.a_max[joints]
    if (
        beside.max() > 0.25 * _RATE_TOLERANCE * motion.dt_s
    ):  # more than any course between two samples may bend
        return (
            "too_sharp",
            f"{names[int(np.argmax(beside))]}: its velocities do not belong to its positions",
        )
    peak = np.abs(3.0 * mean - ends).max(axis=0) / v_max
    if peak.max() > _RATE_TOLERANCE:
        return (
            "too_fast",
            f"{names[int(np.argmax(peak))]} at up to {peak.max():.1f} times its limit between two samples",
        )
    return None


def _object(command: ObjectCommand) -> Reason | None:
    duration = command.motion.duration_s
    if not (np.isfinite(duration) and duration > 0.0):
        return "not_finite", f"duration {duration} s; it must be finite and > 0"
    before: ObjectState | None = None
    samples = max(_OBJECT_SAMPLES, math.ceil(duration / _SAMPLE_S) + 1)
    for t in np.linspace(0.0, duration, samples):
        state = command.motion.at(float(t)).copied()
        squeeze = command.squeeze_n(float(t))
        values = (state.T_world_object, state.twist, state.acceleration)
        if not (all(np.isfinite(x).all() for x in values) and np.isfinite(squeeze)):
            return "not_finite", f"object path or squeeze at {t:.3f} s"
        if not 0.0 <= squeeze <= SQUEEZE_MAX_N:
            return (
                "squeeze_out_of_range",
                f"{squeeze:.1f} N at {t:.3f} s; 0 to {SQUEEZE_MAX_N:.0f} N",
            )
        jump_m, jump_rad, mean = (
            (0.0, 0.0, 0.0) if before is None else _moved(before, state, duration / (samples - 1))
        )
        if not (jump_m <= _JUMP_M and jump_rad <= _JUMP_RAD):
            jump = f"{1e3 * jump_m:.0f} mm, {jump_rad:.2f} rad by {t:.3f} s"
            return "pose_jump", f"{jump} that its twist does not explain"
        rates = np.linalg.norm(
            np.concatenate([state.twist, state.acceleration]).reshape(4, 3),
            axis=1,
        ).tolist()
        before = state
        rates[0] = max(mean, rates[0])
        for rate, most, unit in zip(
            rates,
            OBJECT_MAX,
            ("m/s", "rad/s", "m/s^2", "rad/s^2"),
            strict=True,
        ):
            if rate > most:
                return (
                    "too_sharp" if "^2" in unit else "too_fast",
                    f"object at {rate:.2f} {unit}; limit {most}",
                )
        if t in (0.0, duration) and float(np.abs(state.twist).max()) > _REST_OBJECT:
            return (
                "not_at_rest",
                f"the object moves at {t:.3f} s; a path must begin and end at rest",
            )
    return None


def _moved(before: ObjectState, after: ObjectState, span_s: float) -> tuple[float, float, float]:
    """Return how far [m], [rad] the pose has moved beyond the mean twist, and its mean speed [m/s]."""
    moved_m, _ = apart(after.T_world_object, before.T_world_object, way := np.empty(6))
    jump = way - 0.5 * span_s * (before.twist + after.twist)
    return float(np.linalg.norm(jump[:3])), float(np.linalg.norm(jump[3:])), moved_m / span_s


class Mailbox:
    """Keeps the newest command per arm; passes the reason for one that is too late or early to `refuse`."""

    def __init__(self, robot: Robot, refuse: Callable[[str, str], object]) -> None:
        self._robot = robot
        self._refuse = refuse
        self._latest: dict[int, JointCommand] = {}
        self._timed: list[TimedCommand] = []
        self._sequence: int | None = None
        self._not_before_s = float("-inf")

    def put(self, command: Command) -> Reason | None:
        """Accept a command, or return why not."""
        reason = check(command, self._robot)
        if reason is None and command.stamp_s < self._not_before_s:
            stamped = (
                f"stamped {command.stamp_s:.4f} s, before the switch at {self._not_before_s:.4f} s"
            )
            reason = "before_switch", stamped
        if reason is None and self._sequence is not None and command.sequence <= self._sequence:
            reason = "out_of_order", f"sequence {command.sequence} after {self._sequence}"
        if reason is not None:
            return reason
        self._sequence = command.sequence
        command = _own(command)
        arms = set(command.arms)
        self._timed = [c for c in self._timed if not arms & set(c.arms)]
        if isinstance(command, JointCommand):
            for arm in command.arms:
                self._latest[arm] = command
        else:
            for arm in command.arms:
                self._latest.pop(arm, None)
            self._timed.append(command)
        return None

    def flush(self, now_s: float) -> None:
        """Forget all commands and refuse earlier stamps: a late action chunk never runs."""
        self._latest.clear()
        self._timed.clear()
        self._sequence = None
        self._not_before_s = now_s

    def drop(self, arm: int) -> None:
        """Forget an arm's streamed command."""
        self._latest.pop(arm, None)

    def fresh(self, now_s: float, stale_s: float) -> dict[int, JointCommand]:
        """Return each arm's command at most `stale_s` old; stamps over `stale_s` ahead are dropped."""
        due = {arm: c for arm, c in self._latest.items() if self._is_due(c, now_s, stale_s)}
        self._latest = dict(sorted(due.items()))
        return {arm: c for arm, c in self._latest.items() if now_s - c.stamp_s <= stale_s + 1e-9}

    def take_timed(self, now_s: float, stale_s: float) -> list[TimedCommand]:
        """Remove and return the waiting timed commands."""
        waiting = self._timed
        self._timed = []
        taken: list[TimedCommand] = []
        for command in waiting:
            age_s = now_s - command.stamp_s
            if age_s > stale_s + 1e-9:
                self._refuse(
                    "stale",
                    f"{type(command).__name__} is {age_s:.3f} s old; limit {stale_s} s",
                )
            elif self._is_due(command, now_s, stale_s):
                taken.append(command)
        return taken

    def _is_due(self, command: Command, now_s: float, stale_s: float) -> bool:
        ahead_s = command.stamp_s - now_s
        if ahead_s > stale_s:
            stamped = f"stamped {command.stamp_s:.4f} s, {ahead_s:.4f} s ahead of the clock"
            self._refuse("from_future", f"{type(command).__name__}: {stamped}")
        return ahead_s <= stale_s


def _own(command: Command) -> Command:
    if isinstance(command, ObjectCommand):
        return replace(command, gripper=np.array(command.gripper, dtype=float))
    return copy.deepcopy(command)
