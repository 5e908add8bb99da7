"""Sort: four cubes into two bins, each within one arm's reach; cubes of the wrong side are passed by the middle."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.config.root import Config, preset
from minidual.config.scene import MarkConfig, ObjectConfig
from minidual.errors import UsageError
from minidual.registry import rows_beside
from minidual.robot.pair import SIDES, Array, pose
from minidual.tasks import success
from minidual.tasks.task import DOWN, Poses, Step, Task, TaskObject, Trial, level_pose, placement

_ROWS = rows_beside(__file__)
COLOURS = {"red": (0.80, 0.16, 0.14, 1.0), "blue": (0.13, 0.33, 0.78, 1.0)}
SIDE_OF = dict(zip(COLOURS, SIDES, strict=True))
"""Arm that reaches the bin of a colour."""
_WAY = dict(zip(SIDES, (1.0, -1.0), strict=True))  # sign of y on an arm's side
_APART_M = 0.10
_START_M = ((0.38, 0.58), (-0.42, 0.42))
_WRONG_M = 0.15
# Size and centre of a bin, and its places along y. However it stretches, the other arm ends 3 cm before it.
_BIN_M = (0.16, 0.18)
_BIN_XY_M = (0.50, 0.65)
_SLOTS_M = (0.045, -0.045)
# A passed cube is put down this far on its taker's side, at one of these x.
_MIDDLE_M = 0.11
_MIDDLE_X_M = (0.48, 0.40, 0.56)
_ARMS_APART_M = 0.20
_HANDLE = ("approach", "descend", "close", "lift", "carry", "lower", "open", "retreat")
_DRAWS_MAX = 1000


def sort(config: Config) -> Task:
    """Return the task."""
    names = [f"{colour}_{k}" for colour in COLOURS for k in (1, 2)]
    cubes = [
        ObjectConfig(
            name=name,
            colour=COLOURS[name.split("_")[0]],
            xy_m=(0.44, 0.3 - 0.2 * k),
            **_ROWS["cube"],
        )
        for k, name in enumerate(names)
    ]
    marks = tuple(mark for colour in COLOURS for mark in _bin(colour))
    bodies = {"scene.object": cubes[0], "scene.more": tuple(cubes[1:]), "scene.marks": marks}
    config = preset(config, {**bodies, **_ROWS["values"]})
    grasps = dict.fromkeys(SIDES, pose(DOWN, (0.0, 0.0, config.scene.object.grasp_height_m)))
    return Task(
        name="sort",
        instruction="Put the red cubes into the red bin on the left and the blue ones into the blue bin on the right.",
        config=config,
        objects={
            name: TaskObject(body, grasps, symmetry=4)
            for name, body in config.scene.objects.items()
        },
        success=sorted_by_colour,
        draw=draw_cubes,
        stream="sort-trial",
        arrange=arrange,
    )


def _bin(colour: str) -> tuple[MarkConfig, MarkConfig]:
    x, y = _BIN_XY_M
    xy_m = (x, _WAY[SIDE_OF[colour]] * y)
    (along_x, along_y) = _BIN_M
    r, g, b, _ = (0.6 * c + 0.4 for c in COLOURS[colour])
    rim = MarkConfig(
        name=f"{colour}_rim",
        xy_m=xy_m,
        size_m=(along_x + 0.016, along_y + 0.016),
        colour=COLOURS[colour],
    )
    return rim, MarkConfig(name=bin_of(colour), xy_m=xy_m, size_m=_BIN_M, colour=(r, g, b, 1.0))


def bin_of(name: str) -> str:
    """Return the name of the bin of a cube or colour."""
    return f"{name.split('_')[0]}_bin"


def side_of(name: str) -> str:
    """Return the arm that reaches a cube's bin."""
    return SIDE_OF[name.split("_")[0]]


def draw_cubes(task: Task, rng: np.random.Generator, widen: float = 1.0) -> tuple[Poses, Poses]:
    """Draw starts, one or more on the wrong side, and places in the bins; `widen` acts on x.

    Of one colour, the cube nearer its bin is the first: a picture then shows which cube goes where.

    Raises:
        UsageError: No such start was found.
    """
    (x_low, x_high), y_range = _START_M
    middle = (x_low + x_high) / 2
    half = widen * (x_high - x_low) / 2
    bin_x, bin_y = _BIN_XY_M
    goal: Poses = {
        n: (bin_x, _WAY[side_of(n)] * (bin_y + _SLOTS_M[k % 2]), 0.0)
        for k, n in enumerate(task.objects)
    }
    for _ in range(_DRAWS_MAX):
        xy = {
            n: (float(rng.uniform(middle - half, middle + half)), float(rng.uniform(*y_range)))
            for n in goal
        }
        apart = all(math.dist(xy[a], xy[b]) >= _APART_M for a in xy for b in xy if a < b)
        if apart and any(_WAY[side_of(name)] * y < -_WRONG_M for name, (_, y) in xy.items()):
            yaws = rng.uniform(-np.pi / 4, np.pi / 4, size=len(xy)).tolist()
            near = sorted(xy, key=lambda name: -_WAY[side_of(name)] * xy[name][1])
            of = {
                side: iter([xy[name] for name in near if side_of(name) == side]) for side in SIDES
            }
            return {
                name: (*next(of[side_of(name)]), yaw) for name, yaw in zip(xy, yaws, strict=True)
            }, goal
    raise UsageError(
        "the cubes find no start apart from each other",
        remedy="take fewer or smaller objects",
    )


