"""`minidual plan --acm`: link pairs not checked for collision, and why."""

import dataclasses
from collections import Counter
from pathlib import Path

from minidual.collision.acm import acm_report
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import load_scene
from minidual.gate.tool import ToolContext, ToolResult
from minidual.robot.arms import robot_from

_MEANINGS = {
    "rigid": "carried by one joint: they cannot move against each other",
    "adjacent": "neighbours along the chain: their hulls overlap at the joint",
    "model": "ruled out by the model of the arm or its hand",
    "always": "touch at home and in at least 95 % of the samples",
    "never": "touched in none of the samples",
}


def plan_acm(context: ToolContext) -> ToolResult:
    """Return the robot's matrix, modified by --scene."""
    robot = robot_from(context.config.robot)
    report = acm_report(robot)
    scene = PlanningScene(robot=robot)
    notes: list[str] = []
    if "scene" in context.options:
        scene, notes = load_scene(Path(context.options["scene"]), robot)
    table = sorted(scene.allowed)
    lines = [f"{first:26s} {second:26s} {reason}" for first, second, reason in table]
    kinds = Counter(_kind(reason) for _, _, reason in table)
    notes += [
        f"{count:4d} {kind:9s} {_MEANINGS.get(kind, 'allowed by the scene file')}"
        for kind, count in sorted(kinds.items())
    ]
    notes += [
        (
            f"{len(table)} pairs may touch, {len(scene.checked_pairs)} of this scene are checked; pairs of different arms "
            "always are"
        ),
        *report.lines(),
    ]
    data = {
        "allowed": [{"first": a, "second": b, "reason": r} for a, b, r in table],
        "checked": [list(pair) for pair in scene.checked_pairs],
        "built": dataclasses.asdict(report),
    }
    return ToolResult(lines, notes, data)


def _kind(reason: str) -> str:
    word = reason.split(" ")[0]
    return word if word in _MEANINGS else "user"
