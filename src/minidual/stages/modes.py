"""`minidual modes`: planner, leader and policy hand over the arms in one process, filmed."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from minidual.control.stack import ControlStack
from minidual.control.supervisor import dumping
from minidual.demos.leader import follows_swiftly
from minidual.durable import expanded, write_csv, write_text
from minidual.errors import ExitCode, GateClosedError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.progress import ProgressTask
from minidual.gate.stage import ToolContext, ToolResult
from minidual.motion.api import Planner
from minidual.plant.recorder import Recorder
from minidual.plant.render import Camera, StampedImage, write_video
from minidual.plant.world import World
from minidual.policies.pilot import load_runtime
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.show.figures.film import FILM_FPS
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.figures.film_model import painted
from minidual.show.watch import StackNarrator, watched
from minidual.skills.operator import ScriptedOperator
from minidual.skills.supervised import trial_supervisor
from minidual.stages.config_checks import check_carry
from minidual.stages.modes_film import FILM_SIZE, filmed
from minidual.tasks.catalogue import make_task, task_config
from minidual.trials import modes_turns
from minidual.trials.modes import DEFAULT_MODES, ModesDemo, parse_modes
from minidual.trials.modes_turns import Turn

_INTERRUPT_SHARE = 0.55
"""Share of a planner's motion after which it is interrupted, but for the last."""


def modes(context: ToolContext) -> ToolResult:
    """Run the demonstration; write film and log.

    Exit 1 if a switch exceeds a bound or the demonstration ends early.
    """
    check_carry(context.config)
    context = replace(context, config=task_config(context.config))
    config = context.config
    typed_modes = context.options.get("modes")
    names = DEFAULT_MODES if typed_modes is None else parse_modes(typed_modes)
    checkpoint = find_checkpoint(context) if "policy" in names else None
    world = World(config.scene, robot_from(config.robot), visuals=True)
    with Camera.recorded(world.model, config.scene.camera) as eyes:
        demo = _demo(context, world, eyes, names, checkpoint)
        _film(context, demo, world, len(names))
    passed = demo.ended is None and not demo.exceeded(config.arbiter)
    record = {
        "modes": list(names),
        "checkpoint": str(checkpoint) if checkpoint else None,
        "seed": context.seed,
        **demo.record(config.arbiter),
    }
    write_csv(context.output / "modes.csv", demo.rows)
    write_text(context.output / "modes.json", dumps(record))
    notes = _notes(demo, context)
    if demo.ended is not None:
        notes.append(f"ENDED TOO EARLY: {demo.ended}")
    if passed:
        notes.append("every step at every switch within its bound")
    notes.append(f"log, film: {context.folder}")
    lines = [str(context.folder / name) for name in ("modes.json", "modes.mp4")]
    code = ExitCode.PASS if passed else ExitCode.ACCEPTANCE_FAILED
    return ToolResult(lines, notes, record, code)


def _film(context: ToolContext, demo: ModesDemo, world: World, modes_n: int) -> None:
    """Run the demonstration and write modes.mp4."""

    def phase() -> tuple[str, str | None]:
        return "" if demo.turn is None else demo.turn.caption, None

    narrate = StackNarrator(demo.stack, Kinematics(world.robot), "modes", phase)
    with (
        FilmCamera(painted(world.scene, world.robot, world.model), FILM_SIZE) as camera,
        watched(context.view, world, narrate),
        context.progress.task("modes", modes_n) as bar,
    ):
        frames = filmed(_counted(demo, bar), demo.stack, camera)
        write_video(context.output / "modes.mp4", frames, fps=FILM_FPS)


