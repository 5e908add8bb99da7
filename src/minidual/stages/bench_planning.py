"""What planning costs: planners beside each other, checkers beside each other, and the price of proof.

Planners solve the same stored hard queries, goal in to proven trajectory out. "bare" is RRTConnect without padding,
shortcuts or proof; how many of its trajectories are really free is counted by dense sampling. Checkers look at the
same trajectories, those that the first planner made.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from minidual.collision.errors import PlanningError, TimingError
from minidual.config.planning import PlannerConfig
from minidual.motion.api import Planner
from minidual.motion.blend import blended_path
from minidual.motion.edges import EdgeChecker
from minidual.motion.search import search
from minidual.motion.timing import MotionLimits, time_path
from minidual.proof.verify import Audit, collision_samples
from minidual.robot.constants import GROUPS, HOME
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory
from minidual.stages.bench_rows import BenchInputs, BenchRow, BenchTable
from minidual.trials.planning.evaluate import plan_query, query_source
from minidual.trials.planning.queries import Query

COLUMNS = ("median_ms", "p95_ms", "worst_ms", "solved_pct", "free_pct")
_BUDGET_S = 5.0
_BARE_CHECKS_N = 200_000
_OTHERS = ("kpiece", "bitstar", "rrt")
_NOTES = (
    "median, p95, worst: wall time of one query (planners) or of one trajectory (checkers)",
    f"solved: within {_BUDGET_S:g} s, for a checker: accepted",
    "free: of the solved, those on which dense sampling (0.002 rad, both engines) sees nothing touch",
)


def measure(inputs: BenchInputs) -> BenchTable:
    """Time planners and checkers on `repeats_n` queries of the one-arm and of the two-arm set."""
    plan = inputs.config.plan
    source = query_source(inputs.seed, plan.obstacles_n, plan.blocked_fraction)
    rows: list[BenchRow] = []
    for group in ("left_arm", "both_arms"):
        queries = [source(group, index) for index in range(inputs.repeats_n)]
        ours = Planner(config=plan.planner.model_copy(update={"budget_s": _BUDGET_S}))
        row, solved = _planner_row(f"{group}: {plan.planner.planner}, proven", ours, queries)
        rows.append(row)
        inputs.advance(row.name)
        for name in _OTHERS:
            config = plan.planner.model_copy(update={"planner": name, "fallback_planners": (), "budget_s": _BUDGET_S})
            row, _ = _planner_row(f"{group}: {name}, proven", Planner(config=config), queries)
            rows.append(row)
            inputs.advance(row.name)
        rows.append(_bare_row(f"{group}: bare rrtconnect, unproven", ours, queries, plan.planner))
        inputs.advance(rows[-1].name)
        rows += _checker_rows(group, ours, solved)
        inputs.advance(f"{group}: checkers")
    return BenchTable("planning: goal in to trajectory out, and the checks alone", COLUMNS, tuple(rows), _NOTES)


def _row(name: str, times_s: list[float], tried_n: int, solved_n: int, free_n: int) -> BenchRow:
    times = np.array(times_s) * 1e3
    numbers = {
        "median_ms": float(np.median(times)),
        "p95_ms": float(np.percentile(times, 95)),
        "worst_ms": float(times.max()),
        "solved_pct": 100.0 * solved_n / tried_n,
    }
    if solved_n:
        numbers["free_pct"] = 100.0 * free_n / solved_n
    return BenchRow(name, numbers, {})


def _free(audit: Audit) -> bool:
    return audit.collisions_n == 0


def _planner_row(name: str, planner: Planner, queries: list[Query]) -> tuple[BenchRow, list[tuple[Query, Trajectory]]]:
    """Return the row of one planner, and the trajectories that it found."""
    planner.plan_to_joints("both_arms", HOME, HOME + 0.05)  # imports and compiles what the first would pay for
    times: list[float] = []
    found: list[tuple[Query, Trajectory]] = []
    free_n = 0
    for query in queries:
        outcome = plan_query(planner, query)
        times.append(outcome.total_s)
        if outcome.result is not None:
            found.append((query, outcome.result.trajectory))
            free_n += _free(planner.engines(query.scene).verifier.audit(outcome.result.trajectory))
    return _row(name, times, len(queries), len(found), free_n), found


def _bare_row(name: str, planner: Planner, queries: list[Query], config: PlannerConfig) -> BenchRow:
    """Return the row of RRTConnect as it is often used: no padding, no shortcuts, no proof; joints as the goal."""
    kinematics, limits = Kinematics(), MotionLimits()
    times: list[float] = []
    solved_n = free_n = 0
    for query in queries:
        engines = planner.engines(query.scene)
        begin = time.perf_counter()
        checker = EdgeChecker(engines, 0.0, (), config.edge_step_rad)
        path = search(
            checker,
            query.q_start,
            query.q_goal,
            GROUPS[query.group],
            range_rad=config.range_rad,
            seed=query.seed,
            checks_max=_BARE_CHECKS_N,
            deadline=begin + _BUDGET_S,
        )
        trajectory = None
        if path is not None:
            try:
                curve = blended_path(path, checker, config.blend_radius_rad, config.edge_step_rad)
                trajectory = curve and time_path(curve, query.group, limits, kinematics)
            except (TimingError, PlanningError):
                trajectory = None
        times.append(time.perf_counter() - begin)
        if trajectory is not None:
            solved_n += 1
            free_n += _free(engines.verifier.audit(trajectory))
    return _row(name, times, len(queries), solved_n, free_n)


def _checker_rows(group: str, planner: Planner, solved: list[tuple[Query, Trajectory]]) -> list[BenchRow]:
    """Return one row a way to check the same trajectories; `solved` says how many it accepts."""
    rows = []
    for name in ("certificate, both engines", "0.002 rad, both engines", "0.002 rad, mujoco", "0.002 rad, coal"):
        times: list[float] = []
        accepted_n = 0
        for query, trajectory in solved:
            accept = _checker(name, planner, query)
            begin = time.perf_counter()
            accepted_n += accept(trajectory)
            times.append(time.perf_counter() - begin)
        if times:
            rows.append(_row(f"{group}: check by {name}", times, len(times), accepted_n, accepted_n))
    return rows


def _checker(name: str, planner: Planner, query: Query) -> Callable[[Trajectory], bool]:
    engines = planner.engines(query.scene)
    if name.startswith("certificate"):
        return lambda t: engines.verifier.certify(t).ok
    if name.endswith("both engines"):
        return lambda t: _free(engines.verifier.audit(t))
    engine = engines.verifier.engine("mujoco" if name.endswith("mujoco") else "coal")
    return lambda t: not engine.collisions(collision_samples(t)).any()
