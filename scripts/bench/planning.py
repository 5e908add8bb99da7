"""What planning costs: planners on the stored queries, a new scene, and the first plan of a process.

minidual's plans are proven; the others' are sampled every 0.002 rad, and both collision libraries say
how many of them are really free. Planners are timed from the goal going in to the timed path coming
out. All times are processor time, taken in turns with the yardstick's: other programs on the machine
disturb the ratios least.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from minidual.collision.engines import MujocoEngine
from minidual.collision.errors import TimingError
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlannerConfig
from minidual.errors import EnvironmentMissingError
from minidual.motion.api import Planner
from minidual.motion.blend import blended_path
from minidual.motion.budget import Budget
from minidual.motion.search import EdgeChecker, search
from minidual.motion.timing import time_path
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.trajectory import Trajectory
from minidual.show.report.bench import BenchRow, BenchTable
from minidual.trials.planning.evaluate import plan_query
from minidual.trials.planning.queries import Query, query_source
from scripts.bench.peer_ompl import plan_ompl
from scripts.bench.peer_roboplan import Roboplan
from scripts.bench.peers import PeerQuery, Run, core_share
from scripts.bench.tables import BenchInputs

COLUMNS = (
    "median_ms",
    "p99_ms",
    "worst_ms",
    "solved_pct",
    "free_pct",
    "median_ratio",
    "p99_ratio",
)
RATIO_MAX = 1.0 / 3.0
"""The goal: minidual's median is at most a third of another planner's."""
NEW_SCENE_RATIO_MAX = 1.0
"""Of the time in which MuJoCo compiles the same scene."""
COLD_START_RATIO_MAX = 1.2
"""Of the time in which a process imports OMPL, MuJoCo and toppra."""
_GROUPS = ("left_arm", "right_arm", "both_arms")
_BUDGET_S = 5.0
_BARE_CHECKS_N = 200_000
_JOINTS_GOAL = 0
_POSES_GOAL = 2
"""Indices of queries whose goal is joints, and hand poses."""
_COLD_STARTS_N = 3
_FIRST_PLAN = """
import time
from minidual.motion.api import Planner
planner = Planner()
home = planner.robot.home
planner.plan_to_joints("both_arms", home, home + 0.05)
print(time.process_time())
"""
_IMPORTS = """
import time
import mujoco, ompl.base, ompl.geometric, toppra
print(time.process_time())
"""
_NOTES = (
    "median, p99, worst: processor time; a query that is not solved counts with what it took",
    "ratio: minidual's time over this planner's, in the same run; goal of the median: a third",
    f"solved: a timed path within about {_BUDGET_S:g} s of processor time; minidual's are proven",
    "free: of the solved, those on which dense sampling (0.002 rad, both engines) sees no contact",
    "where a goal is hand poses, minidual finds the posture too; the others are given it",
    "timed by toppra: plan.planner.timing: toppra; proven but for jerk and the rate of torque",
    "bare: minidual's own RRTConnect without padding, shortcuts or proof",
    "OMPL: RRTConnect asks MuJoCo every 0.03 rad, OMPL's simplification, toppra",
    "roboplan: its defaults",
    "new scene: geometry of the arms among the obstacles, ready to plan and prove;",
    "    ratio: over MuJoCo compiling the same scene",
    "cold start: imports and the first plan of a process, compiled code on disk;",
    "    ratio: over a process that imports OMPL, MuJoCo and toppra",
)


@dataclass
class _Tally:
    """One planner's runs on the queries of a group.

    Attributes:
        times_s: Of every query.
        free: Whether the path is free of contact, for each that was solved.
    """

    times_s: list[float] = field(default_factory=list[float])
    free: list[bool] = field(default_factory=list[bool])

    def add(self, run: Run, engines: SceneEngines) -> None:
        """Count a run, and sample its path."""
        self.times_s.append(run.cpu_s)
        if run.trajectory is not None:
            self.free.append(engines.audit(run.trajectory).collisions_n == 0)

    def numbers(self) -> dict[str, float]:
        """Return times and shares."""
        numbers = _times(self.times_s)
        numbers["solved_pct"] = 100.0 * len(self.free) / len(self.times_s)
        if self.free:
            numbers["free_pct"] = 100.0 * sum(self.free) / len(self.free)
        return numbers


def _times(times_s: Sequence[float]) -> dict[str, float]:
    times_ms = 1e3 * np.array(times_s)
    return {
        "median_ms": float(np.median(times_ms)),
        "p99_ms": float(np.percentile(times_ms, 99)),
        "worst_ms": float(times_ms.max()),
    }


def measure(inputs: BenchInputs) -> BenchTable:
    """Time planners on `repeats_n` queries of each group, as many new scenes, and three cold starts."""
    plan = inputs.config.plan
    wall_s = _BUDGET_S / core_share()  # minidual then goes by the wall clock
    config = plan.planner.model_copy(update={"budget_s": wall_s})
    source = query_source(inputs.seed, plan.obstacles_n, plan.blocked_fraction)
    notes = list(_NOTES)
    roboplan = None
    try:
        roboplan = Roboplan(inputs.roboplan)
    except EnvironmentMissingError as error:
        notes.append(f"{error.message}. Type: {error.remedy}")
    rows: list[BenchRow] = []
    scenes: list[PlanningScene] = []
    for group in _GROUPS:
        queries = [source(group, index) for index in range(inputs.repeats_n)]
        scenes += [query.scene for query in queries]
        _warm_up(config, [source(group, index) for index in (_JOINTS_GOAL, _POSES_GOAL)])
        for row in _group_rows(group, queries, Planner(config=config), roboplan):
            rows.append(row)
            inputs.advance(row.name)
    for row in (_new_scene_row(scenes), _cold_start_row()):
        rows.append(row)
        inputs.advance(row.name)
    return BenchTable("planning: goal in to trajectory out", COLUMNS, tuple(rows), tuple(notes))


def _warm_up(config: PlannerConfig, queries: Sequence[Query]) -> None:
    """Load compiled code and libraries, which the first plans of a process wait for."""
    planner = Planner(config=config)
    toppra_planner = _timed_by_toppra(config)
    for query in queries:
        _proven(query, planner)
        _proven(query, toppra_planner)
        _bare(query, planner)
        plan_ompl(_motion(query), planner, _BUDGET_S)


def _timed_by_toppra(config: PlannerConfig) -> Planner:
    return Planner(config=config.model_copy(update={"timing": "toppra"}))


def _group_rows(
    group: str,
    queries: Sequence[Query],
    planner: Planner,
    roboplan: Roboplan | None,
) -> Iterator[BenchRow]:
    """Yield a row per planner, minidual's with its own timing first."""
    toppra_planner = _timed_by_toppra(planner.config)
    proven = _Tally()
    toppra_timed = _Tally()
    bare = _Tally()
    ompl = _Tally()
    for query in queries:
        engines = planner.engines(query.scene)
        proven.add(_proven(query, planner), engines)
        toppra_timed.add(_proven(query, toppra_planner), engines)
        bare.add(_bare(query, planner), engines)
        ompl.add(plan_ompl(_motion(query), planner, _BUDGET_S), engines)
    own = proven.numbers()
    yield BenchRow(f"{group}: minidual, proven", own, {})
    yield BenchRow(f"{group}: minidual, timed by toppra", toppra_timed.numbers(), {})
    yield BenchRow(f"{group}: bare rrtconnect, unproven", bare.numbers(), {})
    yield _peer_row(f"{group}: OMPL, MuJoCo, toppra", ompl, own)
    if roboplan is not None:
        tally = _Tally()
        runs = roboplan.plan([_motion(query) for query in queries], planner, _BUDGET_S)
        for query, run in zip(queries, runs, strict=True):
            tally.add(run, planner.engines(query.scene))
        yield _peer_row(f"{group}: roboplan", tally, own)


