"""`minidual plan --to` and `--acm`: one goal, and the link pairs not checked for collision; no verdict, no gate."""

import dataclasses
import os
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from minidual.collision.acm import acm_report
from minidual.collision.errors import (
    ClosedChainError,
    LinearMoveError,
    NoPathInTimeError,
    TimingError,
)
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import load_scene
from minidual.durable import disk_errors
from minidual.errors import ExitCode, UsageError
from minidual.gate.stage import ToolContext, ToolResult
from minidual.motion.api import Planner, PlanResult
from minidual.motion.goal import goal_of
from minidual.motion.goal_plan import GoalPlanner
from minidual.proof.scene_engines import CLEARANCE_MAX_M
from minidual.registry import rows_beside
from minidual.robot.pair import GROUP_ARMS, Array, Robot, robot_from

_ENDINGS = {"out": ".json", "csv": ".csv", "picture": ".png"}
_BUDGET_MAX_S = 600.0
Targets = dict[str, Path]
"""Output files by option."""
_MEANINGS: dict[str, str] = rows_beside(__file__)


def plan_once(context: ToolContext) -> ToolResult:
    """Plan from --from to --to; exit 1 if no path, 2 if the query is invalid."""
    options = context.options
    targets = {
        name: path
        for name, end in _ENDINGS.items()
        if (path := target_file(name, options.get(name), end))
    }
    group = options.get("group", "both_arms")
    budget_s = options.get("budget-s")
    if budget_s is not None and not 0.0 < budget_s <= _BUDGET_MAX_S:
        raise UsageError(f"--budget-s is {budget_s:g}; 0 < value <= {_BUDGET_MAX_S:g}")
    planner, scene, q_start, notes = _prepare(context, group)
    goal = goal_of(options["to"], planner.states)
    try:
        result = planner.plan(
            group,
            q_start,
            goal,
            scene=scene,
            seed=context.seed,
            budget_s=budget_s,
        )
    except (NoPathInTimeError, TimingError, ClosedChainError, LinearMoveError) as error:
        notes += [f"remedy: {error.remedy}"] if error.remedy else []
        data = {"solved": False, "group": group, "reason": error.reason, "message": error.message}
        return ToolResult([f"no path: {error.message}"], notes, data, ExitCode.ACCEPTANCE_FAILED)
    title = f"{group} to {options['to']}"
    notes += _write(targets, context, scene, result, title)
    if context.view is not None:
        from minidual.show.planning import Poser, play

        once = sys.stdin is None or not sys.stdin.isatty()  # else until closed or Ctrl-C
        with suppress(KeyboardInterrupt):
            poser = Poser(context.config.scene, scene)
            play(context.view, poser, result.trajectory, title, rounds_n=1 if once else None)
    clearance = _clearance(
        planner.planner.engines(scene).clearance(result.trajectory),
        scene.min_distance_m,
    )
    return ToolResult(_lines(title, result, clearance), notes, _document(group, result, targets))


def _scene(context: ToolContext, robot: Robot) -> tuple[PlanningScene, list[str]]:
    if "scene" in context.options:
        return load_scene(Path(context.options["scene"]), robot)
    return PlanningScene(robot=robot), []


def _prepare(
    context: ToolContext,
    group: str,
) -> tuple[GoalPlanner, PlanningScene, Array, list[str]]:
    GROUP_ARMS[group]  # refuses an unknown name
    config = context.config
    scene, notes = _scene(context, robot_from(config.robot))
    planner = GoalPlanner(Planner(scene, config.plan.planner), config.semantics)
    q_home = planner.states.joints("home", "both_arms", planner.robot.home)
    start = goal_of(context.options.get("from", "home"), planner.states)
    # A start places both arms; a one-hand start leaves the other at home.
    of_group = start.poses or start.move or len(start.joints_rad or q_home) != planner.robot.dof
    q_start = planner.start_joints(
        group if of_group else "both_arms",
        q_home,
        start,
        scene,
        seed=context.seed,
    )
    return planner, scene, q_start, notes


