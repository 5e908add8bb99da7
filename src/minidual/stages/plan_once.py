"""`minidual plan --to`: one plan to a goal; no verdict, no gate."""

import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from minidual.collision.errors import (
    ClosedChainError,
    LinearMoveError,
    NoPathInTimeError,
    PlanningError,
    TimingError,
)
from minidual.collision.scene import PlanningScene
from minidual.durable import disk_errors
from minidual.errors import ExitCode, UsageError
from minidual.gate.stage import ToolContext, ToolResult
from minidual.motion.api import Planner, PlanResult
from minidual.motion.goal import Goal, goal_of
from minidual.motion.goal_plan import GoalPlanner
from minidual.proof.scene_engines import CLEARANCE_MAX_M
from minidual.robot.pair import GROUP_ARMS, Array, Robot, robot_from
from minidual.stages.output_file import target_file
from minidual.stages.plan_acm import scene_of

_ENDINGS = {"out": ".json", "csv": ".csv", "picture": ".png"}
"""Ending of the file that each option names."""
_BUDGET_MAX_S = 600.0
_UNSOLVED = (NoPathInTimeError, TimingError, ClosedChainError, LinearMoveError)
"""Errors of a valid query without a plan."""
Targets = dict[str, Path]
"""Output files by option."""


class _Query(NamedTuple):
    """A start in a scene, and the planner from there.

    Attributes:
        q_start: (n,) [rad], both arms.
        notes: On the meshes of the scene.
    """

    planner: GoalPlanner
    scene: PlanningScene
    q_start: Array
    notes: list[str]


def plan_once(context: ToolContext) -> ToolResult:
    """Plan from --from to --to; exit 1 if no path, 2 if the query is invalid."""
    options = context.options
    targets = _targets(options)
    group = options.get("group", "both_arms")
    budget_s = _budget(options.get("budget-s")) or context.config.plan.planner.budget_s
    query = _query(context, group)
    scene = query.scene
    goal = goal_of(options["to"], query.planner.states)
    try:
        result = query.planner.plan(
            group,
            query.q_start,
            goal,
            scene=scene,
            seed=context.seed,
            budget_s=budget_s,
        )
    except _UNSOLVED as error:
        return _unsolved(group, error, query.notes)
    title = f"{group} to {options['to']}"
    notes = [*query.notes, *_write(targets, context, scene, result, title)]
    if context.view is not None:
        _play(context, scene, result, title)
    engines = query.planner.planner.engines(scene)
    clearance = clearance_text(engines.clearance(result.trajectory), scene.min_distance_m)
    return ToolResult(_lines(title, result, clearance), notes, _document(group, result, targets))


def _targets(options: Any) -> Targets:
    targets: Targets = {}
    for option, ending in _ENDINGS.items():
        path = target_file(option, options.get(option), ending)
        if path is not None:
            targets[option] = path
    return targets


def _budget(budget_s: float | None) -> float | None:
    if budget_s is not None and not 0.0 < budget_s <= _BUDGET_MAX_S:
        raise UsageError(f"--budget-s is {budget_s:g}; 0 < value <= {_BUDGET_MAX_S:g}")
    return budget_s


def _query(context: ToolContext, group: str) -> _Query:
    """Return the query of --scene, --from and --group.

    Raises:
        UsageError: No such group, state or file, or an invalid start.
    """
    GROUP_ARMS[group]  # refuses an unknown name
    config = context.config
    scene, notes = scene_of(context, robot_from(config.robot))
    planner = GoalPlanner(Planner(scene, config.plan.planner), config.semantics)
    q_home = planner.states.joints("home", "both_arms", planner.robot.home)
    start = goal_of(context.options.get("from", "home"), planner.states)
    places_both_arms = _places_both_arms(start, planner.robot)
    q_start = planner.start_joints(
        "both_arms" if places_both_arms else group,
        q_home,
        start,
        scene,
        seed=context.seed,
    )
    return _Query(planner, scene, q_start, notes)


def _places_both_arms(start: Goal, robot: Robot) -> bool:
    """Return whether a start places both arms; a start of one hand leaves the other at home."""
    if start.poses or start.move:
        return False
    return not start.joints_rad or len(start.joints_rad) == robot.dof


