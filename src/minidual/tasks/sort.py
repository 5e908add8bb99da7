"""Sort: four cubes onto two painted fields, each within one arm's reach.

Cubes of the wrong side are passed by the middle.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.config.root import Config, preset
from minidual.config.scene import MarkConfig, ObjectConfig
from minidual.errors import UsageError
from minidual.robot.pair import SIDES, Array, pose
from minidual.tasks import movement, success
from minidual.tasks.task import (
    DOWN,
    Placement,
    Poses,
    Step,
    Task,
    TaskObject,
    Trial,
    check_objects,
    level_pose,
    placement,
)
from minidual.tasks.truth import Truth

COLOURS = {"red": (0.80, 0.16, 0.14, 1.0), "blue": (0.13, 0.33, 0.78, 1.0)}
SIDE_OF = dict(zip(COLOURS, SIDES, strict=True))
"""Arm that reaches the field of a colour."""
_SIGN_OF = dict(zip(SIDES, (1.0, -1.0), strict=True))  # sign of y on an arm's side
_CUBE_M = 0.04
_APART_M = 0.10
_START_X_M = (0.38, 0.58)
_START_Y_M = (-0.42, 0.42)
_WRONG_M = 0.15
# Size and centre of a field, and its places along y. However it stretches, the other arm ends 3 cm
# before it.
_BIN_M = (0.16, 0.18)
_BIN_XY_M = (0.50, 0.65)
_RIM_M = 0.016
_SLOTS_M = (0.045, -0.045)
# A passed cube is put down this far on its taker's side, at one of these x.
_MIDDLE_M = 0.11
_MIDDLE_X_M = (0.48, 0.40, 0.56)
_ARMS_APART_M = 0.20
_HANDLE = ("approach", "descend", "close", "lift", "carry", "lower", "open", "retreat")
_DRAWS_MAX = 1000
_VALUES = {
    "scene.task.lift_height_m": 0.10,
    "scene.task.tilt_max_rad": 0.20,
    "scene.task.time_limit_s": 48.0,
    # The fields lie far to the sides.
    "scene.camera.width_px": 192,
}

type _Xy = tuple[float, float]


def sort(config: Config) -> Task:
    """Return the task."""
    names = [f"{colour}_{number}" for colour in COLOURS for number in (1, 2)]
    first, *more = [_cube(name, (0.44, 0.3 - 0.2 * k)) for k, name in enumerate(names)]
    marks = tuple(mark for colour in COLOURS for mark in _bin(colour))
    bodies = {"scene.object": first, "scene.more": tuple(more), "scene.marks": marks}
    config = preset(config, {**bodies, **_VALUES})
    check_objects("sort", config.scene, names)
    grasps = dict.fromkeys(SIDES, pose(DOWN, (0.0, 0.0, config.scene.object.grasp_height_m)))
    put = "Put the red cubes on the red field on the left"
    return Task(
        name="sort",
        instruction=f"{put} and the blue ones on the blue field on the right.",
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


def _cube(name: str, xy_m: _Xy) -> ObjectConfig:
    return ObjectConfig(
        name=name,
        shape="box",
        upright=True,
        length_m=_CUBE_M,
        width_m=_CUBE_M,
        height_m=_CUBE_M,
        mass_kg=0.06,
        friction=0.8,
        grasp_offset_m=0.0,
        colour=COLOURS[colour_of(name)],
        xy_m=xy_m,
    )


def _bin(colour: str) -> tuple[MarkConfig, MarkConfig]:
    """Return the border and the inner area of a colour's field, painted on the table."""
    x, y = _BIN_XY_M
    xy_m = (x, _SIGN_OF[SIDE_OF[colour]] * y)
    length_m, width_m = _BIN_M
    red, green, blue, _ = (0.6 * share + 0.4 for share in COLOURS[colour])
    rim = MarkConfig(
        name=f"{colour}_rim",
        xy_m=xy_m,
        size_m=(length_m + _RIM_M, width_m + _RIM_M),
        colour=COLOURS[colour],
    )
    floor = MarkConfig(
        name=bin_of(colour),
        xy_m=xy_m,
        size_m=_BIN_M,
        colour=(red, green, blue, 1.0),
    )
    return rim, floor


def colour_of(name: str) -> str:
    """Return the colour of a cube."""
    return name.split("_")[0]


def bin_of(name: str) -> str:
    """Return the name of the mark of a cube or colour."""
    return f"{colour_of(name)}_bin"


def side_of(name: str) -> str:
    """Return the arm that reaches a cube's field."""
    return SIDE_OF[colour_of(name)]


