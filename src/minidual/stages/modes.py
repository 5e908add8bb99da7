"""`minidual modes`: planner, leader and policy hand over the arms in one process, filmed."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor, dumping
from minidual.durable import write_text
from minidual.errors import ExitCode, GateClosedError, UsageError
from minidual.gate.canonical import canonical, dumps
from minidual.gate.progress import Task as Bar
from minidual.gate.tool import ToolContext, ToolResult
from minidual.motion.api import Planner
from minidual.plant.recorder import Recorder
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.show.figures.film import FILM_FPS
from minidual.show.figures.modes_film import FILM_SIZE, filmed
from minidual.show.view import Overlay
from minidual.show.watch import watched
from minidual.skills.operator import ScriptedOperator
from minidual.skills.supervised import arm_distance
from minidual.tasks.task import Task, Trial, make_task
from minidual.trials.modes import DEFAULT_MODES, ModesDemo, ModesResult, SwitchError, parse_modes
from minidual.trials.modes_drivers import Driver, MoveitDriver, PolicyDriver, TeleopDriver

_INTERRUPT_SHARE = 0.55
"""Share of the planner's first motion before it is interrupted."""


def modes(context: ToolContext) -> ToolResult:
    """Run the demonstration, write film and log, and check switches; exit 1 if a bound fails or it ends early."""
    named = context.options.get("modes")
    wanted = DEFAULT_MODES if named is None else parse_modes(named)
    checkpoint = find_checkpoint(context) if "policy" in wanted else None
    result = _run(context, wanted, checkpoint)
    return ToolResult(
        lines=[str(context.folder / "modes.json"), str(context.folder / "modes.mp4")],
        notes=_notes(result, context),
        data=result.to_json(),
        exit_code=ExitCode.PASS if result.passed else ExitCode.ACCEPTANCE_FAILED,
    )


def find_checkpoint(context: ToolContext) -> Path:
    """Return the named policy or the run's own.

    Raises:
        UsageError: The named folder has no policy.
        GateClosedError: The run has no trained policy.
    """
    named = context.options.get("checkpoint")
    if named is not None:
        folder = Path(named).expanduser()
        if not (folder / "config.json").is_file():
            raise UsageError(f"--checkpoint {named}: there is no policy (config.json) in that folder")
        return folder
    folder = context.run_folder / "train-act" / "checkpoint"
    if not (folder / "config.json").is_file():
        raise GateClosedError(
            f"mode 'policy' needs a trained policy, and the run '{context.run_folder.name}' has none ({folder})",
            remedy=f"{context.command('run --until train-act')}; or name one with --checkpoint PATH; or leave the "
            "policy out with --modes moveit,teleop,moveit",
        )
    return folder


def _run(context: ToolContext, wanted: tuple[str, ...], checkpoint: Path | None) -> ModesResult:
    config = context.config
    robot = robot_from(config.robot)
    world = World(config.scene, robot, visuals=True)
    job = make_task(config)
    trial = job.trial(context.seed, "modes", 0)
    world.reset(poses=trial.goal)  # as the last carry left it
    world.recorder = Recorder(world, window_s=1.0, seed=context.seed, folder=context.run_folder / "dumps")
    kinematics = Kinematics(robot)
    supervisor = Supervisor(
        config.supervisor,
        dt_s=world.dt,
        kinematics=Kinematics(robot),
        self_distance=arm_distance(robot),
        on_reflex=dumping(world.recorder),
    )
    stack = ControlStack(world, kinematics, config.arbiter, rate_hz=config.teleop.rate_hz, supervisor=supervisor)
    with Camera.recorded(world.model, config.scene.camera) as eyes:
        turns = _turns(context, stack, job, trial, checkpoint, wanted, lambda name: eyes.picture(world.data, name))
        demo = ModesDemo(stack, turns)
        stopped: list[str] = []

        def tell() -> Overlay:
            source = stack.output.active_source or ""
            return Overlay(title="modes", mode=demo.mode, source=source, state=str(stack.state), status=demo.doing)

        with (
            Camera(world.model, *FILM_SIZE, shadows=True) as camera,
            watched(context.view, world, tell),
            context.progress.task("modes", len(wanted)) as task,
        ):
            pictures = filmed(_counted(demo.steps(), task, stopped), stack, world, camera)
            write_video(context.output / "modes.mp4", pictures, fps=FILM_FPS)
    result = demo.result(config.arbiter, ended="; ".join(stopped))
    demo.recorder.write_csv(context.output / "modes.csv")
    document = {
        "modes": list(wanted),
        "checkpoint": str(checkpoint) if checkpoint else None,
        "seed": context.seed,
        **result.to_json(),
        "bounds": [
            {"mode": s.mode, **{n: {"value": v, "bound": b} for n, v, b in s.bounds(config.arbiter)}}
            for s in result.switches
        ],
    }
    write_text(context.output / "modes.json", dumps(canonical(document)))
    return result


