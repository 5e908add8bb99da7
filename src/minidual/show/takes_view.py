"""Takes of several methods in the browser, side by side and in step."""

import itertools
import time
from collections.abc import Sequence

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.model import build_spec
from minidual.robot.pair import Array, Robot
from minidual.show.figures.film_caption import Caption
from minidual.show.figures.side_by_side import Take
from minidual.show.view import View
from minidual.show.view.overlay import Arrow, Overlay

APART_M = 2.0
"""Distance of two rooms along y; a table is 1.6 m wide."""
_PAUSE_S = 2.0
"""After each round."""
_SLEEP_S = 0.005
_SHARED_OPTIONS = ("timestep", "impratio", "integrator", "cone")
"""MuJoCo warns of rooms whose options differ from the whole's."""


def rooms_model(scene: SceneConfig, robot: Robot, rooms_n: int) -> mujoco.MjModel:
    """Return a model with copies of a scene; its positions are those of the copies in turn.

    The first copy stands farthest left, seen from the front.
    """
    whole = mujoco.MjSpec()
    for number in range(rooms_n):
        room = build_spec(scene, robot, visuals=True)
        for name in _SHARED_OPTIONS:
            setattr(whole.option, name, getattr(room.option, name))
        whole.visual.map.znear = room.visual.map.znear
        frame = whole.worldbody.add_frame(pos=room_offset(number, rooms_n))
        whole.attach(room, prefix=f"{number}/", frame=frame)
    return whole.compile()


def room_offset(number: int, rooms_n: int) -> Array:
    """Return where the origin (3,) [m] of a copy stands."""
    centred = number - (rooms_n - 1) / 2.0
    return np.array([0.0, APART_M * centred, 0.0])


def play_takes(
    view: View,
    takes: Sequence[Take],
    scene: SceneConfig,
    robot: Robot,
    *,
    rounds_n: int | None,
) -> None:
    """Play takes of one scene in real time, side by side; None repeats until the view is closed."""
    model = rooms_model(scene, robot, len(takes))
    data = mujoco.MjData(model)
    view.open(model, rooms_n=len(takes))
    for round_n in itertools.count(1):
        _play_once(view, takes, model, data)
        if round_n == rounds_n or not view.alive:
            return


def _play_once(
    view: View,
    takes: Sequence[Take],
    model: mujoco.MjModel,
    data: mujoco.MjData,
) -> None:
    longest_s = max(each.end_s for each in takes)
    began_s = time.monotonic()
    time_s = 0.0
    while view.alive and time_s < longest_s + _PAUSE_S:
        time_s = time.monotonic() - began_s
        if view.due():
            data.qpos[:] = np.concatenate([each.at(time_s).qpos for each in takes])
            mujoco.mj_kinematics(model, data)
            view.update(data, takes_overlay(takes, time_s))
        time.sleep(_SLEEP_S)


def takes_overlay(takes: Sequence[Take], time_s: float) -> Overlay:
    """Return the state of all takes at a time: a line for each, and the forces in its room."""
    arrows: list[Arrow] = []
    for number, each in enumerate(takes):
        offset = room_offset(number, len(takes))
        moved = each.at(time_s).arrows
        arrows += [arrow._replace(start=arrow.start + offset) for arrow in moved]
    longest_s = max(each.end_s for each in takes)
    return Overlay(
        time_s=min(time_s, longest_s),
        title="the same start by each method",
        state="played as simulated, side by side",
        lines=tuple((each.title, _words(each.caption(time_s))) for each in takes),
        arrows=tuple(arrows),
    )


def _words(caption: Caption) -> str:
    return f"{caption.text}, {caption.detail}"