def draw_cubes(task: Task, rng: np.random.Generator, widen: float = 1.0) -> tuple[Poses, Poses]:
    """Draw starts, one or more on the wrong side, and places on the fields; `widen` acts on x.

    Raises:
        UsageError: No such start was found.
    """
    names = tuple(task.objects)
    goal = {name: _bin_place(name, _SLOTS_M[k % 2]) for k, name in enumerate(names)}
    low_m, high_m = _START_X_M
    middle_m = (low_m + high_m) / 2
    half_m = widen * (high_m - low_m) / 2
    for _ in range(_DRAWS_MAX):
        xy: dict[str, _Xy] = {}
        for name in names:
            x = float(rng.uniform(middle_m - half_m, middle_m + half_m))
            y = float(rng.uniform(*_START_Y_M))
            xy[name] = (x, y)
        if _keep_apart(xy) and any(_on_the_wrong_side(name, y) for name, (_, y) in xy.items()):
            yaws: list[float] = rng.uniform(-np.pi / 4, np.pi / 4, size=len(names)).tolist()
            start: Poses = {}
            for (name, (x, y)), yaw in zip(_nearest_first(xy).items(), yaws, strict=True):
                start[name] = (x, y, yaw)
            return start, dict(goal)
    raise UsageError(
        "the cubes find no start apart from each other",
        remedy="take fewer or smaller objects",
    )


def _bin_place(name: str, slot_m: float) -> Placement:
    x, y = _BIN_XY_M
    return x, _SIGN_OF[side_of(name)] * (y + slot_m), 0.0


def _keep_apart(xy: Mapping[str, _Xy]) -> bool:
    return all(math.dist(a, b) >= _APART_M for a, b in itertools.combinations(xy.values(), 2))


def _on_the_wrong_side(name: str, y: float) -> bool:
    """Return whether the arm that reaches the cube's field does not reach the cube."""
    return _SIGN_OF[side_of(name)] * y < -_WRONG_M


def _nearest_first(xy: Mapping[str, _Xy]) -> dict[str, _Xy]:
    """Return the same places; of one colour, the first cube has the one nearest its field.

    A picture then shows which cube goes where.
    """
    places = {side: [xy[name] for name in xy if side_of(name) == side] for side in SIDES}
    for side, of_side in places.items():
        of_side.sort(key=lambda at, sign=_SIGN_OF[side]: -sign * at[1])
    return {name: places[side_of(name)].pop(0) for name in xy}


def sorted_by_colour(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    limits = task.scene.task
    names = tuple(task.objects)
    marks = {mark.name: mark for mark in task.scene.marks}
    inside: list[_Inside] = []
    for name in names:
        x, y, _ = placement(trial.goal[name])
        inside.append(_Inside(name, marks[bin_of(name)], (x, y)))
    high_m = movement.HIGH_SHARE * limits.clear_height_m
    brought = [
        movement.BroughtBy(name, SIDES.index(side_of(name)), limits.pinch_min_n) for name in names
    ]
    released = [success.Released(name) for name in names]
    at_rest = [success.AtRest(name, limits.rest_speed_m_per_s) for name in names]
    final = list(zip(inside, released, at_rest, strict=True))
    return (
        success.Each([success.Level(name, limits.tilt_max_rad) for name in names]),
        success.Each([success.Held(name, limits.pinch_min_n, both=False) for name in names]),
        success.Each([movement.Slow(name) for name in names]),
        success.Each([movement.Carried(name, high_m) for name in names]),
        success.Each([success.Rose(name, limits.clear_height_m) for name in names]),
        success.Each(brought),
        success.Each(inside),
        success.Each(released),
        success.Each([movement.Settled(name, high_m) for name in names]),
        success.Each(at_rest),
        *(_Placed(count, final) for count in range(1, len(names) + 1)),
        success.OnTime(limits.time_limit_s),
    )


@dataclass
class _Inside(success.OfObject):
    """The cube lies inside its field, whatever its yaw."""

    name = "inside"
    mark: MarkConfig
    goal: _Xy

    def holds(self, truth: Truth) -> bool:
        item = truth[self.object]
        x, y, _ = item.xyz
        half_x, half_y, _ = item.half_m
        x_mark, y_mark = self.mark.xy_m
        length_m, width_m = self.mark.size_m
        room_x = length_m / 2 - abs(x - x_mark)
        room_y = width_m / 2 - abs(y - y_mark)
        if not (room_x > 0.0 and room_y > 0.0):
            return False
        c = abs(math.cos(item.yaw_rad))
        s = abs(math.sin(item.yaw_rad))
        return c * half_x + s * half_y <= room_x and s * half_x + c * half_y <= room_y

    def end(self, truth: Truth) -> str:
        if self.holds(truth):
            return ""
        x, y, _ = truth[self.object].xyz
        colour = colour_of(self.object)
        return f"object not wholly on the {colour} field (its centre is at {x:.3f}, {y:.3f} m)"

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"goal_error_m": truth[self.object].distance_m(self.goal)}


