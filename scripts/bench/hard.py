"""Hard planning queries, none left out: what is solved, times out, has no posture, is proven infeasible.

Every planner gets the same postures. What a planner calls solved is sampled every 0.002 rad; MuJoCo and coal are asked
about each sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from minidual.errors import EnvironmentMissingError
from minidual.motion.api import Planner, PlanResult
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD, HandsIK
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.held.query import HeldQuery
from minidual.proof.scene_engines import collision_samples
from minidual.robot.pair import SIDES, Array, Robot, inverse
from minidual.robot.trajectory import Trajectory
from minidual.trials.planning.evaluate import attempted
from minidual.trials.statistics import wilson_interval
from scripts.bench.peers import Roboplan, Run, core_share, plan_ompl
from scripts.bench.queries import GROUP, SETS, DrawnQuery, PosedQuery, draw, posed, rod_grasps
from scripts.bench.tables import BenchInputs, BenchRow, BenchTable

DRAWS = ("drawn", "infeasible", "no_posture")
RUNS = (
    "solved",
    "timed_out",
    "early",
    "low_pct",
    "high_pct",
    "median_ms",
    "p99_ms",
    "colliding",
    "over_jerk",
    "off_grasp",
)
BUDGET_S = 10.0
_ARRIVED_M = 1e-3
_ARRIVED_RAD = 1e-3
_NOTES = (
    "drawn = infeasible (proven) + no_posture (inverse kinematics found no free one at an end) + solved + timed_out",
    f"timed_out: no timed path within {BUDGET_S:g} s of processor time; early: of these, ended before 90 % of that:",
    "    the planner gave up, or other programs ran (minidual and roboplan go by the wall clock)",
    "low, high: 95 % Wilson interval of solved and free of contact, among those with postures",
    "median, p99: processor time of the solved, from postures to timed path; scenes are built before",
    "colliding, over_jerk: solved, but it touches something, or needs more than the arms' jerk limits",
    "off_grasp: solved, but a hand leaves its grasp by more than 0.1 mm or 0.05 degrees",
)

type PlanAll = Callable[[Sequence[PosedQuery], Planner, float], list[Run]]


@dataclass(frozen=True)
class Found:
    """What dense sampling says of a timed path."""

    arrives: bool
    colliding: bool
    over_jerk: bool
    off_grasp: bool


def measure(inputs: BenchInputs) -> BenchTable:
    """Plan `repeats_n` draws of every set."""
    planner = Planner(config=inputs.config.plan.planner.model_copy(update={"budget_s": BUDGET_S}))
    planner.plan_to_joints(GROUP, planner.robot.home, planner.robot.home + 0.05)  # compiles
    planners: dict[str, PlanAll] = {
        "minidual": plan_minidual,
        "minidual, to hand poses": plan_to_poses,
    }
    title = "hard planning queries"
    notes = _NOTES
    if inputs.peers:
        planners["OMPL, MuJoCo, toppra"] = plan_ompl
        try:
            planners["roboplan"] = Roboplan(inputs.roboplan).plan
        except EnvironmentMissingError as error:
            missing = f"{error.message}. Type: {error.remedy}"
            inputs.advance(missing)
            title = f"{title}, WITHOUT roboplan"
            notes = (*notes, missing)
    rows = []
    for name, of in SETS.items():
        queries = [
            posed(draw(of, inputs.seed, index), planner) for index in range(inputs.repeats_n)
        ]
        rows.append(BenchRow(name, counted(queries), {}))
        inputs.advance(f"{name}: {rows[-1].numbers}")
        plannable = [query for query in queries if query.plannable]
        for planner_name, plan_all in planners.items():
            if of.rod and plan_all is plan_to_poses:
                continue  # a held rod's goal is its pose anyway
            runs = plan_all(plannable, planner, BUDGET_S)
            rows.append(BenchRow(f"{name}: {planner_name}", judged(plannable, runs, planner), {}))
            for query, run in zip(plannable, runs, strict=True):
                if run.trajectory is None:
                    inputs.advance(f"query {query.drawn.index}, {run.cpu_s:.1f} s: {run.reason}")
            inputs.advance(f"{rows[-1].name}: {rows[-1].numbers}")
    return BenchTable(title, (*DRAWS, *RUNS), tuple(rows), notes)


def counted(queries: Sequence[PosedQuery]) -> dict[str, float]:
    """Return how many were drawn, are proven infeasible, have no known posture."""
    infeasible = sum(bool(query.infeasible) for query in queries)
    no_posture = sum(not (query.infeasible or query.plannable) for query in queries)
    return {"drawn": len(queries), "infeasible": infeasible, "no_posture": no_posture}


def judged(
    queries: Sequence[PosedQuery],
    runs: Sequence[Run],
    planner: Planner,
) -> dict[str, float]:
    """Return the numbers of one planner on plannable queries."""
    times = []
    found = []
    for query, run in zip(queries, runs, strict=True):
        if run.trajectory is None:
            continue
        looked = look(query.drawn, run.trajectory, planner)
        if looked.arrives and run.cpu_s <= BUDGET_S:
            found.append(looked)
            times.append(1e3 * run.cpu_s)
    numbers: dict[str, float] = {"solved": len(found), "timed_out": len(queries) - len(found)}
    numbers["early"] = sum(run.trajectory is None and run.cpu_s < 0.9 * BUDGET_S for run in runs)
    for what in ("colliding", "over_jerk", "off_grasp"):
        numbers[what] = sum(getattr(one, what) for one in found)
    if queries:
        low, high = wilson_interval(len(found) - int(numbers["colliding"]), len(queries))
        numbers |= {"low_pct": 100.0 * low, "high_pct": 100.0 * high}
    if times:
        numbers |= {"median_ms": float(np.median(times)), "p99_ms": float(np.percentile(times, 99))}
    return numbers


def look(drawn: DrawnQuery, trajectory: Trajectory, planner: Planner) -> Found:
    """Sample a timed path of a query every 0.002 rad."""
    Q = collision_samples(trajectory)
    tips = planner.kinematics.tcp_poses
    arrives = all(
        _same(T, asked[arm])
        for q, asked in ((Q[0], drawn.start), (Q[-1], drawn.goal))
        for arm, T in zip(SIDES, tips(q), strict=True)
    )
    off_grasp = False
    if drawn.T_world_rod is not None:
        grasps = rod_grasps()
        hands = HandsIK((grasps["left"], grasps["right"]), planner.robot)
        rods = np.array([tips(q)[0] @ inverse(grasps["left"]) for q in Q])
        off_m, off_rad = hands.strays(Q, rods)
        off_grasp = not (off_m <= RESIDUAL_MAX_M and off_rad <= RESIDUAL_MAX_RAD)
    return Found(
        arrives,
        planner.engines(drawn.scene).audit(trajectory).collisions_n > 0,
        not jerk_ratio(trajectory, planner.robot) <= 1.0,
        off_grasp,
    )


def jerk_ratio(trajectory: Trajectory, robot: Robot) -> float:
    """Return the largest change of acceleration per sample, over what the jerk limit allows; it starts and ends at rest."""
    at_rest = np.zeros((1, robot.dof))
    changes = np.abs(np.diff(np.vstack([at_rest, trajectory.a, at_rest]), axis=0))
    return float((changes / trajectory.dt_s / robot.jerk_max).max())


def _same(T: Array, other: Array) -> bool:
    apart = (
        np.linalg.norm(T[:3, 3] - other[:3, 3]),
        np.linalg.norm(pin.log3(T[:3, :3].T @ other[:3, :3])),
    )
    return bool(apart[0] <= _ARRIVED_M and apart[1] <= _ARRIVED_RAD)


def plan_minidual(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
    """Plan to the postures, or to the rod's goal."""
    wall_s = budget_s / core_share()
    return [_run(query, planner, wall_s, to_poses=False) for query in queries]