def target_file(name: str, text: str | None, ending: str) -> Path | None:
    """Return the output path; UsageError if it cannot be written."""
    if text is None:
        return None
    path = Path(text)
    if path.suffix != ending:
        raise UsageError(f"--{name} {path} must end in {ending}")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise UsageError(f"there is no folder {path.parent}", remedy="make it first")
    if path.is_dir():
        raise UsageError(f"--{name} {path} is a folder", remedy="name a file")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise UsageError(
            f"--{name} {path} cannot be written: no permission",
            remedy="name another file",
        )
    return path


def _write(
    targets: Targets,
    context: ToolContext,
    scene: PlanningScene,
    result: PlanResult,
    title: str,
) -> list[str]:
    notes = [*result.notes]
    motion = result.trajectory
    names = scene.robot.joint_names
    for name, target in targets.items():
        with disk_errors(target):
            if name == "picture":
                from minidual.show.planning import write_picture

                write_picture(target, context.config.scene, scene, motion, title)
            elif name == "csv":
                motion.write_csv(target, names)
            else:
                motion.write_json(target, names)
        notes.append(f"{'picture' if name == 'picture' else 'trajectory'}: {target}")
    return notes


def _lines(title: str, result: PlanResult, clearance: str) -> list[str]:
    proof = result.verification
    planned_s = result.total_s - result.times_s.get("scene", 0.0)
    spent = ", ".join(f"{name} {1e3 * s:.1f}" for name, s in result.times_s.items() if s > 0.0)
    way = "straight line" if result.direct else f"{len(result.path)} vertices"
    tried = f"{result.attempts_n} attempt{'s' if result.attempts_n != 1 else ''}"
    limits = ("velocity", "acceleration", "jerk", "torque")
    return [
        f"{title}: {result.trajectory.duration_s:.3f} s of motion, planned and proven in {planned_s * 1e3:.1f} ms",
        "  (the first plan of a process loads compiled code; a planner that stays needs milliseconds)",
        f"  phases [ms]   {spent}",
        f"  way           {way}, {tried}",
        f"  clearance     {clearance}",
        f"  of limits     {', '.join(f'{name} {getattr(proof, f"{name}_ratio"):.0%}' for name in limits)}",
        f"  joint margin  {proof.limit_margin_rad:.3f} rad",
    ]


def _clearance(clearance_m: float, min_distance_m: float) -> str:
    text = f"{'at least ' if clearance_m >= CLEARANCE_MAX_M else ''}{clearance_m * 1e3:.1f} mm"
    return (
        text
        if min_distance_m == 0.0
        else f"{text} beyond the {min_distance_m * 1e3:g} mm that the scene asks for"
    )


def _document(group: str, result: PlanResult, targets: Targets) -> dict[str, Any]:
    return {
        "solved": True,
        "group": group,
        "duration_s": result.trajectory.duration_s,
        **{
            name: getattr(result, name)
            for name in ("total_s", "times_s", "attempts_n", "direct", "notes")
        },
        "q_goal_rad": result.q_goal.tolist(),
        "proof": result.verification._asdict(),
        "digest": result.trajectory.digest(),
        "files": {name: str(path) for name, path in targets.items()},
    }


def plan_acm(context: ToolContext) -> ToolResult:
    """Return the robot's matrix, modified by --scene."""
    robot = robot_from(context.config.robot)
    report = acm_report(robot)
    scene, notes = _scene(context, robot)
    table = sorted(scene.allowed)
    lines = [f"{first:26s} {second:26s} {reason}" for first, second, reason in table]
    words = (reason.split(" ")[0] for _, _, reason in table)
    kinds = Counter(word if word in _MEANINGS else "user" for word in words)
    notes += [f"{count:4d} {kind:9s} {_MEANINGS[kind]}" for kind, count in sorted(kinds.items())]
    checked = f"{len(scene.checked_pairs)} of this scene are checked"
    notes += [
        f"{len(table)} pairs may touch, {checked}; pairs of different arms always are",
        *report.lines(),
    ]
    data = {
        "allowed": [{"first": a, "second": b, "reason": r} for a, b, r in table],
        "checked": [list(pair) for pair in scene.checked_pairs],
        "built": dataclasses.asdict(report),
    }
    return ToolResult(lines, notes, data)
