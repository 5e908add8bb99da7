"""Hard planning queries, none left out: solved, timed out, without a posture, proven infeasible.

Every planner gets the same postures. What a planner calls solved is sampled every 0.002 rad; MuJoCo
and coal are asked about each sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from minidual.show.report.bench import BenchRow, BenchTable
from minidual.trials.planning.evaluate import attempted
from minidual.trials.statistics import wilson_interval
from scripts.bench.peer_ompl import plan_ompl
from scripts.bench.peer_roboplan import Roboplan
from scripts.bench.peers import Run, core_share
from scripts.bench.queries import GROUP, DrawnQuery, PosedQuery, draw, posed, rod_grasps
from scripts.bench.query_sets import SETS
from scripts.bench.tables import BenchInputs

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
_EARLY_SHARE = 0.9
"""A planner that ends without a path before this share of the budget gave up."""
_ARRIVED_M = 1e-3
_ARRIVED_RAD = 1e-3
_NOTES = (
    "drawn = infeasible (proven) + no_posture (no free one found at an end) + solved + timed_out",
    f"timed_out: no timed path within {BUDGET_S:g} s of processor time",
    "early: timed out, but ended before 90 % of that: the planner gave up, or other programs ran",
    "    (minidual and roboplan go by the wall clock)",
    "low, high: 95 % Wilson interval of solved and free of contact, among those with postures",
    "median, p99: processor time of the solved, from postures to timed path; scenes are built before",
    "colliding, over_jerk: solved, but it touches something, or needs more than the arms' jerk limits",
    "off_grasp: solved, but a hand leaves its grasp by more than 0.1 mm or 0.05 degrees",
)

type PlanAll = Callable[[Sequence[PosedQuery], Planner, float], list[Run]]


@dataclass(frozen=True)
class PathFaults:
    """What dense sampling says of a timed path.

    Attributes:
        arrives: Whether it leads from start to goal.
        colliding: Whether something touches.
        over_jerk: Whether it needs more than the arms' jerk limits.
        off_grasp: Whether a hand leaves its grasp of the rod.
    """

    arrives: bool
    colliding: bool
    over_jerk: bool
    off_grasp: bool


def measure(inputs: BenchInputs) -> BenchTable:
    """Plan `repeats_n` draws of every set."""
    planner = Planner(config=inputs.config.plan.planner)
    planner.plan_to_joints(GROUP, planner.robot.home, planner.robot.home + 0.05)  # compiles
    planners: dict[str, PlanAll] = {
        "minidual": plan_minidual,
        "minidual, to hand poses": plan_to_poses,
    }
    title = "hard planning queries"
    notes = list(_NOTES)
    if inputs.peers:
        planners["OMPL, MuJoCo, toppra"] = plan_with_ompl
        try:
            planners["roboplan"] = _with_roboplan(Roboplan(inputs.roboplan))
        except EnvironmentMissingError as error:
            missing = f"{error.message}. Type: {error.remedy}"
            inputs.advance(missing)
            title = f"{title}, WITHOUT roboplan"
            notes.append(missing)
    rows: list[BenchRow] = []
    for name in SETS:
        rows += _set_rows(name, planners, planner, inputs)
    return BenchTable(title, (*DRAWS, *RUNS), tuple(rows), tuple(notes))


def _set_rows(
    name: str,
    planners: Mapping[str, PlanAll],
    planner: Planner,
    inputs: BenchInputs,
) -> list[BenchRow]:
    """Return the row of a set's draws, and a row per planner."""
    query_set = SETS[name]
    queries = [posed(draw(query_set, inputs.seed, k), planner) for k in range(inputs.repeats_n)]
    rows = [BenchRow(name, counted(queries), {})]
    inputs.advance(f"{name}: {rows[0].numbers}")
    plannable = [query for query in queries if query.plannable]
    for planner_name, plan_all in planners.items():
        if query_set.rod and plan_all is plan_to_poses:
            continue  # a held rod's goal is its pose anyway
        runs = plan_all(plannable, planner, BUDGET_S)
        row = BenchRow(f"{name}: {planner_name}", judged(plannable, runs, planner), {})
        rows.append(row)
        for query, run in zip(plannable, runs, strict=True):
            if run.trajectory is None:
                inputs.advance(f"query {query.drawn.index}, {run.cpu_s:.1f} s: {run.reason}")
        inputs.advance(f"{row.name}: {row.numbers}")
    return rows


def counted(queries: Sequence[PosedQuery]) -> dict[str, int]:
    """Return how many were drawn, are proven infeasible, have no known posture."""
    infeasible_n = sum(bool(query.infeasible) for query in queries)
    plannable_n = sum(query.plannable for query in queries)
    return {
        "drawn": len(queries),
        "infeasible": infeasible_n,
        "no_posture": len(queries) - infeasible_n - plannable_n,
    }


