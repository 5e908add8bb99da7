"""Insertion: a socket in the left hand and a peg in the right one are put together in the air."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numba.core import types

from minidual.config.root import Config, preset
from minidual.config.scene import ObjectConfig, PartConfig
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import SIDES, Array, pose
from minidual.tasks import movement, success
from minidual.tasks.failures import of_limit
from minidual.tasks.task import (
    DOWN,
    Poses,
    Step,
    Task,
    TaskObject,
    Trial,
    check_objects,
    level_pose,
    near,
    placement,
)
from minidual.tasks.truth import Truth

SOCKET = "socket"
PEG = "peg"
HAND_OF: dict[str, str] = dict(zip((SOCKET, PEG), SIDES, strict=True))
CLEARANCE_M = 0.0015
"""Play of the peg in the bore, along x and z."""
DEPTH_M = 0.03
"""Depth that the peg's tip must reach."""
HOLD_S = 0.3
"""Time that it must stay there."""
BREAKS_N = 40.0
"""Force of a hand that breaks peg or socket."""
_FELT_M = 0.0004  # distance at which faces touch: both margins of minidual.plant.model
_PEG_M = 0.022
_PEG_LENGTH_M = 0.20
_TIP_M = (0.0, _PEG_LENGTH_M / 2, 0.0)
_BORE_M = _PEG_M + CLEARANCE_M + 2 * _FELT_M
_BORE_DEPTH_M = 0.045
_WALL_M = 0.010
_BLOCK_M = _BORE_M + 2 * _WALL_M
_BLOCK_LENGTH_M = 0.08
_MOUTH_M = -(_BLOCK_LENGTH_M / 2 + _BORE_DEPTH_M)  # y in the socket's frame
MOUTH = (0.0, _MOUTH_M, 0.0)
"""Middle of the bore's mouth in the socket's frame [m]."""
TIP = _TIP_M
"""Middle of the peg's end that goes in, in the peg's frame [m]."""
_GRASP_Y_M = {SOCKET: 0.0, PEG: -0.06}  # so the hands keep 21 cm apart
_AIM_M = 0.036  # depth to which the peg is driven
_BEFORE_M = 0.045  # distance of its tip from the mouth before the push
_PRESS_M = 0.003  # driven into the mouth so far, the tip presses gently on a rim that it meets
_START_M = (0.45, 0.28)
_GOAL_Z_M = (0.18, 0.26)
_PALE = (0.55, 0.70, 0.92, 1.0)
_BLUE = (0.13, 0.33, 0.78, 1.0)
_RED = (0.80, 0.20, 0.16, 1.0)
_VALUES = {
    "scene.task.start_range_rad": 0.35,
    "scene.task.goal_xy_m": (0.48, -0.045),
    "scene.task.goal_range_m": 0.03,
    "scene.task.goal_range_rad": 0.26,
    "scene.task.clear_height_m": 0.10,
    "scene.task.yaw_tolerance_rad": 0.2618,
    "scene.task.time_limit_s": 20.0,
}


def insertion(config: Config) -> Task:
    """Return the task."""
    x, y = _START_M
    bodies = {
        "scene.object": _peg((x, -y)),
        "scene.more": (_socket((x, y)),),
        "scene.task.start_xy_m": (x, -y),
    }
    config = preset(config, {**bodies, **_VALUES})
    check_objects("insertion", config.scene, (PEG, SOCKET))
    objects: dict[str, TaskObject] = {}
    for name, body in config.scene.objects.items():
        grasp = pose(DOWN, (0.0, _GRASP_Y_M[name], body.grasp_height_m))
        objects[name] = TaskObject(body, {HAND_OF[name]: grasp}, touches_m=_TIP_M)
    take = "Take the socket with the left hand and the peg with the right one"
    return Task(
        name="insertion",
        instruction=f"{take}, and put them together in the air.",
        config=config,
        objects=objects,
        success=inserted,
        draw=draw_apart,
        stream="insertion-trial",
        arrange=arrange,
    )


def _peg(xy_m: tuple[float, float]) -> ObjectConfig:
    return ObjectConfig(
        name=PEG,
        shape="box",
        length_m=_PEG_LENGTH_M,
        width_m=_PEG_M,
        height_m=_PEG_M,
        mass_kg=0.06,
        friction=0.8,
        grasp_offset_m=0.0,
        break_force_n=BREAKS_N,
        colour=_RED,
        xy_m=xy_m,
    )


