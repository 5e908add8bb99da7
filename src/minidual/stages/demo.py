"""`minidual demo`: planner, force control and a trained policy on the same start."""

import math
import sys
from contextlib import suppress

from minidual.errors import UsageError
from minidual.gate.stage import ToolContext, ToolResult
from minidual.robot.pair import robot_from
from minidual.show.figures.side_by_side import Take, film_takes, take
from minidual.show.takes_view import play_takes
from minidual.show.view import View
from minidual.stages.checkpoint_choice import chosen_policies
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial
from minidual.trials.benchmark import draw_under
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.metrics import TrialMetrics

PURPOSE = "demo"
"""Random stream of the starts, used by no stage."""
_METHODS = ("moveit", "impedance", "act")


def demo(context: ToolContext) -> ToolResult:
    """Run one start by each method; film them side by side, or play them so in the view.

    Raises:
        UsageError: The task is unknown, the named policy is not there, or the start is below 0.
    """
    start = int(context.options.get("start", 0))
    if start < 0:
        raise UsageError(f"--start is {start}; it must be 0 or more")
    task = make_task(context.config)
    policies = chosen_policies(context, _METHODS, task.name)
    methods = [
        name
        for name in _METHODS
        if (name in policies or not METHODS[name].learned) and not METHODS[name].cannot(task, "")
    ]
    inputs = MethodInputs(task.config, context.seed, policies=policies)
    trial = draw_under(inputs, CLEAN, PURPOSE)(start)
    notes = [f"{name}: {METHODS[name].summary}" for name in methods]
    if not policies:
        notes.append(f"no policy comes with the package for {task.name}; two methods are shown")
    takes = _takes(context, methods, inputs, trial)
    results = [each.result for each in takes]
    film = ""
    if context.view is None:
        name = f"{task.name}.mp4"
        context.progress.note("drawing the film")
        film_takes(takes, context.output / name)
        film = str(context.folder / name)
    else:
        _play(context.view, takes, task)
    lines = [_line(result) for result in results]
    lines += ["", film] if film else []
    lines += ["", *_next_commands(context, task)]
    data = {
        "task": task.name,
        "start": trial.index,
        "results": [result.to_row() for result in results],
        "film": film,
    }
    return ToolResult(lines, notes, data)


def _takes(
    context: ToolContext,
    methods: list[str],
    inputs: MethodInputs,
    trial: Trial,
) -> list[Take]:
    takes: list[Take] = []
    with context.progress.task("trials", len(methods)) as progress:
        for method in methods:
            takes.append(take(method, inputs, trial))
            progress.advance(note=method)
    return takes


def _play(view: View, takes: list[Take], task: Task) -> None:
    """Play the trials side by side: once without a terminal, else until Ctrl-C or the view's end."""
    interactive = sys.stdin is not None and sys.stdin.isatty()
    robot = robot_from(task.config.robot)
    with suppress(KeyboardInterrupt):
        play_takes(view, takes, task.scene, robot, rounds_n=None if interactive else 1)


def _line(result: TrialMetrics) -> str:
    if result.success:
        tilt_deg = math.degrees(result.tilt_max_rad)
        return f"{result.method}: success in {result.duration_s:.2f} s, tilt {tilt_deg:.2f} deg"
    return f"{result.method}: {result.text}"


def _next_commands(context: ToolContext, task: Task) -> list[str]:
    return [
        "Next:",
        f"  {context.command(f'try {task.name} --trials 10')}    compare the methods",
        f"  {context.command(f'demo --task {task.name} --view web')}    watch them in a browser",
    ]
