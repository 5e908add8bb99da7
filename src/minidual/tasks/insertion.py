"""Insertion: a socket in the left hand and a peg in the right one are put together in the air."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba.core import types

from minidual.config.root import Config, preset
from minidual.config.scene import ObjectConfig, PartConfig
from minidual.registry import rows_beside
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import SIDES, Array, pose
from minidual.tasks import success
from minidual.tasks.task import (
    DOWN,
    Poses,
    Step,
    Task,
    TaskObject,
    Trial,
    level_pose,
    near,
    placement,
)

_VALUES = rows_beside(__file__)
SOCKET = "socket"
PEG = "peg"
HAND_OF: dict[str, str] = dict(zip((SOCKET, PEG), SIDES, strict=True))
CLEARANCE_M = 0.0015
DEPTH_M = 0.03
"""Play of the peg, along x and z; wanted depth of its tip."""
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
_GRASP_M: dict[str, float] = dict(
    zip(HAND_OF, (0.0, -0.06), strict=True),
)  # y; so the hands keep 21 cm apart
_AIM_M = 0.036  # depth to which the peg is driven, and its distance from the mouth before
_BEFORE_M = 0.045
_START_M = (0.45, 0.28)
_GOAL_Z_M = (0.18, 0.26)
_PRESS_M = 0.003  # driven into the mouth so far, the tip presses gently on the rim that it meets
_HOLD_S = 0.3
_BREAKS_N = 40.0
_PALE = (0.55, 0.70, 0.92, 1.0)
_BLUE = (0.13, 0.33, 0.78, 1.0)
_RED = (0.80, 0.20, 0.16, 1.0)


def insertion(config: Config) -> Task:
    """Return the task."""
    (x, y) = _START_M
    across = (_BORE_M + _WALL_M) / 2
    along = _MOUTH_M + _BORE_DEPTH_M / 2
    walls = [
        ((way * across, along, 0.0), (_WALL_M, _BORE_DEPTH_M, _BLOCK_M)) for way in (-1.0, 1.0)
    ]
    walls += [
        ((0.0, along, way * across), (_BORE_M, _BORE_DEPTH_M, _WALL_M)) for way in (-1.0, 1.0)
    ]
    parts = tuple(PartConfig(position_m=at, size_m=size, colour=_PALE) for at, size in walls)
    peg = _body(PEG, _PEG_LENGTH_M, _PEG_M, mass_kg=0.06, colour=_RED, xy_m=(x, -y))
    socket = _body(
        SOCKET,
        _BLOCK_LENGTH_M,
        _BLOCK_M,
        mass_kg=0.12,
        colour=_BLUE,
        xy_m=(x, y),
        parts=parts,
    )
    bodies = {"scene.object": peg, "scene.more": (socket,), "scene.task.start_xy_m": (x, -y)}
    config = preset(config, {**bodies, **_VALUES})
    objects = {
        name: TaskObject(
            body,
            {HAND_OF[name]: pose(DOWN, (0.0, _GRASP_M[name], body.grasp_height_m))},
            touches_m=_TIP_M,
        )
        for name, body in config.scene.objects.items()
    }
    return Task(
        name="insertion",
        instruction="Take the socket with the left hand and the peg with the right one, and put them together in the air.",
        config=config,
        objects=objects,
        success=inserted,
        draw=draw_apart,
        stream="insertion-trial",
        arrange=arrange,
    )


def _body(name: str, length_m: float, width_m: float, **others: Any) -> ObjectConfig:
    size = {"length_m": length_m, "width_m": width_m, "height_m": width_m, "grasp_offset_m": 0.0}
    return ObjectConfig(
        name=name,
        shape="box",
        friction=0.8,
        break_force_n=_BREAKS_N,
        **size,
        **others,
    )


def draw_apart(task: Task, rng: np.random.Generator, widen: float = 1.0) -> tuple[Poses, Poses]:
    """Draw a start on each side, and where in the air they meet."""
    asked = task.scene.task
    start = Poses()
    for name, item in task.objects.items():
        middle = (*(item.body.xy_m or asked.start_xy_m), 0.0)
        start[name] = near(rng, middle, widen * asked.start_range_m, widen * asked.start_range_rad)
    x, y, yaw = near(
        rng,
        (*asked.goal_xy_m, asked.goal_yaw_rad),
        asked.goal_range_m,
        asked.goal_range_rad,
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
    fetch = (Step(phase, SIDES, names) for phase in ("approach", "descend", "close", "lift"))
    touch = goal[PEG] @ _along(_PRESS_M - _AIM_M)
    push = Step("insert", (HAND_OF[PEG],), (PEG, SOCKET), (touch, goal[PEG]))
    yield *fetch, Step("carry", SIDES, names, (before,)), push


def inserted(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    asked = task.scene.task
    bodies = task.scene.objects
    hands = {name: SIDES.index(side) for name, side in HAND_OF.items()}
    return (
        success.Each([success.Level(name, asked.tilt_max_rad) for name in bodies]),
        success.Each(
            [
                success.Whole(n, body.break_pinch_n, body.break_force_n)
                for n, body in bodies.items()
            ],
        ),
        success.Each(
            [success.Held(name, asked.pinch_min_n, hand=hand) for name, hand in hands.items()],
            stage=True,
        ),
        success.Each([success.Stood(name) for name in bodies]),
        success.Each([_Aloft(name, asked.clear_height_m) for name in bodies], stage=True),
        _Mated(asked.clear_height_m),
        success.Arrived(PEG, placement(trial.goal[PEG])[:2], asked.goal_tolerance_m),
        success.OnTime(asked.time_limit_s),
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
    """Return `depth_m` of a peg near a socket, whose block has four walls around the bore, the first on its -x side.

    peg, socket: (k, 8), see `ObjectTruth.solids`.
    """
    turned = np.zeros((3, 3))
    at = np.zeros(3)
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
        for y in (length, length - deep):
            if not abs(at[i] + turned[i, 1] * y) + wide < bore:
                return 0.0
    return max(0.0, deep)


def depth_m(truth: success.Truth) -> float:
    """Return the depth of the tip [m]; 0 unless the peg is inside the bore from mouth to tip."""
    peg = truth[PEG]
    socket = truth[SOCKET]
    if math.dist(peg.xyz, socket.xyz) > 1.2 * (_PEG_LENGTH_M / 2 - _MOUTH_M + _PEG_M):
        return 0.0
    return float(depth_in(*peg.frame, peg.solids, *socket.frame, socket.solids))


@dataclass
class _Aloft(success.AtEnd):
    """At the end."""

    name = "aloft"
    limit_m: float

    def end(self, truth: success.Truth) -> str:
        height = truth[self.object].clearance_m
        limit = self.limit_m
        return (
            ""
            if height > limit
            else f"{1e3 * height:.0f} mm over the table, needs > {1e3 * limit:.0f}"
        )


@dataclass
class _Mated(success.SuccessCondition):
    """The peg enters the bore high up, and stays deep in it."""

    name = "mated"
    stage = True
    height_m: float
    _deepest: float = 0.0
    _force: float = 0.0
    _since: float | None = None

    def observe(self, truth: success.Truth) -> str:
        deep = depth_m(truth)
        self._deepest = max(self._deepest, deep)
        self._since = (
            (truth.time if self._since is None else self._since) if deep >= DEPTH_M else None
        )
        if not deep:
            return ""
        self._force = max(
            self._force,
            math.hypot(*truth[PEG].hand_forces[SIDES.index(HAND_OF[PEG])]),
        )
        low = min(item.clearance_m for item in truth.values())
        return (
            ""
            if low > self.height_m
            else f"the peg enters the bore {1e3 * low:.0f} mm over the table"
        )

    def holds(self, truth: success.Truth) -> bool:
        return self._since is not None and truth.time - self._since >= _HOLD_S

    def end(self, truth: success.Truth) -> str:
        found = f"the tip came {1e3 * self._deepest:.1f} mm deep, and is {1e3 * depth_m(truth):.1f} mm deep at the end"
        return "" if self.holds(truth) else f"{found}; needs {1e3 * DEPTH_M:.0f} mm for {_HOLD_S} s"

    def measured(self, truth: success.Truth) -> dict[str, float]:
        return {"depth_m": depth_m(truth), "insertion_force_max_n": self._force}
