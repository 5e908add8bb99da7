"""`minidual modes`: planner, leader and policy hand over the arms in one process, filmed."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.control.stack import ControlStack
from minidual.control.supervisor import dumping
from minidual.durable import expanded, write_csv, write_text
from minidual.errors import ExitCode, GateClosedError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.progress import ProgressTask
from minidual.gate.stage import ToolContext, ToolResult
from minidual.motion.api import Planner
from minidual.plant.recorder import Recorder
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.policies.pilot import load_runtime
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.show.figures.film import FILM_FPS
from minidual.show.watch import StackNarrator, watched
from minidual.skills.operator import ScriptedOperator
from minidual.skills.supervised import trial_supervisor
from minidual.stages.config_checks import check_carry
from minidual.tasks.catalogue import make_task, task_config
from minidual.trials import modes_turns
from minidual.trials.modes import DEFAULT_MODES, ModesDemo, parse_modes
from minidual.trials.modes_turns import Turn

_INTERRUPT_SHARE = 0.55
"""Share of the planner's first motion before it is interrupted."""
_FILM_SIZE = (720, 540)
_BAR_PX = 64
_LAST_S = 1.0
_COLOURS = {"moveit": (32, 108, 214), "teleop": (20, 140, 90), "policy": (150, 62, 190)}
_NOBODY = (96, 96, 96)


def modes(context: ToolContext) -> ToolResult:
    """Run the demonstration; write film and log; exit 1 if a switch exceeds a bound or it ends early."""
    check_carry(context.config)
    context = replace(context, config=task_config(context.config))
    named = context.options.get("modes")
    config = context.config
    wanted = DEFAULT_MODES if named is None else parse_modes(named)
    checkpoint = find_checkpoint(context) if "policy" in wanted else None
    world = World(config.scene, robot_from(config.robot), visuals=True)
    with Camera.recorded(world.model, config.scene.camera) as eyes:
        demo = _demo(context, world, eyes, wanted, checkpoint)
        doing = lambda: ("" if demo.turn is None else demo.turn.caption, None)  # noqa: E731
        with (
            Camera(world.model, *_FILM_SIZE, shadows=True) as camera,
            watched(
                context.view,
                world,
                StackNarrator(demo.stack, Kinematics(world.robot), "modes", doing),
            ),
            context.progress.task("modes", len(wanted)) as bar,
        ):
            write_video(
                context.output / "modes.mp4",
                _filmed(_counted(demo, bar), demo.stack, camera),
                fps=FILM_FPS,
            )
    passed = demo.ended is None and not demo.exceeded(config.arbiter)
    record = {
        "modes": list(wanted),
        "checkpoint": str(checkpoint) if checkpoint else None,
        "seed": context.seed,
    }
    record |= demo.record(config.arbiter)
    write_csv(context.output / "modes.csv", demo.rows)
    write_text(context.output / "modes.json", dumps(record))
    notes = _notes(demo, context)
    if demo.ended is not None:
        notes.append(f"ENDED TOO EARLY: {demo.ended}")
    if passed:
        notes.append("every step at every switch within its bound")
    lines = [str(context.folder / name) for name in ("modes.json", "modes.mp4")]
    code = ExitCode.PASS if passed else ExitCode.ACCEPTANCE_FAILED
    return ToolResult(lines, [*notes, f"log, film: {context.folder}"], record, code)


def find_checkpoint(context: ToolContext) -> Path:
    """Return the named policy or the run's own.

    Raises:
        UsageError: The named folder has no policy.
        GateClosedError: The run has no trained policy.
    """
    named = context.options.get("checkpoint")
    folder = context.run_folder / "train-act" / "checkpoint" if named is None else expanded(named)
    if (folder / "config.json").is_file():
        return folder
    if named is not None:
        raise UsageError(f"--checkpoint {named}: there is no policy (config.json) in that folder")
    none = f"mode 'policy' needs a trained policy, and the run '{context.run_folder.name}' has none ({folder})"
    others = "or name one with --checkpoint PATH; or leave the policy out with --modes moveit,teleop,moveit"
    raise GateClosedError(none, remedy=f"{context.command('run --until train-act')}; {others}")