def judged(
    queries: Sequence[PosedQuery],
    runs: Sequence[Run],
    planner: Planner,
) -> dict[str, int | float]:
    """Return the numbers of one planner on plannable queries."""
    times_ms: list[float] = []
    solved: list[PathFaults] = []
    early_n = 0
    for query, run in zip(queries, runs, strict=True):
        if run.trajectory is None:
            early_n += run.cpu_s < _EARLY_SHARE * BUDGET_S
            continue
        faults = look(query.drawn, run.trajectory, planner)
        if faults.arrives and run.cpu_s <= BUDGET_S:
            solved.append(faults)
            times_ms.append(1e3 * run.cpu_s)
    colliding_n = sum(faults.colliding for faults in solved)
    numbers: dict[str, int | float] = {
        "solved": len(solved),
        "timed_out": len(queries) - len(solved),
        "early": early_n,
        "colliding": colliding_n,
        "over_jerk": sum(faults.over_jerk for faults in solved),
        "off_grasp": sum(faults.off_grasp for faults in solved),
    }
    if queries:
        low, high = wilson_interval(len(solved) - colliding_n, len(queries))
        numbers["low_pct"] = 100.0 * low
        numbers["high_pct"] = 100.0 * high
    if times_ms:
        numbers["median_ms"] = float(np.median(times_ms))
        numbers["p99_ms"] = float(np.percentile(times_ms, 99))
    return numbers


def look(drawn: DrawnQuery, trajectory: Trajectory, planner: Planner) -> PathFaults:
    """Sample a timed path of a query every 0.002 rad."""
    Q = collision_samples(trajectory)
    arrives = _is_at(drawn.start, Q[0], planner) and _is_at(drawn.goal, Q[-1], planner)
    off_grasp = drawn.T_world_rod is not None and _leaves_rod(Q, planner)
    return PathFaults(
        arrives=arrives,
        colliding=planner.engines(drawn.scene).audit(trajectory).collisions_n > 0,
        over_jerk=not jerk_ratio(trajectory, planner.robot) <= 1.0,  # NaN is over
        off_grasp=off_grasp,
    )


def _is_at(targets: Mapping[str, Array], q: Array, planner: Planner) -> bool:
    """Return whether the hands are at T_world_tcp (4, 4)."""
    poses = planner.kinematics.tcp_poses(q)
    return all(_same(T, targets[arm]) for arm, T in zip(SIDES, poses, strict=True))


def _same(T: Array, other: Array) -> bool:
    distance_m = np.linalg.norm(T[:3, 3] - other[:3, 3])
    angle_rad = np.linalg.norm(pin.log3(T[:3, :3].T @ other[:3, :3]))
    return bool(distance_m <= _ARRIVED_M and angle_rad <= _ARRIVED_RAD)


def _leaves_rod(Q: Array, planner: Planner) -> bool:
    """Return whether a hand leaves its grasp of the rod on the postures Q (T, n)."""
    grasps = rod_grasps()
    T_left_rod = inverse(grasps["left"])
    hands = HandsIK((grasps["left"], grasps["right"]), planner.robot)
    Ts_world_rod = np.array([planner.kinematics.tcp_poses(q)[0] @ T_left_rod for q in Q])
    off_m, off_rad = hands.strays(Q, Ts_world_rod)
    return not (off_m <= RESIDUAL_MAX_M and off_rad <= RESIDUAL_MAX_RAD)  # NaN leaves


def jerk_ratio(trajectory: Trajectory, robot: Robot) -> float:
    """Return the largest jerk over its limit, from samples; the motion starts and ends at rest."""
    at_rest = np.zeros((1, robot.dof))
    changes = np.abs(np.diff(np.vstack([at_rest, trajectory.a, at_rest]), axis=0))
    return float((changes / trajectory.dt_s / robot.jerk_max).max())


def plan_with_ompl(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
    """Plan with plain OMPL and toppra."""
    return [plan_ompl(query.motion, planner, budget_s) for query in queries]


def _with_roboplan(roboplan: Roboplan) -> PlanAll:
    def plan_all(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
        return roboplan.plan([query.motion for query in queries], planner, budget_s)

    return plan_all


def plan_minidual(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
    """Plan to the postures, or to the rod's goal."""
    wall_s = budget_s / core_share()
    return [_run(query, planner, wall_s, to_poses=False) for query in queries]


def plan_to_poses(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
    """Plan to the hands' poses, in any posture: inverse kinematics counts."""
    wall_s = budget_s / core_share()
    return [_run(query, planner, wall_s, to_poses=True) for query in queries]


def _run(query: PosedQuery, planner: Planner, wall_s: float, *, to_poses: bool) -> Run:
    drawn = query.drawn
    motion = query.motion
    held = HeldPlanner(planner)
    planner.engines(drawn.scene)

    def plan() -> PlanResult | Trajectory:
        if drawn.T_world_rod is not None:
            grasps = rod_grasps()
            request = HeldQuery(
                motion.q_start,
                drawn.T_world_rod,
                (grasps["left"], grasps["right"]),
                drawn.scene,
                drawn.seed,
            )
            return held.plan(request, budget_s=wall_s)
        if to_poses:
            return planner.plan_to_poses(
                GROUP,
                motion.q_start,
                drawn.goal,
                scene=drawn.scene,
                seed=drawn.seed,
                budget_s=wall_s,
            )
        return planner.plan_to_joints(
            GROUP,
            motion.q_start,
            motion.q_goal,
            scene=drawn.scene,
            seed=drawn.seed,
            budget_s=wall_s,
        )

    attempt = attempted(plan)
    result = attempt.result
    trajectory = result.trajectory if isinstance(result, PlanResult) else result
    return Run(trajectory, attempt.cpu_s, attempt.message)
