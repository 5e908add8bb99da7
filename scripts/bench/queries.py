"""Unfiltered planning queries, drawn by seed: a shelf, a gate for a held rod, crossing hands, 20 boxes, the tasks' scenes.

One draw of hand poses is one query, whatever comes of it: no draw is repeated, and no planner is asked. What a draw
has no posture for is counted. `infeasible` tells where that is proven: a hand is farther from its shoulder than the arm
is long, or the hand itself, which no posture of the arm moves against its tcp, is inside something.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from minidual.collision.engines import CoalEngine
from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import load_scene
from minidual.collision.shapes import Box, Shape
from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream, subseed
from minidual.motion.api import Planner
from minidual.motion.held.query import placed, scene_holding
from minidual.motion.pose_goals import pose_goals
from minidual.registry import Registry, rows_beside
from minidual.robot.description import links_of
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, inverse, pose, rot_x, rot_z
from minidual.skills.phases import PHASES
from minidual.skills.states import raised
from minidual.skills.things import around, shape_of, thing_of
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Task, Trial, grasp_offsets, pose_of

GROUP = "both_arms"
_RESTARTS_SCALE = 4
"""120 starts of inverse kinematics per hand before a pose counts as one without a posture."""
_INSIDE_M = 1e-5
"""Penetration that counts as contact: far above coal's tolerance."""
_FACING = {
    "down": rot_x(np.pi),
    "ahead": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "level": np.eye(3),
}


@dataclass(frozen=True)
class Region:
    """Where poses are drawn; `queries.yaml` says how."""

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    facing: str
    tilt_rad: float
    turn_rad: float

    def draw(self, rng: np.random.Generator, *, mirrored: bool) -> Array:
        """Return a pose (4, 4)."""
        position = rng.uniform(self.low_m, self.high_m)
        about = rng.uniform(-np.pi, np.pi)
        turn = rng.uniform(-self.turn_rad, self.turn_rad)
        R = _FACING[self.facing]
        tilt = rng.uniform(0.0, self.tilt_rad)
        lean = rot_z(about) @ rot_x(tilt) @ rot_z(-about)
        if mirrored:
            position[1] = -position[1]
        return pose(R @ lean @ rot_z(turn), position)


@dataclass(frozen=True)
class Boxes:
    """Boxes of one size range [m], standing on the table or centred anywhere between low_m and high_m."""

    standing_n: int
    floating_n: int
    size_m: tuple[float, float]
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def draw(self, rng: np.random.Generator) -> tuple[Shape, ...]:
        """Return the boxes of one query."""
        shapes = []
        for k in range(self.standing_n + self.floating_n):
            size = rng.uniform(*self.size_m, 3)
            place = rng.uniform(self.low_m, self.high_m)
            half_yaw = rng.uniform(-np.pi / 4, np.pi / 4)
            if k < self.standing_n:
                place[2] = 0.5 * size[2]
            quat = float(np.cos(half_yaw)), 0.0, 0.0, float(np.sin(half_yaw))
            shapes.append(Box(f"box{k}", tuple(place.tolist()), quat, tuple(size.tolist())))
        return tuple(shapes)


@dataclass(frozen=True)
class QuerySet:
    """What a set draws: regions of start and goal, extra boxes; with `rod` the regions are the rod's.

    With `task` the task's objects stand where a trial puts them, and hands that take one first go over their grasps.
    """

    name: str
    start: tuple[Region, ...]
    goal: tuple[Region, ...]
    boxes: Boxes | None = None
    rod: bool = False
    task: str = ""

    @property
    def scene_file(self) -> Path:
        """What stands there in every query, but for `task`."""
        return Path(__file__).with_name("sets") / f"{self.name}.yaml"


@dataclass(frozen=True, eq=False)
class DrawnQuery:
    """One draw.

    Attributes:
        start, goal: {arm: T_world_tcp (4, 4)}.
        T_world_rod: Goal pose of the held rod, or None.
    """

    set: QuerySet
    index: int
    seed: int
    scene: PlanningScene
    start: Mapping[str, Array]
    goal: Mapping[str, Array]
    T_world_rod: Array | None = None