def find_checkpoint(context: ToolContext) -> Path:
    """Return the named policy or the run's own.

    Raises:
        UsageError: The named folder has no policy.
        GateClosedError: The run has no trained policy.
    """
    named = context.options.get("checkpoint")
    own = context.run_folder / "train-act" / "checkpoint"
    folder = own if named is None else expanded(named)
    if (folder / "config.json").is_file():
        return folder
    if named is not None:
        raise UsageError(f"--checkpoint {named}: there is no policy (config.json) in that folder")
    raise GateClosedError(
        f"mode 'policy' needs a trained policy, "
        f"and the run '{context.run_folder.name}' has none ({folder})",
        remedy=f"{context.command('run --until train-act')}; or name one with --checkpoint PATH; "
        "or leave the policy out with --modes moveit,teleop,moveit",
    )


def _demo(
    context: ToolContext,
    world: World,
    eyes: Camera,
    names: tuple[str, ...],
    checkpoint: Path | None,
) -> ModesDemo:
    """Return the demonstration of the named modes in turn, from the goal of a trial."""
    config = context.config
    seed = context.seed
    robot = world.robot
    task = make_task(config)
    trial = task.trial(seed, "modes", 0)
    world.reset(poses=trial.goal)  # as the last carry left it
    recorder = Recorder(world, window_s=1.0, seed=seed, folder=context.run_folder / "dumps")
    world.recorder = recorder
    rate_hz = config.teleop.rate_hz
    stack = ControlStack(
        world,
        Kinematics(robot),
        config.arbiter,
        rate_hz=rate_hz,
        supervisor=trial_supervisor(config.supervisor, world.dt, robot, dumping(recorder)),
    )
    if follows_swiftly(config.teleop):  # as the policy's demonstrations were led
        stack.anticipate(rate_hz)
    planner = Planner(config=config.plan.planner, robot=robot)
    operator = ScriptedOperator(config.scene, config.teleop.operator, kinematics=Kinematics(robot))

    def picture(name: str) -> StampedImage:
        return eyes.stamped(world.data, name)

    turns: list[Turn] = []
    for number, mode in enumerate(names, start=1):
        last = number == len(names)
        if mode == "moveit":
            goes_home = last and number > 1
            share = 1.0 if last else _INTERRUPT_SHARE
            turns.append(modes_turns.moveit(stack, planner, seed, home=goes_home, share=share))
        elif mode == "teleop":
            turns.append(modes_turns.teleop(stack, operator, trial, seed, rate_hz))
        elif checkpoint is not None:
            runtime = load_runtime(checkpoint, config.deploy, robot)
            turns.append(modes_turns.policy(stack, runtime, picture, task, trial))
    return ModesDemo(stack, turns)


def _counted(demo: ModesDemo, bar: ProgressTask) -> Iterator[Turn]:
    """Run the demonstration; count its turns."""
    for turn, steps in itertools.groupby(demo.steps()):
        yield from steps
        bar.advance(note=f"{turn.mode} done")


def _notes(demo: ModesDemo, context: ToolContext) -> list[str]:
    """Return what each switch and turn measured, and what was refused or exceeded."""
    arbiter = context.config.arbiter
    notes: list[str] = []
    for switch in demo.switches:
        bounds = ", ".join(
            f"{name} {value:.3g} (bound {bound:g})"
            for name, (value, bound) in switch.bounds(arbiter).items()
        )
        wait_s = switch.confirmed_s - switch.requested_s
        notes.append(
            f"switch to {switch.mode} at {switch.requested_s:.2f} s, "
            f"confirmed after {wait_s:.2f} s: {bounds}",
        )
    for outcome in demo.outcomes:
        values = ", ".join(
            f"{name} {_rounded(value)}" for name, value in outcome.items() if name != "mode"
        )
        notes.append(f"{outcome['mode']}: {values}")
    refused = [refusal.name for refusal in demo.stack.refusals]
    notes += [f"refused as {name}: {refused.count(name)}" for name in sorted(set(refused))]
    notes += [f"OVER ITS BOUND: {text}" for text in demo.exceeded(arbiter)]
    return notes


def _rounded(value: object) -> object:
    return np.round(value, 4) if isinstance(value, float | list) else value
