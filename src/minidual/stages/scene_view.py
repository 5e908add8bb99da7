"""`minidual view`: the scene in real time, driven by the view's sliders."""

import contextlib
import itertools
import math
import signal
import threading
import time
from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from minidual.config.root import changed
from minidual.control.commands import JointCommand
from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext, ToolResult
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot, robot_from
from minidual.show.view import View
from minidual.show.view.overlay import Slider
from minidual.show.watch import Brake, StackNarrator, watched
from minidual.tasks.catalogue import TASKS, task_config

_SOURCE = "teleop"
_SLICE_S = 0.02
"""Time between two readings of the sliders: one tick of the arbiter, which limits their speed."""


def joint_sliders(robot: Robot) -> list[Slider]:
    """Return one slider per joint, at home, and then one per hand, open."""
    sliders: list[Slider] = []
    for side, arm in zip(robot.sides, robot.arms, strict=True):
        limits = zip(arm.q_lower, arm.q_upper, arm.home, strict=True)
        for i, (lower, upper, home) in enumerate(limits):
            label = f"joint {i + 1} [rad]"
            sliders.append(Slider(f"{side} arm", label, float(lower), float(upper), float(home)))
    for side in robot.sides:
        sliders.append(Slider(f"{side} arm", "hand, 0 closed to 1 open", 0.0, 1.0, 1.0))
    return sliders


@contextlib.contextmanager
def interruptions() -> Generator[threading.Event]:
    """Yield an event set by Ctrl-C or SIGTERM; libraries may swallow KeyboardInterrupt."""
    stop = threading.Event()
    before = {
        number: signal.signal(number, lambda *_: stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Shown(NamedTuple):
    """How long a scene was shown."""

    simulated_s: float
    wall_s: float


def _show(
    context: ToolContext,
    view: View,
    task: str,
    stopped: Callable[[], bool],
    for_s: float,
) -> _Shown:
    """Simulate the scene of a task in real time, until another one is chosen or it must end."""
    config = context.config
    if task != config.task:
        config = changed(config, {"task": task})
    robot = robot_from(config.robot)
    world = World(task_config(config).scene, robot)
    kinematics = Kinematics(robot)
    stack = ControlStack(world, kinematics, config.arbiter)
    brake = Brake(1.0)
    sequence = itertools.count(1)
    stack.request(_SOURCE)
    narrate = StackNarrator(stack, kinematics, f"{task}: the sliders move the arms")
    with watched(view, world, narrate):
        began_s = time.monotonic()
        while view.alive and not stopped() and view.panel.choice in ("", task):
            if time.monotonic() - began_s >= for_s:
                break
            *joints, left_gripper, right_gripper = view.panel.values()
            target = np.clip(joints, robot.q_lower, robot.q_upper)
            grippers = np.array([left_gripper, right_gripper])
            stack.propose(_SOURCE, JointCommand(target, grippers, world.time, next(sequence)))
            for _ in range(round(_SLICE_S / world.dt)):
                stack.step()
            brake.hold(world.time)
    return _Shown(world.time, time.monotonic() - began_s)


def view_scene(context: ToolContext) -> ToolResult:
    """Run in real time until Ctrl-C (exit 0), --for-s or the view ends.

    Raises:
        UsageError: --view none, or --for-s not above 0.
    """
    view = context.view
    if view is None:
        raise UsageError("`minidual view` needs a view", remedy="--view web")
    for_s = float(context.options.get("for-s", math.inf))
    if not for_s > 0.0:
        raise UsageError(f"--for-s is {for_s:g}; it must be above 0")
    task = context.config.task
    simulated_s = 0.0
    wall_s = 0.0
    view.panel.offer_choice("task", list(TASKS))
    view.panel.offer(joint_sliders(robot_from(context.config.robot)))
    with interruptions() as stop:
        while view.alive and not stop.is_set() and wall_s < for_s:
            shown = _show(context, view, task, stop.is_set, for_s - wall_s)
            simulated_s += shown.simulated_s
            wall_s += shown.wall_s
            task = view.panel.choice or task
    data = {
        "view": view.name,
        "url": view.url,
        "simulated_s": simulated_s,
        "wall_s": round(wall_s, 3),
    }
    note = f"showed {simulated_s:.1f} s of simulated time in {wall_s:.1f} s"
    return ToolResult(notes=[note], data=data)