@dataclass(frozen=True, eq=False)
class PosedQuery:
    """A draw and its postures.

    Attributes:
        infeasible: Why no plan can exist, or "".
        q_start, q_goal: Free postures (n,), or None if none was found.
    """

    drawn: DrawnQuery
    infeasible: str
    q_start: Array | None = field(default=None)
    q_goal: Array | None = field(default=None)

    @property
    def plannable(self) -> bool:
        """Whether both ends have a free posture."""
        return self.q_start is not None and self.q_goal is not None


def _sets() -> dict[str, QuerySet]:
    content = rows_beside(__file__)
    regions = {name: Region(**row) for name, row in content["regions"].items()}
    found = {}
    of_tasks = {
        name: {**content["each_task"], "task": name} for name in TASKS if name != "rod_carry"
    }
    for name, row in {**content["sets"], **of_tasks}.items():
        ends = {end: tuple(regions[region] for region in row.pop(end)) for end in ("start", "goal")}
        boxes = Boxes(**row.pop("boxes")) if "boxes" in row else None
        found[name] = QuerySet(name, **ends, boxes=boxes, **row)
    return found


SETS: Registry[QuerySet] = Registry("query set", _sets())


def rod_grasps() -> dict[str, Array]:
    """Return {arm: T_rod_tcp (4, 4)} of the rod task."""
    return dict(zip(SIDES, grasp_offsets(SceneConfig()), strict=True))


@cache
def _standing(file: Path, *, rod: bool) -> PlanningScene:
    scene = load_scene(file)[0]
    if rod:
        scene = scene_holding(
            scene,
            thing_of(SceneConfig().object).shape,
            rod_grasps(),
            rests_on=(),
        )
    return scene


@cache
def _task(name: str) -> Task:
    return make_task(Config(task=name))


