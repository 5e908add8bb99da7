"""`minidual doctor`: look for every known fault of this machine, and of what a run holds.

The simulator's stages run again at a small size, in a folder of the tool. What the run holds is read back.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from minidual.config.loader import load_config
from minidual.demos.checks import camera_references, check_swapped, thumbnails
from minidual.demos.episode import episode_paths, inspect_episode
from minidual.errors import ExitCode, MinidualError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, ToolContext, ToolResult, markdown
from minidual.policies.demonstrations import load_demonstrations
from minidual.policies.policy import exercise_checkpoint
from minidual.robot.pair import GRIPPERS_N, robot_from
from minidual.stages.words import worded

_FEW = {
    "plan": ("queries_n", "second_queries_n", "held"),
    "carry": ("trials_n",),
}
"""Sizes taken from `smoke`."""


class Fault(NamedTuple):
    """What is wrong, and what to do."""

    name: str
    detail: str
    remedy: str | None


Examination = tuple[str, Sequence[Fault]]
"""What was examined, or "" for nothing, and its faults."""
Examine = Callable[[ToolContext], Examination]


def doctor(context: ToolContext) -> ToolResult:
    """Examine every part, whatever is wrong with the others; exit 1 if anything is."""
    parts: dict[str, Examine] = {
        name: partial(stage, name) for name in context.gate.table.until("carry")
    }
    parts |= {"results": results, "recordings": recordings, "policy": policy}
    rows = list[dict[str, Any]]()
    found = list[dict[str, Any]]()
    for part, examine in parts.items():
        context.progress.note(f"doctor: {part}")
        try:
            examined, faults = examine(context)
        except MinidualError as error:
            examined = "stopped"
            faults = [Fault("error", error.message, error.remedy)]
        rows.append({"part": part, "examined": examined or "nothing yet", "faults": len(faults)})
        found += [{"part": part, **fault._asdict()} for fault in faults]
    lines = [*markdown(rows), *(() if found else ("", "no known fault found"))]
    for fault in found:
        lines += [
            "",
            "{part}: {name}: {detail}".format(**fault),
            f"  remedy: {fault['remedy'] or 'see the message'}",
        ]
    code = ExitCode.ACCEPTANCE_FAILED if found else ExitCode.PASS
    return ToolResult(lines, data={"parts": rows, "faults": found}, exit_code=code)


def stage(name: str, context: ToolContext) -> Examination:
    """Run a stage with the run's settings, and as many queries and trials as `smoke`."""
    small = load_config("smoke").config
    config = context.config
    entry = context.gate.table[name]
    for part, names in _FEW.items():
        sized = getattr(config, part).model_copy(
            update={size: getattr(getattr(small, part), size) for size in names},
        )
        config = config.model_copy(update={part: sized})
    (folder := context.output / name).mkdir()
    shared: dict[str, Any] = {
        key: getattr(context, key) for key in ("seed", "progress", "workers", "view")
    }
    config = entry.resolved(config, checked=True)
    done = entry.load()(StageContext(config=config, profile="smoke", folder=folder, **shared))
    return f"{len(done.checks)} checks", _failed(done.checks)


def _failed(checks: Sequence[Check]) -> list[Fault]:
    return [
        Fault(check.name, check.sentence(), check.remedy)
        for check in checks
        if check.passed is False
    ]


def results(context: ToolContext) -> Examination:
    """Judge the stages that have run or were begun."""
    states = [
        s
        for s in map(context.gate.state, context.gate.table)
        if s.state not in ("missing", "blocked")
    ]
    bad = [s for s in states if s.state != "pass"]
    found = [
        Fault(f"{s.name} is {s.state}", s.why(), context.command(f"explain {s.name}")) for s in bad
    ]
    return ", ".join(state.name for state in states), found


def recordings(context: ToolContext) -> Examination:
    """Inspect every episode, alone and beside the others."""
    config = context.config
    views = dict[str, Any]()
    faults = list[tuple[str, Any]]()
    paths = episode_paths(context.run_folder / "teleop-record" / "episodes")
    for path in paths:
        episode, own = inspect_episode(
            path,
            cameras=config.teleop.cameras,
            robot=robot_from(config.robot),
        )
        faults += [(path.name, fault) for fault in own]
        if episode is not None and not own:
            views[path.name] = thumbnails(episode.images)
    references = camera_references(list(views.values()))
    faults += [
        (name, fault) for name, seen in views.items() for fault in check_swapped(seen, references)
    ]
    found = [Fault(fault.name, f"{name}: {fault.detail}", fault.remedy) for name, fault in faults]
    return f"{len(paths)} episodes" if paths else "", found


def policy(context: ToolContext) -> Examination:
    """Read the whole dataset, pictures too, and let the trained policy answer to it."""
    dataset = context.run_folder / "teleop-record" / "lerobot"
    train = context.config.train
    checkpoint = context.run_folder / "train-act" / "checkpoint"
    robot = robot_from(context.config.robot)
    if not dataset.is_dir():
        return "", []
    demos = load_demonstrations(dataset, train.cameras, folder=context.output)
    if not checkpoint.is_dir():
        return f"dataset of {len(demos)} ticks", []
    emitted = exercise_checkpoint(checkpoint, demos, robot)
    in_limits = emitted.in_limits, ">=", train.actions_in_limits_min
    rows = {
        "actions_in_limits": in_limits,
        "targets_n": (emitted.targets_n, "==", robot.dof + GRIPPERS_N),
    }
    return f"dataset of {len(demos)} ticks, checkpoint", _failed(worded("train-act", rows))