class _Placed(success.SuccessCondition):
    """Stage: so many objects meet all their final conditions."""

    stage = True

    def __init__(
        self,
        count: int,
        final: Sequence[tuple[success.SuccessCondition, ...]],
    ) -> None:
        self.name = f"placed_{count}"
        self._count = count
        self._final = final

    def reached(self, truth: Truth) -> bool:
        placed_n = 0
        for conditions in self._final:
            placed_n += all(condition.holds(truth) for condition in conditions)
        return placed_n >= self._count


class _Job(NamedTuple):
    """A cube to be moved by one arm, from y to one of `places`.

    Attributes:
        passes: Whether it is put down in the middle for the other arm.
    """

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
    remaining = sorted(poses)
    in_middle = set[str]()  # arms that have just passed a cube
    while remaining:
        jobs = _next_jobs(task, trial, remaining, at, at_once)
        hands = tuple(job.arm for job in jobs)
        names = tuple(job.name for job in jobs)
        for arm in sorted(in_middle.difference(hands)):
            yield Step("home", (arm,))  # out of the other's way
        places = _places_of(jobs)
        for phase in _HANDLE:
            yield Step(phase, hands, names, places if phase == "carry" else ())
        at |= {job.name: job.places[0] for job in jobs}
        done = {job.name for job in jobs if not job.passes}
        remaining = [name for name in remaining if name not in done]
        in_middle = {job.arm for job in jobs if job.passes}


def _next_jobs(
    task: Task,
    trial: Trial,
    names: Sequence[str],
    at: Mapping[str, Array],
    at_once: bool,
) -> list[_Job]:
    """Return the best job of one arm, or the best pair of both."""
    choices: dict[str, list[_Job | None]] = {side: [] for side in SIDES}
    for name in names:
        job = _job(task, trial, name, at)
        if job is not None:
            choices[job.arm].append(job)
    for jobs in choices.values():
        jobs.append(None)  # the arm waits
    left, right = choices.values()
    pairs = [pair for pair in itertools.product(left, right) if any(pair)]
    best = max(pairs, key=lambda pair: _worth(pair, at_once))
    return [job for job in best if job is not None]


def _places_of(jobs: Sequence[_Job]) -> tuple[dict[str, Array], ...]:
    """Return {cube: place}, preferred first; a job with fewer places repeats its last one."""
    choices_n = max(len(job.places) for job in jobs)
    return tuple(
        {job.name: job.places[min(k, len(job.places) - 1)] for job in jobs}
        for k in range(choices_n)
    )


def _job(task: Task, trial: Trial, name: str, at: Mapping[str, Array]) -> _Job | None:
    """Return the next job of a cube: onto its field, or to the middle; None if that is full."""
    owner = side_of(name)
    rest_m = task.objects[name].body.rest_height_m
    y = at[name].item(1, 3)
    if _SIGN_OF[owner] * y > -_WRONG_M:
        x_goal, y_goal, yaw = placement(trial.goal[name])
        return _Job(name, owner, y, (level_pose(x_goal, y_goal, rest_m, yaw),))
    others = [T[:2, 3] for other, T in at.items() if other != name]
    spots = [(x, _SIGN_OF[owner] * _MIDDLE_M) for x in _MIDDLE_X_M]
    free = [xy for xy in spots if all(math.dist(xy, other) >= _APART_M for other in others)]
    if not free:
        return None
    places = tuple(level_pose(*xy, rest_m, 0.0) for xy in free)
    passer = SIDES[1 - SIDES.index(owner)]
    return _Job(name, passer, y, places, passes=True)


def _worth(pair: tuple[_Job | None, _Job | None], at_once: bool) -> tuple[int, int]:
    """Return the numbers of jobs (-1: too close) and of passes."""
    left, right = pair
    passes_n = sum(job.passes for job in pair if job is not None)
    if left is None or right is None:
        return 1, passes_n
    apart_at_start = left.y_from - right.y_from >= _ARMS_APART_M
    apart_at_end = left.places[0][1, 3] - right.places[0][1, 3] >= _ARMS_APART_M
    return (2 if at_once and apart_at_start and apart_at_end else -1), passes_n
