"""`minidual doctor`: look for every known fault of this machine, and of what a run holds.

The simulator's stages run again at a small size, in a folder of the tool. Results, recordings and
policy of the run are read back.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from minidual.config.root import Config
from minidual.demos.checks import Thumbnails, camera_references, check_swapped, thumbnails
from minidual.demos.episode import episode_paths, inspect_episode
from minidual.errors import EnvironmentMissingError, ExitCode, MinidualError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, ToolContext, ToolResult, markdown
from minidual.policies.demonstrations import load_demonstrations
from minidual.policies.policy import exercise_checkpoint
from minidual.policies.takes import read_takes
from minidual.robot.pair import robot_from
from minidual.stages.train_act import action_checks
from minidual.stages.troubles.diagnosis import Fault, as_lines, diagnose, level_of
from minidual.stages.troubles.trouble import LEVELS

_LAST_STAGE = "carry"
"""The last of the stages that run again."""
_QUERIES_N = 2
_CARRIES_N = 1
"""Queries of each group, and carries: enough to see a fault, few enough for a minute."""
_SEED = 1
"""Of the stages that run again. The draws of some seeds take a minute to find."""


class Examination(NamedTuple):
    """Result of a part.

    Attributes:
        examined: What was examined, or "" for nothing.
        faults: Known faults that it has.
    """

    examined: str
    faults: Sequence[Fault]


type Examine = Callable[[ToolContext], Examination]


def doctor(context: ToolContext) -> ToolResult:
    """Examine every part, whatever is wrong with the others; exit 1 if anything is."""
    rows: list[dict[str, Any]] = []
    findings: list[Fault] = []
    for part, examine in _parts(context).items():
        context.progress.note(f"doctor: {part}")
        examined, part_faults = _examine(context, part, examine)
        rows.append(
            {"part": part, "examined": examined or "nothing yet", "faults": len(part_faults)},
        )
        findings += part_faults
    table = context.gate.table
    upstream = {name: [other for other in table.until(name) if other != name] for name in table}
    faults = diagnose(findings, upstream)
    code = ExitCode.ACCEPTANCE_FAILED if faults else ExitCode.PASS
    documents = [_document(fault) for fault in faults]
    lines = [*markdown(rows), *as_lines(faults)]
    return ToolResult(lines, data={"parts": rows, "faults": documents}, exit_code=code)


def _document(fault: Fault) -> dict[str, Any]:
    return {
        "part": fault.part,
        "level": LEVELS[fault.level].name,
        "name": fault.name,
        "detail": fault.detail,
        "remedy": fault.remedy,
        "count": fault.count,
        "follows": fault.follows or None,
        "trouble": fault.trouble or None,
    }


def _parts(context: ToolContext) -> dict[str, Examine]:
    stages = {name: partial(stage, name) for name in context.gate.table.until(_LAST_STAGE)}
    return {**stages, "results": results, "recordings": recordings, "policy": policy}


def _examine(context: ToolContext, part: str, examine: Examine) -> Examination:
    """Examine a part; an error that ends it is a fault."""
    try:
        return examine(context)
    except MinidualError as error:
        missing = isinstance(error, EnvironmentMissingError)
        level = level_of(part, "error", environment=missing)
        return Examination("stopped", [Fault(part, "error", error.message, error.remedy, level)])


def _fault(part: str, name: str, detail: str, remedy: str | None) -> Fault:
    return Fault(part, name, detail, remedy, level_of(part, name))


def stage(name: str, context: ToolContext) -> Examination:
    """Run a stage with the run's settings, at a small size, and without pictures."""
    entry = context.gate.table[name]
    folder = context.output / name
    folder.mkdir()
    stage_context = StageContext(
        config=entry.resolved(_small(context.config), checked=True),
        seed=_SEED,
        profile="smoke",
        folder=folder,
        progress=context.progress,
        workers=context.workers,
        view=context.view,
        pictures=False,
    )
    result = entry.load()(stage_context)
    return Examination(f"{len(result.checks)} checks", _failed(name, result.checks))


def _small(config: Config) -> Config:
    """Return the configuration with as few queries, moves and carries as tell, and a short swing."""
    period_s = 1.0 / config.env_check.sine_frequency_hz
    swing_s = min(max(1.0, period_s), config.env_check.sine_duration_s)
    held = config.plan.held.model_copy(update={"moves_n": 2, "executed_n": 1})
    plan_sizes = {"queries_n": _QUERIES_N, "second_queries_n": 0, "held": held}
    sections = {
        "env_check": config.env_check.model_copy(update={"sine_duration_s": swing_s}),
        "plan": config.plan.model_copy(update=plan_sizes),
        "carry": config.carry.model_copy(update={"trials_n": _CARRIES_N}),
    }
    return config.model_copy(update=sections)


def _failed(part: str, checks: Sequence[Check]) -> list[Fault]:
    return [
        _fault(part, check.name, check.sentence(), check.remedy)
        for check in checks
        if check.passed is False
    ]


def results(context: ToolContext) -> Examination:
    """Judge the stages that have run or were begun."""
    states = [context.gate.state(name) for name in context.gate.table]
    begun = [s for s in states if s.state not in ("missing", "blocked")]
    faults = [
        replace(
            _fault(
                "results",
                f"{s.name} is {s.state}",
                s.why(),
                context.command(f"explain {s.name}"),
            ),
            stage=s.name,
        )
        for s in begun
        if s.state != "pass"
    ]
    return Examination(", ".join(s.name for s in begun), faults)


def recordings(context: ToolContext) -> Examination:
    """Inspect every episode, alone and beside the others."""
    config = context.config
    robot = robot_from(config.robot)
    paths = episode_paths(context.run_folder / "teleop-record" / "episodes")
    faults: list[Fault] = []
    views: dict[str, Thumbnails] = {}
    for path in paths:
        episode, own_faults = inspect_episode(path, cameras=config.teleop.cameras, robot=robot)
        faults += [
            _fault("recordings", fault.name, f"{path.name}: {fault.detail}", fault.remedy)
            for fault in own_faults
        ]
        if episode is not None and not own_faults:
            views[path.name] = thumbnails(episode.images)
    references = camera_references(list(views.values()))
    for name, thumbs in views.items():
        faults += [
            _fault("recordings", fault.name, f"{name}: {fault.detail}", fault.remedy)
            for fault in check_swapped(thumbs, references)
        ]
    return Examination(f"{len(paths)} episodes" if paths else "", faults)


def policy(context: ToolContext) -> Examination:
    """Read the whole dataset, pictures too, and let the trained policy answer to it."""
    train = context.config.train
    dataset = context.run_folder / "teleop-record" / "lerobot"
    checkpoint = context.run_folder / "train-act" / "checkpoint"
    if not dataset.is_dir():
        return Examination("", [])
    takes = read_takes(checkpoint)
    demos = load_demonstrations(
        dataset,
        train.cameras,
        folder=context.output,
        inputs=() if takes is None else tuple(takes.inputs),
    )
    if not checkpoint.is_dir():
        return Examination(f"dataset of {len(demos)} ticks", [])
    robot = robot_from(context.config.robot)
    emitted = exercise_checkpoint(checkpoint, demos, robot)
    checks = action_checks(emitted, train, robot)
    return Examination(f"dataset of {len(demos)} ticks, checkpoint", _failed("policy", checks))