def _unsolved(group: str, error: PlanningError, notes: list[str]) -> ToolResult:
    remedies = [f"remedy: {error.remedy}"] if error.remedy else []
    data = {"solved": False, "group": group, "reason": error.reason, "message": error.message}
    return ToolResult(
        [f"no path: {error.message}"],
        [*notes, *remedies],
        data,
        ExitCode.ACCEPTANCE_FAILED,
    )


def _play(context: ToolContext, scene: PlanningScene, result: PlanResult, title: str) -> None:
    """Show the motion: once without a terminal, else until Ctrl-C or the view is closed."""
    from minidual.show.planning import Poser, play

    interactive = sys.stdin is not None and sys.stdin.isatty()
    with suppress(KeyboardInterrupt):
        poser = Poser(context.config.scene, scene)
        rounds_n = None if interactive else 1
        play(
            context.view,
            poser,
            result.trajectory,
            title,
            rounds_n=rounds_n,
            proven=result.verification.ok,
        )


def _write(
    targets: Targets,
    context: ToolContext,
    scene: PlanningScene,
    result: PlanResult,
    title: str,
) -> list[str]:
    """Write the requested files; return the notes of the plan and one for each file."""
    notes = [*result.notes]
    motion = result.trajectory
    names = scene.robot.joint_names
    for option, target in targets.items():
        with disk_errors(target):
            if option == "picture":
                from minidual.show.planning import write_picture

                write_picture(target, context.config.scene, scene, motion, title)
            elif option == "csv":
                motion.write_csv(target, names)
            else:
                motion.write_json(target, names)
        content = "picture" if option == "picture" else "trajectory"
        notes.append(f"{content}: {target}")
    return notes


def _lines(title: str, result: PlanResult, clearance: str) -> list[str]:
    proof = result.verification
    planned_ms = 1e3 * (result.total_s - result.times_s.get("scene", 0.0))
    phases = ", ".join(f"{name} {1e3 * s:.1f}" for name, s in result.times_s.items() if s > 0.0)
    way = "straight line" if result.direct else f"{len(result.path)} vertices"
    attempts = "1 attempt" if result.attempts_n == 1 else f"{result.attempts_n} attempts"
    ratios = {
        "velocity": proof.velocity_ratio,
        "acceleration": proof.acceleration_ratio,
        "jerk": proof.jerk_ratio,
        "torque": proof.torque_ratio,
    }
    of_limits = ", ".join(f"{name} {ratio:.0%}" for name, ratio in ratios.items())
    motion = f"{result.trajectory.duration_s:.3f} s of motion"
    not_limited: list[str] = []
    if proof.reported_only:
        names = ", ".join(name.replace("_", " ") for name in proof.reported_only)
        not_limited = [f"  not limited   {names}: the timing engine does not keep them"]
    return [
        f"{title}: {motion}, planned and proven in {planned_ms:.1f} ms",
        "  (the first plan of a process loads compiled code; a planner that stays needs milliseconds)",
        f"  phases [ms]   {phases}",
        f"  way           {way}, {attempts}",
        f"  clearance     {clearance}",
        f"  of limits     {of_limits}",
        *not_limited,
        f"  joint margin  {proof.limit_margin_rad:.3f} rad",
    ]


def clearance_text(clearance_m: float, min_distance_m: float) -> str:
    """Return, for example, "at least 50.0 mm beyond the 10 mm that the scene asks for"."""
    text = f"{clearance_m * 1e3:.1f} mm"
    if clearance_m >= CLEARANCE_MAX_M:
        text = f"at least {text}"
    if min_distance_m == 0.0:
        return text
    return f"{text} beyond the {min_distance_m * 1e3:g} mm that the scene asks for"


def _document(group: str, result: PlanResult, targets: Targets) -> dict[str, Any]:
    return {
        "solved": True,
        "group": group,
        "duration_s": result.trajectory.duration_s,
        "total_s": result.total_s,
        "times_s": result.times_s,
        "attempts_n": result.attempts_n,
        "direct": result.direct,
        "notes": result.notes,
        "q_goal_rad": result.q_goal.tolist(),
        "proof": result.verification._asdict(),
        "digest": result.trajectory.digest(),
        "files": {option: str(path) for option, path in targets.items()},
    }
