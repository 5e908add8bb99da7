"""`minidual modes`: planner, leader and policy hand over the arms in one process, filmed."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from minidual.control.stack import ControlStack
from minidual.demos.leader import follows_swiftly
from minidual.durable import expanded, write_csv, write_text
from minidual.errors import ExitCode, GateClosedError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.progress import ProgressTask
from minidual.gate.stage import ToolContext, ToolResult
from minidual.motion.api import Planner
from minidual.plant.lifecycle import planned_robot
from minidual.plant.render import write_video
from minidual.policies.pilot import load_runtime
from minidual.robot.kinematics import Kinematics
from minidual.show.figures.film import FILM_FPS
from minidual.show.figures.film_model import painted
from minidual.show.figures.modes import draw_modes
from minidual.show.watch import StackNarrator, watched
from minidual.skills.operator import ScriptedOperator
from minidual.skills.supervised import trial_supervisor
from minidual.stages.config_checks import check_together
from minidual.stages.modes_film import Shot, frames_of, shots_of
from minidual.stages.modes_place import ModesPlace, modes_place
from minidual.tasks.catalogue import make_task, task_config
from minidual.tasks.task import Trial
from minidual.trials import modes_turns
from minidual.trials.modes import DEFAULT_MODES, ModesDemo, parse_modes
from minidual.trials.modes_turns import Turn

_INTERRUPT_SHARE = 0.55
"""Share of a planner's motion after which it is interrupted, but for the last."""


def modes(context: ToolContext) -> ToolResult:
    """Run the demonstration; write film and log.

    Exit 1 if a switch exceeds a bound or the demonstration ends early.
    """
    check_together(context.config)
    context = replace(context, config=task_config(context.config))
    config = context.config
    typed_modes = context.options.get("modes")
    names = DEFAULT_MODES if typed_modes is None else parse_modes(typed_modes)
    checkpoint = find_checkpoint(context) if "policy" in names else None
    task = make_task(config)
    trial = task.trial(context.seed, "modes", 0)
    with modes_place(context, trial, names) as place:
        for note in place.notes:
            context.progress.note(note)
        demo = _demo(context, place, names, checkpoint, trial)
        shots = _run(context, demo, place, len(names))
    picture = _drawn(context, demo, place, shots)
    passed = demo.ended is None and not demo.exceeded(config.arbiter)
    record = {
        "modes": list(names),
        "plant": config.plant.address,
        "place": place.kind,
        "checkpoint": str(checkpoint) if checkpoint else None,
        "seed": context.seed,
        **demo.record(config.arbiter),
    }
    write_csv(context.output / "modes.csv", demo.rows)
    write_text(context.output / "modes.json", dumps(record))
    notes = [*place.notes, *_notes(demo, context)]
    if demo.ended is not None:
        notes.append(f"ENDED TOO EARLY: {demo.ended}")
    if passed:
        notes.append("every step at every switch within its bound")
    notes.append(f"log, {'film' if place.world else 'signals'}: {context.folder}")
    lines = [str(context.folder / name) for name in ("modes.json", picture)]
    code = ExitCode.PASS if passed else ExitCode.ACCEPTANCE_FAILED
    return ToolResult(lines, notes, record, code)


def _run(context: ToolContext, demo: ModesDemo, place: ModesPlace, modes_n: int) -> list[Shot]:
    """Run the demonstration; return the frames of its film, none without a world."""

    def phase() -> tuple[str, str | None]:
        return "" if demo.turn is None else demo.turn.caption, None

    with context.progress.task("modes", modes_n) as bar:
        steps = _counted(demo, bar)
        if place.world is None:
            for _ in steps:
                pass
            return []
        narrate = StackNarrator(demo.stack, Kinematics(place.plant.robot), "modes", phase)
        with watched(context.view, place.world, narrate):
            return shots_of(steps, demo.stack, place.world)


def _drawn(context: ToolContext, demo: ModesDemo, place: ModesPlace, shots: list[Shot]) -> str:
    """Write the film, or the signals where no world is seen; return the file's name."""
    world = place.world
    if world is None:
        draw_modes(demo.rows, context.output / "modes.svg")
        return "modes.svg"
    model = painted(world.scene, world.robot, world.model)
    write_video(context.output / "modes.mp4", frames_of(shots, model), fps=FILM_FPS)
    return "modes.mp4"


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
    place: ModesPlace,
    names: tuple[str, ...],
    checkpoint: Path | None,
    trial: Trial,
) -> ModesDemo:
    """Return the demonstration of the named modes in turn."""
    config = context.config
    plant = place.plant
    robot = plant.robot
    rate_hz = config.teleop.rate_hz
    kinematics = Kinematics(robot)
    stack = ControlStack(
        plant,
        kinematics,
        config.arbiter,
        rate_hz=rate_hz,
        supervisor=trial_supervisor(config.supervisor, plant.dt, robot, place.on_reflex),
    )
    if follows_swiftly(config.teleop):  # as the policy's demonstrations were led
        stack.anticipate(rate_hz)
    planner = Planner(config=config.plan.planner, robot=planned_robot(plant))
    operator = ScriptedOperator(config.scene, config.teleop.operator, kinematics=Kinematics(robot))
    turns: list[Turn] = []
    for number, mode in enumerate(names, start=1):
        last = number == len(names)
        if mode == "moveit":
            goes_home = last and number > 1
            share = 1.0 if last else _INTERRUPT_SHARE
            turns.append(
                modes_turns.moveit(
                    stack, planner, context.seed, place.known_object, home=goes_home, share=share
                ),
            )
        elif mode == "teleop":
            seed = context.seed
            turns.append(
                modes_turns.teleop(stack, operator, trial, seed, rate_hz, place.known_object)
            )
        elif checkpoint is not None and place.world is not None and place.senses is not None:
            task = make_task(config)
            runtime = load_runtime(checkpoint, config.deploy, robot, instruction=task.instruction)
            picture = place.senses.picture
            turns.append(
                modes_turns.policy(stack, runtime, picture, task, trial, place.world),
            )
    stack.reset()  # on a plant whose time goes on, it did while all this was made
    return ModesDemo(stack, turns)


def _counted(demo: ModesDemo, bar: ProgressTask) -> Iterator[Turn]:
    """Run the demonstration; count its turns."""
    for turn, steps in itertools.groupby(demo.steps()):
        yield from steps
        bar.advance(note=f"{turn.mode} done")


def _notes(demo: ModesDemo, context: ToolContext) -> list[str]:
    """Return the measurements of each switch and turn, the refusals and the exceeded bounds."""
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