def plan_to_poses(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
    """Plan to the hands' poses, in any posture: inverse kinematics counts."""
    wall_s = budget_s / core_share()
    return [_run(query, planner, wall_s, to_poses=True) for query in queries]


def _run(query: PosedQuery, planner: Planner, wall_s: float, *, to_poses: bool) -> Run:
    assert query.q_start is not None
    assert query.q_goal is not None
    q_start = query.q_start
    q_goal = query.q_goal
    drawn = query.drawn
    held = HeldPlanner(planner)
    planner.engines(drawn.scene)

    def plan() -> PlanResult | Trajectory:
        how = {"scene": drawn.scene, "seed": drawn.seed, "budget_s": wall_s}
        if drawn.T_world_rod is not None:
            left, right = rod_grasps().values()
            asked = HeldQuery(q_start, drawn.T_world_rod, (left, right), drawn.scene, drawn.seed)
            return held.plan(asked, wall_s)
        if to_poses:
            return planner.plan_to_poses(GROUP, q_start, drawn.goal, **how)
        return planner.plan_to_joints(GROUP, q_start, q_goal, **how)

    attempt = attempted(plan)
    trajectory = (
        attempt.result.trajectory if isinstance(attempt.result, PlanResult) else attempt.result
    )
    return Run(trajectory, attempt.cpu_s, attempt.message)
