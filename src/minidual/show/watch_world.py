"""Show a world in a live view while it runs; what is shown is read, so the run is the one without a view."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.constants import TCP_NAMES, Array
from minidual.show.view.overlay import LEFT_RGB, NO_PREVIEW, RIGHT_RGB, Arrow, Overlay, Preview
from minidual.show.view.pace import Brake
from minidual.show.view.protocol import View

_ASIDE_M = np.array([0.05, 0.0, 0.0])
"""Forces are drawn this far in front of the hands: where they act, the object would hide them."""
_BRAKE_EVERY_S = 0.01
_LOOK_S = 0.7
"""A film stands still this long at its end."""


@dataclass(frozen=True)
class Narration:
    """What the one who moves the arms knows, and a world does not; see minidual.show.view.Overlay."""

    title: str = ""
    mode: str = ""
    source: str = ""
    state: str = ""
    status: str = ""
    preview: Preview = NO_PREVIEW


Narrator = Callable[[], Narration]


@functools.lru_cache(maxsize=2)
def _visual_model(scene_json: str) -> mujoco.MjModel:
    return build_model(SceneConfig.model_validate_json(scene_json), visuals=True)


def visual_model(scene: SceneConfig) -> mujoco.MjModel:
    """Return the model of a scene with its visual meshes, compiled once; its bodies are those of any other."""
    return _visual_model(scene.model_dump_json())


def overlay(world: World, narration: Narration) -> Overlay:
    """Return what a view shows of a world besides its bodies: time, forces at the hands, who drives."""
    pinch = world.pinch_forces()
    arrows: list[Arrow] = []
    hands = zip(TCP_NAMES, world.hand_forces(), (LEFT_RGB, RIGHT_RGB), strict=True)
    for name, force, rgb in hands:
        start: Array = world.data.body(name).xpos + _ASIDE_M
        arrows.append(Arrow(start, np.array(force), rgb))
    return Overlay(
        time_s=world.time,
        title=narration.title,
        mode=narration.mode,
        source=narration.source,
        state=narration.state,
        status=narration.status,
        pinch_n=(float(pinch[0]), float(pinch[1])),
        internal_n=world.internal_force(),
        arrows=tuple(arrows),
        preview=narration.preview,
    )


class Watcher:
    """Shows one world; call it after every step, which costs a look at the clock until a picture is due.

    Args:
        view: Where to show it; opened on the visual model of the world's scene.
        world: The world.
        narrate: Asked for words and plans once a picture.
        speed_max: Simulated seconds a second that may not be exceeded; 0 for no limit.
    """

    def __init__(self, view: View, world: World, narrate: Narrator, *, speed_max: float = 0.0) -> None:
        view.open(visual_model(world.scene))
        self._view = view
        self._narrate = narrate
        self._brake = Brake(speed_max) if speed_max > 0.0 else None
        self._braked_s = float("-inf")

    def __call__(self, world: World) -> None:
        """Show the world if a picture is due."""
        if self._brake is not None and abs(world.time - self._braked_s) >= _BRAKE_EVERY_S:
            self._braked_s = world.time
            self._brake.hold(world.time)
        if self._view.due():
            self._view.update(world.data, overlay(world, self._narrate()))


@contextmanager
def watched(view: View | None, world: World, narrate: Narrator, *, speed_max: float = 0.0) -> Iterator[None]:
    """Show every step of `world` inside the block; without a view nothing is done at all."""
    if view is None:
        yield
        return
    before, world.observer = world.observer, Watcher(view, world, narrate, speed_max=speed_max)
    try:
        yield
    finally:
        world.observer = before


def play(view: View, scene: SceneConfig, times: Array, qs: Array, narration: Narration, *, speed: float = 1.0) -> None:
    """Show postures (n, 14) at `times` (n,) [s] as a film at `speed` times real time; nothing is simulated.

    The rod lies where the scene has it. Ends early when nobody can see it any more.
    """
    world = World(scene)
    began = time.monotonic()
    view.open(visual_model(scene))
    while view.alive:
        t = min((time.monotonic() - began) * speed, float(times[-1]))
        world.data.qpos[world.joints.qpos] = [np.interp(t, times, column) for column in qs.T]
        world.data.time = t
        mujoco.mj_kinematics(world.model, world.data)
        ended = t >= times[-1]
        if ended or view.due():
            words = Overlay(
                time_s=t,
                title=narration.title,
                mode=narration.mode,
                source=narration.source,
                state=narration.state,
                status=narration.status,
                preview=narration.preview,
            )
            view.update(world.data, words)
        if ended:
            time.sleep(_LOOK_S)
            return
        time.sleep(0.005)