def _turns(
    context: ToolContext,
    stack: ControlStack[World],
    job: Task,
    trial: Trial,
    checkpoint: Path | None,
    wanted: tuple[str, ...],
    picture: Callable[[str], Image],
) -> list[tuple[str, Callable[[], Driver]]]:
    """Return (mode, driver factory) per turn, with shared resources."""
    config, seed, robot = context.config, context.seed, stack.plant.robot
    planner = Planner(config=config.plan.planner, robot=robot)
    operator = ScriptedOperator(config.scene, config.teleop.operator)
    runtime: Any = None
    if checkpoint is not None:
        from minidual.policies.pilot import load_runtime  # torch takes seconds to load

        runtime = load_runtime(checkpoint, config.deploy, robot)

    def make(mode: str, last: bool) -> Driver:
        if mode == "moveit":
            share = 1.0 if last else _INTERRUPT_SHARE
            return MoveitDriver(stack, planner, seed, home=last, share=share)
        if mode == "teleop":
            return TeleopDriver(stack, operator, trial, seed, config.teleop.rate_hz)
        return PolicyDriver(stack, runtime, picture, job, trial)

    return [(mode, functools.partial(make, mode, k == len(wanted))) for k, mode in enumerate(wanted, start=1)]


def _counted(steps: Iterator[tuple[str, str]], task: Bar, stopped: list[str]) -> Iterator[tuple[str, str]]:
    """Yield the steps and count turns; a stop or failed mode ends them, its reason appended to `stopped`."""
    before: tuple[str, str] | None = None
    try:
        for now in steps:
            if before is not None and now != before:
                task.advance(note=f"{before[0]} done")
            before = now
            yield now
    except (SwitchError, ReflexError) as error:  # log and film are kept
        stopped.append(str(error))
    task.advance(note="film")


def _notes(result: ModesResult, context: ToolContext) -> list[str]:
    bounds = result.switches[0].bounds(context.config.arbiter)
    first_step, torque = bounds[0][2], bounds[3][2]
    notes = [
        "switch to   asked at  confirmed  fastest joint  first step  reference step  torque step (asked for)",
        "                   s          s          rad/s         rad    rad in 1 ms  Nm in 1 ms",
    ]
    notes += [
        f"{s.mode:<10}{s.requested_s:>10.2f}{s.confirmed_s:>11.2f}{s.speed_at_request_rad_s:>15.2f}"
        f"{s.first_step_rad:>12.4f}{s.reference_step_rad:>15.5f}{s.torque_step_nm:>12.2f} ({s.torque_step_asked_nm:.1f})"
        for s in result.switches
    ]
    notes.append(f"{'bound':<46}{first_step:>12.4f}{'speed limit':>15}{torque:>12.2f}")
    for outcome in result.outcomes:
        what = ", ".join(
            f"{k} {np.round(v, 4) if isinstance(v, float | list) else v}" for k, v in outcome.items() if k != "mode"
        )
        notes.append(f"{outcome['mode']}: {what}")
    for name in sorted({r[1] for r in result.refusals}):
        notes.append(f"refused as {name}: {sum(r[1] == name for r in result.refusals)}")
    notes += [f"OVER ITS BOUND: {fault}" for fault in result.faults]
    if result.ended:
        notes.append(f"ENDED TOO EARLY: {result.ended}")
    if result.passed:
        notes.append("every step at every switch within its bound")
    notes.append(f"log, film: {context.folder}")
    return notes
