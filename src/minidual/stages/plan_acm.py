"""`minidual plan --acm`: the pairs of links that are not checked for collision, and why."""

import dataclasses
from collections import Counter
from pathlib import Path

from minidual.collision.acm import acm_report
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import load_scene
from minidual.gate.stage import ToolContext, ToolResult
from minidual.robot.pair import Robot, robot_from

_MEANINGS = {
    "rigid": "carried by one joint: they cannot move against each other",
    "adjacent": "neighbours along the chain: their hulls overlap at the joint",
    "model": "ruled out by the model of the arm or its hand",
    "always": "touch at home and in at least 95 % of the samples",
    "never": "touched in none of the samples",
    "user": "allowed by the scene file",
}
"""Why two links may touch, by the first word of the reason."""


def scene_of(context: ToolContext, robot: Robot) -> tuple[PlanningScene, list[str]]:
    """Return the scene of --scene and notes on its meshes, or an empty scene."""
    if "scene" in context.options:
        return load_scene(Path(context.options["scene"]), robot)
    return PlanningScene(robot=robot), []


def plan_acm(context: ToolContext) -> ToolResult:
    """Return the robot's matrix of allowed collisions, modified by --scene."""
    robot = robot_from(context.config.robot)
    report = acm_report(robot)
    scene, scene_notes = scene_of(context, robot)
    allowed = sorted(scene.allowed)
    lines = [f"{first:26s} {second:26s} {reason}" for first, second, reason in allowed]
    kinds = Counter(_kind(reason) for _, _, reason in allowed)
    kind_notes = [
        f"{count:4d} {kind:9s} {_MEANINGS[kind]}" for kind, count in sorted(kinds.items())
    ]
    total = (
        f"{len(allowed)} pairs may touch, {len(scene.checked_pairs)} of this scene are checked; "
        "pairs of different arms always are"
    )
    data = {
        "allowed": [
            {"first": first, "second": second, "reason": reason}
            for first, second, reason in allowed
        ],
        "checked": [list(pair) for pair in scene.checked_pairs],
        "built": dataclasses.asdict(report),
    }
    notes = [*scene_notes, *kind_notes, total, *report.lines()]
    return ToolResult(lines, notes, data)


def _kind(reason: str) -> str:
    """Return the first word of a reason, which is free text if a scene file gives it."""
    word = reason.split(" ")[0]
    return word if word in _MEANINGS else "user"
