"""`minidual view`: the scene alone, in real time; the arms hold home and go where a person's sliders say."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Generator
from types import FrameType
from typing import TYPE_CHECKING

from minidual.errors import UsageError
from minidual.gate.tool import ToolContext, ToolResult

if TYPE_CHECKING:
    from minidual.robot.pair import Array, Robot
    from minidual.show.view.overlay import Slider

SLIDER_SPEED_RAD_S = 0.8
"""A slider that jumps leads its joint no faster than this."""
_SLICE_S = 0.01
_LOST_S = 0.1
"""Further behind the clock than this, the time is given up: it would be run through in a rush otherwise."""


def joint_sliders(robot: Robot) -> list[Slider]:
    """Return one slider a joint and one a hand, at home and open."""
    from minidual.show.view.overlay import Slider

    sliders = [
        Slider(f"{side} arm", f"joint {i + 1} [rad]", *map(float, row))
        for side in robot.sides
        for i, row in enumerate(zip(robot.arm.q_lower, robot.arm.q_upper, robot.arm.home, strict=True))
    ]
    return [*sliders, *(Slider(f"{arm} arm", "hand, 0 closed to 1 open", 0.0, 1.0, 1.0) for arm in robot.sides)]


def towards(present: Array, wanted: Array, step: float) -> Array:
    """Return `present` moved by at most `step` in each entry towards `wanted`."""
    import numpy as np

    return present + np.clip(wanted - present, -step, step)


@contextlib.contextmanager
def interruptions() -> Generator[threading.Event]:
    """Yield what Ctrl-C or a request to end sets, even where a library swallows the KeyboardInterrupt it raises."""
    stop = threading.Event()

    def note(number: int, frame: FrameType | None) -> None:
        del number, frame
        stop.set()
        raise KeyboardInterrupt

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def view_scene(context: ToolContext) -> ToolResult:
    """Run the scene in real time until Ctrl-C, the end of --for-s, or the closed window.

    Ctrl-C is how a person ends this command, so it is an end like any other.

    Raises:
        UsageError: --view none, or a time that is none.
    """
    with interruptions() as stop:
        return _show(context, stop)


def _show(context: ToolContext, stop: threading.Event) -> ToolResult:
    import numpy as np

    from minidual.control.loop import JointLoop
    from minidual.plant.world import World
    from minidual.robot.arms import robot_from
    from minidual.robot.kinematics import Kinematics
    from minidual.show.view import Overlay
    from minidual.show.watch import watched

    view = context.view
    if view is None:
        raise UsageError("`minidual view` is there to be looked at", remedy="--view web")
    for_s = float(context.options.get("for-s", np.inf))
    if not for_s > 0.0:
        raise UsageError(f"--for-s {for_s:g} is no time; it must be above 0")
    robot = robot_from(context.config.robot)
    world = World(context.config.scene, robot)
    loop = JointLoop(world, Kinematics(robot))
    sliders = joint_sliders(robot)
    offered = view.offer(sliders)
    wanted = np.array([slider.value for slider in sliders])
    target = robot.home.copy()

    def tell() -> Overlay:
        source = "sliders" if offered else "home"
        return Overlay(title="the scene", mode="joint", source=source, state="following joint targets")

    began = time.monotonic()
    with contextlib.suppress(KeyboardInterrupt), watched(view, world, tell):
        began = due = time.monotonic()
        while view.alive and not stop.is_set() and time.monotonic() - began < for_s:
            if offered:
                wanted = view.slider_values()
            for _ in range(round(_SLICE_S / world.dt)):
                aim = np.clip(wanted[:-2], robot.q_lower, robot.q_upper)
                target = towards(target, aim, SLIDER_SPEED_RAD_S * world.dt)
                loop.step(target, wanted[-2:])
            due += _SLICE_S
            ahead = due - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            elif ahead < -_LOST_S:
                due = time.monotonic()
    spent = time.monotonic() - began
    return ToolResult(
        notes=[f"showed {world.time:.1f} s of simulated time in {spent:.1f} s"],
        data={"view": view.name, "url": view.url, "simulated_s": world.time, "wall_s": round(spent, 3)},
    )