def _socket(xy_m: tuple[float, float]) -> ObjectConfig:
    """Return a block, with four walls around the bore in front of it; the first on its -x side."""
    from_axis_m = (_BORE_M + _WALL_M) / 2
    along_m = _MOUTH_M + _BORE_DEPTH_M / 2
    beside_m = (_WALL_M, _BORE_DEPTH_M, _BLOCK_M)
    above_m = (_BORE_M, _BORE_DEPTH_M, _WALL_M)
    walls = (
        ((-from_axis_m, along_m, 0.0), beside_m),
        ((from_axis_m, along_m, 0.0), beside_m),
        ((0.0, along_m, -from_axis_m), above_m),
        ((0.0, along_m, from_axis_m), above_m),
    )
    return ObjectConfig(
        name=SOCKET,
        shape="box",
        length_m=_BLOCK_LENGTH_M,
        width_m=_BLOCK_M,
        height_m=_BLOCK_M,
        mass_kg=0.12,
        friction=0.8,
        grasp_offset_m=0.0,
        break_force_n=BREAKS_N,
        colour=_BLUE,
        xy_m=xy_m,
        parts=tuple(
            PartConfig(position_m=position_m, size_m=size_m, colour=_PALE)
            for position_m, size_m in walls
        ),
    )


def draw_apart(task: Task, rng: np.random.Generator, widen: float = 1.0) -> tuple[Poses, Poses]:
    """Draw a start on each side, and where in the air they meet."""
    ranges = task.scene.task
    start = Poses()
    for name, item in task.objects.items():
        x, y = item.body.xy_m or ranges.start_xy_m
        range_m = widen * ranges.start_range_m
        start[name] = near(rng, (x, y, 0.0), range_m, widen * ranges.start_range_rad)
    x, y, yaw = near(
        rng,
        (*ranges.goal_xy_m, ranges.goal_yaw_rad),
        ranges.goal_range_m,
        ranges.goal_range_rad,
    )
    peg = level_pose(x, y, float(rng.uniform(*_GOAL_Z_M)), yaw)
    return start, {PEG: peg, SOCKET: peg @ _along(_PEG_LENGTH_M / 2 - _AIM_M - _MOUTH_M)}


def _along(y_m: float) -> Array:
    return pose(np.eye(3), (0.0, y_m, 0.0))


def arrange(task: Task, trial: Trial, poses: Mapping[str, Array]) -> Iterator[tuple[Step, ...]]:
    """Yield the steps."""
    names = tuple(HAND_OF)
    goal = {name: np.asarray(T) for name, T in trial.goal.items()}
    before = goal | {PEG: goal[PEG] @ _along(-_AIM_M - _BEFORE_M)}
    touch = goal[PEG] @ _along(_PRESS_M - _AIM_M)
    fetch = tuple(Step(phase, SIDES, names) for phase in ("approach", "descend", "close", "lift"))
    yield (
        *fetch,
        Step("carry", SIDES, names, (before,)),
        Step("insert", (HAND_OF[PEG],), (PEG, SOCKET), (touch, goal[PEG])),
    )


