"""Unfiltered planning queries, drawn by seed.

One draw of hand poses is one query, whatever comes of it: no draw is repeated, and no planner is
asked. Draws without a posture, and those proven infeasible, are counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import load_scene
from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream, subseed
from minidual.motion.api import Planner
from minidual.motion.held.query import placed, scene_holding
from minidual.motion.pose_goals import pose_goals
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, inverse
from minidual.skills.phases import PHASES
from minidual.skills.states import raised
from minidual.skills.things import around, shape_of, thing_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial, grasp_offsets, pose_of
from scripts.bench.infeasible import RigidHands, out_of_reach
from scripts.bench.peers import PeerQuery
from scripts.bench.query_sets import QuerySet, Region

GROUP = "both_arms"
_RESTARTS_SCALE = 4
"""120 starts of inverse kinematics per hand before a pose counts as one without a posture."""


@dataclass(frozen=True, eq=False)
class DrawnQuery:
    """One draw.

    Attributes:
        set: Its set.
        index: In the set.
        seed: Of the planner.
        scene: What stands there.
        start: {arm: T_world_tcp (4, 4)}.
        goal: {arm: T_world_tcp (4, 4)}.
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
        drawn: The draw.
        infeasible: Why no plan can exist, or "".
        q_start: Free posture (n,), or None if none was found.
        q_goal: Free posture (n,), or None if none was found.
    """

    drawn: DrawnQuery
    infeasible: str
    q_start: Array | None = None
    q_goal: Array | None = None

    @property
    def plannable(self) -> bool:
        """Whether both ends have a free posture."""
        return self.q_start is not None and self.q_goal is not None

    @property
    def motion(self) -> PeerQuery:
        """The motion from posture to posture, for any planner."""
        assert self.q_start is not None
        assert self.q_goal is not None
        drawn = self.drawn
        T_left_right = None
        if drawn.T_world_rod is not None:
            grasps = rod_grasps()
            T_left_right = inverse(grasps["left"]) @ grasps["right"]
        return PeerQuery(
            GROUP,
            drawn.index,
            drawn.seed,
            drawn.scene,
            self.q_start,
            self.q_goal,
            T_left_right,
        )


def rod_grasps() -> dict[str, Array]:
    """Return {arm: T_rod_tcp (4, 4)} of the rod task."""
    return dict(zip(SIDES, grasp_offsets(SceneConfig()), strict=True))


@cache
def _scene_of_file(file: Path, *, rod: bool) -> PlanningScene:
    scene = load_scene(file)[0]
    if not rod:
        return scene
    rod_shape = thing_of(SceneConfig().object).shape
    return scene_holding(scene, rod_shape, rod_grasps(), rests_on=())


@cache
def _task(name: str) -> Task:
    return make_task(Config(task=name))


def _scene_of_task(task: Task, poses: Mapping[str, Array]) -> PlanningScene:
    """Return the task's scene with its objects at T_world_object (4, 4)."""
    shapes = [
        placed(shape_of(f"{name} {k}", solid), T_world_object)
        for name, T_world_object in poses.items()
        for k, solid in enumerate(task.objects[name].body.solids)
    ]
    return around(task.scene, DUAL_PANDA).with_obstacles(*shapes)


def first_grasps(
    task: Task,
    trial: Trial,
    poses: Mapping[str, Array],
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Return T_world_tcp (4, 4) over the grasp of each hand that takes an object off the table.

    Args:
        task: The task.
        trial: Its trial.
        poses: {object: T_world_object (4, 4)}.
        rng: Chooses among the grasps.
    """
    steps = task.steps
    if task.arrange is not None:
        steps = next(iter(task.arrange(task, trial, poses)))
    over: dict[str, Array] = {}
    taken: set[str] = set()
    for step in steps:
        if step.phase != "approach":
            continue
        names = step.objects or (task.carried,) * len(step.hands)
        reached = [
            (hand, name)
            for hand, name in zip(step.hands, names, strict=False)
            if hand not in over and name not in taken
        ]
        for hand, name in reached:
            grasps = step.grasps or (task.objects[name].grasps[hand],)
            T_world_grasp = poses[name] @ grasps[rng.integers(len(grasps))]
            over[hand] = raised(T_world_grasp, PHASES["approach"].rise_m)
        taken |= {name for _, name in reached}
    return over


def draw(query_set: QuerySet, seed: int, index: int) -> DrawnQuery:
    """Return query `index` of a set."""
    rng = stream(seed, f"bench/{query_set.name}", index)
    grasps: dict[str, Array] = {}
    if query_set.task:
        task = _task(query_set.task)
        trial = task.trial(seed, f"bench/{query_set.name}", index)
        poses = {name: pose_of(item.body, trial.start[name]) for name, item in task.objects.items()}
        scene = _scene_of_task(task, poses)
        grasps = first_grasps(task, trial, poses, rng)
    else:
        scene = _scene_of_file(query_set.scene_file, rod=query_set.rod)
    if query_set.boxes is not None:
        scene = scene.with_obstacles(*query_set.boxes.draw(rng))
    T_world_rod = None
    if query_set.rod:
        start = _hands_on_rod(_draw_pose(query_set.start, rng))
        T_world_rod = _draw_pose(query_set.goal, rng)
        goal = _hands_on_rod(T_world_rod)
    else:
        start = _draw_hands(query_set.start, rng)
        goal = {**_draw_hands(query_set.goal, rng), **grasps}
    plan_seed = subseed(seed, f"bench/{query_set.name}/plan", index)
    return DrawnQuery(query_set, index, plan_seed, scene, start, goal, T_world_rod)


def _draw_pose(
    regions: tuple[Region, ...],
    rng: np.random.Generator,
    *,
    mirrored: bool = False,
) -> Array:
    """Return a pose (4, 4) in one of the regions."""
    return regions[rng.integers(len(regions))].draw(rng, mirrored=mirrored)


def _draw_hands(regions: tuple[Region, ...], rng: np.random.Generator) -> dict[str, Array]:
    return {arm: _draw_pose(regions, rng, mirrored=arm == "right") for arm in SIDES}


def _hands_on_rod(T_world_rod: Array) -> dict[str, Array]:
    return {arm: T_world_rod @ T_rod_tcp for arm, T_rod_tcp in rod_grasps().items()}


def posed(drawn: DrawnQuery, planner: Planner) -> PosedQuery:
    """Return a draw with postures for its ends; the goal's is the nearest found to the start's."""
    hands = RigidHands(drawn.scene)
    for end, targets in (("start", drawn.start), ("goal", drawn.goal)):
        reason = out_of_reach(targets, planner.kinematics) or hands.inside(targets)
        if reason:
            return PosedQuery(drawn, f"at the {end} {reason}")
    engines = planner.engines(drawn.scene)
    rng = stream(drawn.seed, "bench/postures")
    restarts_n = _RESTARTS_SCALE * planner.config.ik_restarts_n
    home = planner.robot.home
    q_start = None
    q_goal = None
    try:
        q_start = pose_goals(GROUP, home, drawn.start, engines, rng, restarts_n)[0]
        q_goal = pose_goals(GROUP, q_start, drawn.goal, engines, rng, restarts_n)[0]
    except PlanningError:
        pass  # an end without a known posture
    return PosedQuery(drawn, "", q_start, q_goal)