def first_grasps(
    task: Task,
    trial: Trial,
    objects: Mapping[str, Array],
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Return T_world_tcp (4, 4) over the grasp of each hand that takes an object off the table."""
    steps = task.steps if task.arrange is None else next(iter(task.arrange(task, trial, objects)))
    over = dict[str, Array]()
    taken = set[str]()
    for step in (step for step in steps if step.phase == "approach"):
        names = step.objects or (task.carried,) * len(step.hands)
        reached = [
            (hand, name)
            for hand, name in zip(step.hands, names, strict=False)
            if not {hand, name} & {*over, *taken}
        ]
        for hand, name in reached:
            grasps = step.grasps or (task.objects[name].grasps[hand],)
            over[hand] = raised(
                objects[name] @ grasps[rng.integers(len(grasps))],
                PHASES["approach"].rise_m,
            )
        taken |= {name for _, name in reached}
    return over


def _standing_in(task: Task, objects: Mapping[str, Array]) -> PlanningScene:
    bodies = {name: task.objects[name].body for name in objects}
    shapes = (
        placed(shape_of(f"{name} {k}", part), objects[name])
        for name, body in bodies.items()
        for k, part in enumerate(body.solids)
    )
    return around(task.scene, DUAL_PANDA).with_obstacles(*shapes)


def draw(of: QuerySet, seed: int, index: int) -> DrawnQuery:
    """Return query `index` of a set."""
    rng = stream(seed, f"bench/{of.name}", index)
    over = dict[str, Array]()
    if of.task:
        task = _task(of.task)
        trial = task.trial(seed, f"bench/{of.name}", index)
        objects = {
            name: pose_of(item.body, trial.start[name]) for name, item in task.objects.items()
        }
        scene = _standing_in(task, objects)
        over = first_grasps(task, trial, objects, rng)
    else:
        scene = _standing(of.scene_file, rod=of.rod)
    if of.boxes is not None:
        scene = scene.with_obstacles(*of.boxes.draw(rng))
    ends: list[dict[str, Array]] = []
    T_world_rod = None
    for regions in (of.start, of.goal):
        if of.rod:
            T_world_rod = regions[rng.integers(len(regions))].draw(rng, mirrored=False)
            ends.append({arm: T_world_rod @ grasp for arm, grasp in rod_grasps().items()})
        else:
            ends.append(
                {
                    arm: regions[rng.integers(len(regions))].draw(rng, mirrored=arm == "right")
                    for arm in SIDES
                },
            )
    goal = {**ends[1], **over}
    return DrawnQuery(
        of,
        index,
        subseed(seed, f"bench/{of.name}/plan", index),
        scene,
        ends[0],
        goal,
        T_world_rod,
    )


def posed(drawn: DrawnQuery, planner: Planner) -> PosedQuery:
    """Return a draw with postures for its ends; the goal's is the nearest that was found to the start's."""
    hands = RigidHands(drawn.scene)
    for end, targets in (("start", drawn.start), ("goal", drawn.goal)):
        why = out_of_reach(targets, planner.kinematics) or hands.inside(targets)
        if why:
            return PosedQuery(drawn, f"at the {end} {why}")
    engines = planner.engines(drawn.scene)
    near = planner.robot.home
    found = []
    rng = stream(drawn.seed, "bench/postures")
    restarts_n = _RESTARTS_SCALE * planner.config.ik_restarts_n
    for targets in (drawn.start, drawn.goal):
        try:
            near = pose_goals(GROUP, near, targets, engines, rng, restarts_n)[0]
        except PlanningError:
            break
        found.append(near)
    return PosedQuery(drawn, "", *found)


def out_of_reach(targets: Mapping[str, Array], kinematics: Kinematics) -> str:
    """Return which hand is farther away than its arm is long, or "".

    The tcp fixes the origin of the last joint. The first joint's origin stands still. Between both lie the fixed
    distances from each joint to the next, so their sum bounds how far they can be apart.
    """
    model = kinematics.model
    n = kinematics.robot.dof_per_arm
    for arm, T in targets.items():
        first = 1 + n * SIDES.index(arm)
        tip = model.frames[kinematics.tcp_ids[SIDES.index(arm)]].placement
        last = (T @ tip.inverse().homogeneous)[:3, 3]
        away = float(np.linalg.norm(last - model.jointPlacements[first].translation))
        length = sum(
            float(np.linalg.norm(model.jointPlacements[first + k].translation)) for k in range(1, n)
        )
        if away > length:
            return f"the {arm} hand's last joint is {away:.3f} m from the shoulder; the arm bridges {length:.3f} m"
    return ""


class RigidHands:
    """What moves with the tcps whatever the arms do: the last links, the hands, what they hold."""

    def __init__(self, scene: PlanningScene) -> None:
        robot = scene.robot
        links = links_of(scene.robot)
        engine = CoalEngine(scene)
        q = scene.robot.home
        self._items = engine.items
        self._names = ()
        geometry = engine.geometry
        data = engine.model.createData()
        placed = pin.GeometryData(geometry)
        pin.updateGeometryPlacements(engine.model, data, geometry, placed, q)
        self._solids = [item.geometry for item in geometry.geometryObjects]
        self._places = [place.homogeneous for place in placed.oMg]
        tips = Kinematics(robot).tcp_poses(q)
        self._T_tcp_world = {arm: inverse(T) for arm, T in zip(SIDES, tips, strict=True)}
        last = {
            name: link.side
            for name, link in links.items()
            if link.joints_before == robot.dof_per_arm
        }
        self._arm_of = last | {
            held.name: last[held.link] for held in scene.attached if held.link in last
        }
        still = {shape.name for shape in scene.obstacles}
        known = self._arm_of.keys() | still
        self._pairs = [(a, b) for a, b in scene.checked_pairs if a in known and b in known]

    def inside(self, targets: Mapping[str, Array]) -> str:
        """Return which two parts are inside each other with the hands at T_world_tcp (4, 4), or ""."""
        for a, b in self._pairs:
            for (first, at_first), (second, at_second) in (
                (x, y) for x in self._placed(a, targets) for y in self._placed(b, targets)
            ):
                deep = -coal.distance(
                    first,
                    at_first,
                    second,
                    at_second,
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                )
                if deep > _INSIDE_M:
                    return f"{a} is {deep * 1e3:.1f} mm inside {b}"
        return ""

    def _placed(self, part: str, targets: Mapping[str, Array]) -> Iterator[tuple[Any, Any]]:
        for k in self._items[part]:
            T = self._places[k]
            if part in self._arm_of:
                arm = self._arm_of[part]
                T = targets[arm] @ self._T_tcp_world[arm] @ T
            yield self._solids[k], coal.Transform3s(T[:3, :3], T[:3, 3])