def inserted(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    limits = task.scene.task
    bodies = task.scene.objects
    level = [success.Level(name, limits.tilt_max_rad) for name in bodies]
    whole = [
        success.Whole(name, body.break_pinch_n, body.break_force_n) for name, body in bodies.items()
    ]
    held = [
        success.Held(name, limits.pinch_min_n, hand=SIDES.index(side))
        for name, side in HAND_OF.items()
    ]
    high_m = movement.HIGH_SHARE * limits.clear_height_m
    x, y, yaw = placement(trial.goal[PEG])
    return (
        success.Each(level),
        success.Each(whole),
        success.Each(held, stage=True),
        success.Each([movement.Slow(name) for name in bodies]),
        success.Each([movement.Carried(name, high_m) for name in bodies]),
        success.Each([_Aloft(name, limits.clear_height_m) for name in bodies], stage=True),
        _Mated(limits.clear_height_m),
        success.Arrived(PEG, (x, y), limits.goal_tolerance_m),
        success.Turned(PEG, yaw, limits.yaw_tolerance_rad),
        success.OnTime(limits.time_limit_s),
    )


@kernel(types.float64(*(ROWS, VECTOR, ROWS) * 2), heap=True)
def depth_in(
    R_peg: Array,
    p_peg: Array,
    peg: Array,
    R_socket: Array,
    p_socket: Array,
    socket: Array,
) -> float:
    """Return `depth_m` of a peg near a socket (`_socket`).

    R_peg and R_socket (3, 3) are the orientations, p_peg and p_socket (3,) [m] the positions in
    the world; peg and socket (k, 8) are as `ObjectTruth.solids`.
    """
    turned = np.zeros((3, 3))  # orientation of the peg in the socket's frame
    at = np.zeros(3)  # its centre there, relative to the block's centre
    half = peg[0, 3]
    length = peg[0, 4]
    block = socket[0]
    wall = socket[1]
    bore = block[0] - wall[0] - wall[3]
    mouth = wall[1] - wall[4] - block[1]
    for i in range(3):
        for j in range(3):
            at[i] += R_socket[j, i] * (p_peg[j] - p_socket[j])
            for k in range(3):
                turned[i, k] += R_socket[j, i] * R_peg[j, k]
        at[i] += (
            turned[i, 0] * peg[0, 0]
            + turned[i, 1] * peg[0, 1]
            + turned[i, 2] * peg[0, 2]
            - block[i]
        )
    deep = at[1] + turned[1, 1] * length - mouth
    for i in (0, 2):
        wide = half * (abs(turned[i, 0]) + abs(turned[i, 2]))
        for y in (length, length - deep):  # at the tip and at the mouth
            if not abs(at[i] + turned[i, 1] * y) + wide < bore:
                return 0.0
    return max(0.0, deep)


def depth_m(truth: Truth) -> float:
    """Return the depth of the tip [m]; 0 unless the peg is inside the bore from mouth to tip."""
    peg = truth[PEG]
    socket = truth[SOCKET]
    longest_m = _PEG_LENGTH_M / 2 - _MOUTH_M + _PEG_M
    if math.dist(peg.xyz, socket.xyz) > 1.2 * longest_m:
        return 0.0
    return float(depth_in(*peg.frame, peg.solids, *socket.frame, socket.solids))


@dataclass
class _Aloft(success.AtEnd):
    """At the end, the object is over the table."""

    name = "aloft"
    limit_m: float

    def end(self, truth: Truth) -> str:
        height_m = truth[self.object].clearance_m
        if height_m > self.limit_m:
            return ""
        return f"object too low at the end ({of_limit(1e3 * height_m, 1e3 * self.limit_m, 'mm')})"


@dataclass
class _Mated(success.SuccessCondition):
    """The peg enters the bore high up, and stays deep in it."""

    name = "mated"
    stage = True
    height_m: float
    _deepest_m: float = 0.0
    _largest_force_n: float = 0.0
    _deep_since_s: float | None = None

    def observe(self, truth: Truth) -> str:
        tip_depth_m = depth_m(truth)
        self._deepest_m = max(self._deepest_m, tip_depth_m)
        is_deep = tip_depth_m >= DEPTH_M
        if not is_deep:
            self._deep_since_s = None
        elif self._deep_since_s is None:
            self._deep_since_s = truth.time
        if tip_depth_m == 0.0:
            return ""
        peg_hand = SIDES.index(HAND_OF[PEG])
        force_n = math.hypot(*truth[PEG].hand_forces[peg_hand])
        self._largest_force_n = max(self._largest_force_n, force_n)
        lowest_m = min(item.clearance_m for item in truth.values())
        if lowest_m > self.height_m:
            return ""
        return f"the peg enters the bore {1e3 * lowest_m:.0f} mm over the table"

    def holds(self, truth: Truth) -> bool:
        return self._deep_since_s is not None and truth.time - self._deep_since_s >= HOLD_S

    def end(self, truth: Truth) -> str:
        if self.holds(truth):
            return ""
        return (
            f"peg not inserted (its tip came {1e3 * self._deepest_m:.1f} mm deep,"
            f" and is {1e3 * depth_m(truth):.1f} mm deep at the end;"
            f" needs {1e3 * DEPTH_M:.0f} mm for {HOLD_S} s)"
        )

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"depth_m": depth_m(truth), "insertion_force_max_n": self._largest_force_n}