def _peer_row(name: str, tally: _Tally, own: dict[str, float]) -> BenchRow:
    """Return another planner's row, with minidual's times over its own."""
    numbers = tally.numbers()
    numbers["median_ratio"] = own["median_ms"] / numbers["median_ms"]
    numbers["p99_ratio"] = own["p99_ms"] / numbers["p99_ms"]
    return BenchRow(name, numbers, {"median_ratio": RATIO_MAX})


def _motion(query: Query) -> PeerQuery:
    return PeerQuery(
        query.group,
        query.index,
        query.seed,
        query.scene,
        query.q_start,
        query.q_goal,
    )


def _proven(query: Query, planner: Planner) -> Run:
    outcome = plan_query(planner, query, planner.config.budget_s)
    trajectory = None if outcome.result is None else outcome.result.trajectory
    return Run(trajectory, outcome.cpu_s, outcome.message)


def _bare(query: Query, planner: Planner) -> Run:
    """Plan with RRTConnect as it is often used: no padding, no shortcuts, no proof; goals are joints."""
    began = time.process_time()
    trajectory = _bare_path(query, planner, planner.config)
    cpu_s = time.process_time() - began
    return Run(trajectory, cpu_s, "" if trajectory is not None else "no path")


def _bare_path(query: Query, planner: Planner, config: PlannerConfig) -> Trajectory | None:
    checker = EdgeChecker(planner.engines(query.scene), 0.0, (), config.edge_step_rad)
    checker.allow(_BARE_CHECKS_N, Budget(wall_s=config.budget_s))
    ends = np.array([query.q_start, query.q_goal])
    joints = planner.robot.groups[query.group]
    path = search(checker, ends, joints, seed=query.seed, range_rad=config.range_rad)
    if path is None:
        return None
    curve = blended_path(path, checker, config.blend_radius_rad, config.edge_step_rad)
    if curve is None:
        return None
    try:
        return time_path(curve, query.group, config, planner.kinematics).trajectory
    except TimingError:
        return None