def sorted_by_colour(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    asked = task.scene.task
    marks = {mark.name: mark for mark in task.scene.marks}

    def each(make: type[success.OfObject], *values: float | bool) -> success.Each:
        return success.Each([make(name, *values) for name in task.objects])

    inside = [
        _Inside(name, marks[bin_of(name)], placement(trial.goal[name])[:2]) for name in task.objects
    ]
    released = each(success.Released)
    at_rest = each(success.AtRest, asked.rest_speed_m_per_s)
    ends = list(zip(inside, released.parts, at_rest.parts, strict=True))
    return (
        each(success.Level, asked.tilt_max_rad),
        each(success.Held, asked.pinch_min_n, False),
        each(success.Stood),
        each(success.Rose, asked.clear_height_m),
        success.Each(inside),
        released,
        at_rest,
        *(_Placed(count + 1, ends) for count in range(len(ends))),
        success.OnTime(asked.time_limit_s),
    )


@dataclass
class _Inside(success.OfObject):
    name = "inside"
    mark: MarkConfig
    goal: tuple[float, float]

    def holds(self, truth: success.Truth) -> bool:
        item = truth[self.object]
        (x, y, _), (a, b, _) = item.xyz, item.half_m
        (x_mark, y_mark) = self.mark.xy_m
        (length, width) = self.mark.size_m
        if not (
            (room_x := length / 2 - abs(x - x_mark)) > 0.0 < (room_y := width / 2 - abs(y - y_mark))
        ):
            return False
        c = abs(math.cos(item.yaw_rad))
        s = abs(math.sin(item.yaw_rad))
        return c * a + s * b <= room_x and s * a + c * b <= room_y

    def end(self, truth: success.Truth) -> str:
        x, y, _ = truth[self.object].xyz
        return (
            "" if self.holds(truth) else f"at ({x:.3f}, {y:.3f}) m, not inside the {self.mark.name}"
        )

    def measured(self, truth: success.Truth) -> dict[str, float]:
        return {"goal_error_m": truth[self.object].distance_m(self.goal)}


class _Placed(success.SuccessCondition):
    """Stage: so many objects meet their final conditions."""

    stage = True

    def __init__(self, count: int, ends: Sequence[Sequence[success.SuccessCondition]]) -> None:
        self.name = f"placed_{count}"
        self._count = count
        self._ends = ends

    def reached(self, truth: success.Truth) -> bool:
        placed = [a.holds(truth) and b.holds(truth) and c.holds(truth) for a, b, c in self._ends]
        return sum(placed) >= self._count


class _Job(NamedTuple):
    name: str
    arm: str
    y_from: float
    places: tuple[Array, ...]
    passes: bool = False


def arrange(task: Task, trial: Trial, poses: Mapping[str, Array]) -> Iterator[tuple[Step, ...]]:
    """Yield the steps with both arms at once where they keep apart, then one at a time."""
    for at_once in (True, False):
        yield tuple(_steps(task, trial, poses, at_once))


def _steps(task: Task, trial: Trial, poses: Mapping[str, Array], at_once: bool) -> Iterator[Step]:
    at = dict(poses)
    left = sorted(poses)
    in_middle = set[str]()
    while left:
        found = [_job(task, trial, name, at) for name in left]
        jobs = [[job for job in found if job and job.arm == arm] for arm in SIDES]
        pairs = [pair for pair in itertools.product(*([*row, None] for row in jobs)) if any(pair)]
        chosen = [
            job for job in max(pairs, key=lambda pair: _worth(pair, at_once)) if job is not None
        ]
        hands = tuple(job.arm for job in chosen)
        names = tuple(job.name for job in chosen)
        yield from (
            Step("home", (arm,)) for arm in sorted(in_middle.difference(hands))
        )  # out of the other's way
        choices = range(max(len(job.places) for job in chosen))
        places = tuple(
            {job.name: job.places[min(k, len(job.places) - 1)] for job in chosen} for k in choices
        )
        yield from (
            Step(phase, hands, names, places if phase == "carry" else ()) for phase in _HANDLE
        )
        at |= {job.name: job.places[0] for job in chosen}
        left = sorted(set(left) - {job.name for job in chosen if not job.passes})
        in_middle = {job.arm for job in chosen if job.passes}


def _job(task: Task, trial: Trial, name: str, at: Mapping[str, Array]) -> _Job | None:
    owner = side_of(name)
    rest_m = task.objects[name].body.rest_height_m
    y = at[name].item(1, 3)
    if _WAY[owner] * y > -_WRONG_M:
        x_goal, y_goal, yaw = placement(trial.goal[name])
        return _Job(name, owner, y, (level_pose(x_goal, y_goal, rest_m, yaw),))
    others = [T[:2, 3] for n, T in at.items() if n != name]
    spots = [(x, _WAY[owner] * _MIDDLE_M) for x in _MIDDLE_X_M]
    free = [xy for xy in spots if all(math.dist(xy, other) >= _APART_M for other in others)]
    places = tuple(level_pose(*xy, rest_m, 0.0) for xy in free)
    return _Job(name, SIDES[1 - SIDES.index(owner)], y, places, passes=True) if free else None


def _worth(pair: tuple[_Job | None, _Job | None], at_once: bool) -> tuple[int, int]:
    """Return the numbers of jobs (-1: too close) and of passes."""
    left, right = pair
    passes = sum(job.passes for job in pair if job is not None)
    if left is None or right is None:
        return 1, passes
    apart = (
        min(left.y_from - right.y_from, left.places[0][1, 3] - right.places[0][1, 3])
        >= _ARMS_APART_M
    )
    return (2 if at_once and apart else -1), passes