def _demo(
    context: ToolContext,
    world: World,
    eyes: Camera,
    wanted: tuple[str, ...],
    policy: Path | None,
) -> ModesDemo:
    config = context.config
    seed = context.seed
    robot = world.robot
    task = make_task(config)
    trial = task.trial(seed, "modes", 0)
    world.reset(poses=trial.goal)  # as the last carry left it
    recorder = Recorder(world, window_s=1.0, seed=seed, folder=context.run_folder / "dumps")
    world.recorder = recorder
    supervisor = trial_supervisor(config.supervisor, world.dt, robot, dumping(recorder))
    rate_hz = config.teleop.rate_hz
    stack = ControlStack(
        world,
        Kinematics(robot),
        config.arbiter,
        rate_hz=rate_hz,
        supervisor=supervisor,
    )
    planner = Planner(config=config.plan.planner, robot=robot)
    operator = ScriptedOperator(config.scene, config.teleop.operator, kinematics=Kinematics(robot))
    turns: list[Turn] = []
    for number, mode in enumerate(wanted, start=1):
        if mode == "moveit":
            home = 1 < number == len(wanted)
            share = 1.0 if number == len(wanted) else _INTERRUPT_SHARE
            turns.append(modes_turns.moveit(stack, planner, seed, home=home, share=share))
        elif mode == "teleop":
            turns.append(modes_turns.teleop(stack, operator, trial, seed, rate_hz))
        elif policy is not None:
            picture = lambda name: (eyes.picture(world.data, name), world.time)  # noqa: E731
            turns.append(
                modes_turns.policy(
                    stack,
                    load_runtime(policy, config.deploy, robot),
                    picture,
                    task,
                    trial,
                ),
            )
    return ModesDemo(stack, turns)


def _counted(demo: ModesDemo, bar: ProgressTask) -> Iterator[Turn]:
    for turn, steps in itertools.groupby(demo.steps()):
        yield from steps
        bar.advance(note=f"{turn.mode} done")


def _notes(demo: ModesDemo, context: ToolContext) -> list[str]:
    arbiter = context.config.arbiter
    notes = [
        f"switch to {s.mode} at {s.requested_s:.2f} s, confirmed after {s.confirmed_s - s.requested_s:.2f} s: "
        + ", ".join(
            f"{name} {value:.3g} (bound {bound:g})"
            for name, (value, bound) in s.bounds(arbiter).items()
        )
        for s in demo.switches
    ]
    for outcome in demo.outcomes:
        said = (
            f"{k} {np.round(v, 4) if isinstance(v, float | list) else v}"
            for k, v in outcome.items()
            if k != "mode"
        )
        notes.append(f"{outcome['mode']}: {', '.join(said)}")
    refused = [r.name for r in demo.stack.refusals]
    notes += [f"refused as {name}: {refused.count(name)}" for name in sorted(set(refused))]
    return [*notes, *(f"OVER ITS BOUND: {text}" for text in demo.exceeded(arbiter))]


def _filmed(steps: Iterator[Turn], stack: ControlStack[World], camera: Camera) -> Iterator[Image]:
    """Run `steps`; yield captioned frames at FILM_FPS, the last one for 1 s."""
    frames = 0
    world = stack.plant
    last: Image | None = None
    for turn in steps:
        if world.time * FILM_FPS >= frames:
            frames += 1
            last = captioned(camera.picture(world.data, "overview"), stack, turn)
            yield last
    if last is not None:
        yield from [last] * round(_LAST_S * FILM_FPS)


def captioned(picture: Image, stack: ControlStack[World], turn: Turn) -> Image:
    """Return the picture above a caption bar."""
    height, width = picture.shape[:2]
    source = stack.output.active_source
    whole = Picture.new(
        "RGB",
        (width, height + _BAR_PX),
        _NOBODY if source is None else _COLOURS[source],
    )
    whole.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(whole)
    large = ImageFont.load_default(size=22)
    small = ImageFont.load_default(size=15)
    driver = f"{source} drives" if source is not None else f"{turn.mode} requested: arms held"
    state = f"arbiter: {stack.state}   t = {stack.plant.time:5.1f} s"
    active = f"controllers: {' + '.join(stack.manager.active)}"
    draw.text((14, height + 6), driver, fill="white", font=large)
    draw.text((14, height + 38), turn.caption, fill="white", font=small)
    draw.text((width - 14, height + 10), state, fill="white", font=small, anchor="ra")
    draw.text((width - 14, height + 38), active, fill="white", font=small, anchor="ra")
    return np.asarray(whole)