def _new_scene_row(scenes: Sequence[PlanningScene]) -> BenchRow:
    """Return the row of new scenes, beside MuJoCo's models of the same scenes."""
    SceneEngines(scenes[0])  # the hulls of the arms are made once
    own_s: list[float] = []
    mujoco_s: list[float] = []
    for scene in scenes:
        own_s.append(_cpu_s(SceneEngines, scene))
        mujoco_s.append(_cpu_s(MujocoEngine, scene))
    return _yardstick_row("new scene", own_s, mujoco_s, NEW_SCENE_RATIO_MAX)


def _cpu_s(build: Callable[[PlanningScene], object], scene: PlanningScene) -> float:
    began = time.process_time()
    build(scene)
    return time.process_time() - began


def _cold_start_row() -> BenchRow:
    """Return the row of first plans of a process, beside processes that import the peers' libraries."""
    own_s: list[float] = []
    imports_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        _process_s(_FIRST_PLAN, folder)  # writes the byte code
        _process_s(_IMPORTS, folder)
        for _ in range(_COLD_STARTS_N):
            own_s.append(_process_s(_FIRST_PLAN, folder))
            imports_s.append(_process_s(_IMPORTS, folder))
    return _yardstick_row("cold start", own_s, imports_s, COLD_START_RATIO_MAX)


def _process_s(program: str, byte_code_folder: str) -> float:
    """Return the processor time [s] that a program prints in a new process."""
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    environment["PYTHONPYCACHEPREFIX"] = byte_code_folder
    process = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(process.stdout)


def _yardstick_row(
    name: str,
    own_s: Sequence[float],
    yardstick_s: Sequence[float],
    ratio_max: float,
) -> BenchRow:
    """Return a row of times, with their median over the yardstick's."""
    numbers = _times(own_s)
    numbers["median_ratio"] = float(np.median(own_s) / np.median(yardstick_s))
    return BenchRow(name, numbers, {"median_ratio": ratio_max})
