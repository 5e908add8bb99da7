"""What planning costs: planners on the stored hard queries, a new scene, and the first plan of a process.

Times run from the goal going in to the proven trajectory coming out. "bare" is RRTConnect without padding, shortcuts or
proof; dense sampling with both collision engines counts how many of its trajectories are really free.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence

import numpy as np

from minidual.collision.errors import TimingError
from minidual.config.planning import PlanConfig
from minidual.motion.api import Planner
from minidual.motion.blend import blended_path
from minidual.motion.search import EdgeChecker, search
from minidual.motion.timing import time_path
from minidual.proof.scene_engines import SceneEngines
from minidual.trials.planning.evaluate import plan_query
from minidual.trials.planning.queries import Query, query_source
from scripts.bench.tables import BenchInputs, BenchRow, BenchTable

COLUMNS = ("median_ms", "p95_ms", "worst_ms", "solved_pct", "free_pct")
GOALS_MS = {"left_arm": 10.0, "right_arm": 10.0, "both_arms": 15.0}
NEW_SCENE_MAX_MS = 10.0
COLD_START_MAX_MS = 2000.0
_BUDGET_S = 5.0
_BARE_CHECKS_N = 200_000
_COLD_STARTS_N = 3
_COLD = """
import time
began = time.perf_counter()
from minidual.motion.api import Planner
planner = Planner()
home = planner.robot.home
planner.plan_to_joints("both_arms", home, home + 0.05)
print(1e3 * (time.perf_counter() - began))
"""
_NOTES = (
    "median, p95, worst: wall time",
    f"solved: proven within {_BUDGET_S:g} s",
    "free: of the solved, those on which dense sampling (0.002 rad, both engines) sees nothing touch",
    "new scene: geometry of the arms among ten obstacles, ready to plan and prove",
    "cold start: imports and the first plan of a process, byte code and compiled code on disk",
    "at 420c4ab, on two cores: left_arm 5.8, right_arm 5.7, both_arms 8.5 ms; new scene 34 ms; cold start 6900 ms",
)


def measure(inputs: BenchInputs) -> BenchTable:
    """Time planners on `repeats_n` queries of each group, as many new scenes, and three cold starts."""
    plan = inputs.config.plan
    source = query_source(inputs.seed, plan.obstacles_n, plan.blocked_fraction)
    rows: list[BenchRow] = []
    scenes: list[float] = []
    for group, goal_ms in GOALS_MS.items():
        queries = [source(group, index) for index in range(inputs.repeats_n)]
        rows.append(_planner_row(group, plan, queries, goal_ms, scenes))
        inputs.advance(rows[-1].name)
        rows.append(_bare_row(group, plan, queries))
        inputs.advance(rows[-1].name)
    rows.append(_row("new scene", scenes, limit_ms=NEW_SCENE_MAX_MS))
    with tempfile.TemporaryDirectory() as folder:
        starts = [_cold_start_s(folder) for _ in range(1 + _COLD_STARTS_N)][
            1:
        ]  # the first one writes the byte code
    rows.append(_row("cold start", starts, limit_ms=COLD_START_MAX_MS))
    inputs.advance(rows[-1].name)
    return BenchTable("planning: goal in to trajectory out", COLUMNS, tuple(rows), _NOTES)


def _row(
    name: str,
    times_s: Sequence[float],
    free: Sequence[bool] | None = None,
    limit_ms: float | None = None,
) -> BenchRow:
    """Return a row; `free` says of each solved query whether its trajectory is."""
    times = np.array(times_s) * 1e3
    numbers = {
        "median_ms": float(np.median(times)),
        "p95_ms": float(np.percentile(times, 95)),
        "worst_ms": float(times.max()),
    }
    if free is not None:
        numbers["solved_pct"] = 100.0 * len(free) / len(times)
    if free:
        numbers["free_pct"] = 100.0 * sum(free) / len(free)
    return BenchRow(name, numbers, {} if limit_ms is None else {"median_ms": limit_ms})


def _planner_row(
    group: str,
    plan: PlanConfig,
    queries: Sequence[Query],
    goal_ms: float,
    scenes: list[float],
) -> BenchRow:
    planner = Planner(config=plan.planner.model_copy(update={"budget_s": _BUDGET_S}))
    planner.plan_to_joints("both_arms", planner.robot.home, planner.robot.home + 0.05)  # compiles
    times: list[float] = []
    free: list[bool] = []
    for query in queries:
        began = time.perf_counter()
        SceneEngines(query.scene)
        scenes.append(time.perf_counter() - began)
        outcome = plan_query(planner, query)
        times.append(outcome.total_s)
        if outcome.result is not None:
            verifier = planner.engines(query.scene)
            free.append(verifier.audit(outcome.result.trajectory).collisions_n == 0)
    return _row(f"{group}: {plan.planner.planner}, proven", times, free, goal_ms)


def _bare_row(group: str, plan: PlanConfig, queries: Sequence[Query]) -> BenchRow:
    """Return the row of RRTConnect as it is often used; goals are joints."""
    config = plan.planner
    planner = Planner()
    times: list[float] = []
    free: list[bool] = []
    for query in queries:
        engines = planner.engines(query.scene)
        began = time.perf_counter()
        checker = EdgeChecker(engines, 0.0, (), config.edge_step_rad)
        checker.allow(_BARE_CHECKS_N, began + _BUDGET_S)
        ends = np.array([query.q_start, query.q_goal])
        joints = planner.robot.groups[group]
        path = search(checker, ends, joints, seed=query.seed, range_rad=config.range_rad)
        trajectory = None
        if path is not None:
            curve = blended_path(path, checker, config.blend_radius_rad, config.edge_step_rad)
            try:
                trajectory = curve and time_path(curve, group, config, planner.kinematics)[0]
            except TimingError:
                trajectory = None
        times.append(time.perf_counter() - began)
        if trajectory is not None:
            free.append(engines.audit(trajectory).collisions_n == 0)
    return _row(f"{group}: bare rrtconnect, unproven", times, free)


def _cold_start_s(folder: str) -> float:
    """Return what a new process takes from its first import to its first proven plan [s]; its byte code is in a folder."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = folder
    command = [sys.executable, "-c", _COLD]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout) / 1e3
