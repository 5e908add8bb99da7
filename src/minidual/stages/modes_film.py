"""The film of `minidual modes`: the scene above a bar that names the driver.

Postures are kept while it runs and drawn afterwards: a plant on a network does not wait for pictures.
"""

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.control.stack import ControlStack
from minidual.plant.protocol import Plant
from minidual.plant.render import Image
from minidual.plant.simulation import Simulation
from minidual.robot.pair import Array
from minidual.show.figures.film import FILM_FPS
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.forces import force_arrows
from minidual.show.view.overlay import Arrow
from minidual.trials.modes_turns import Turn

FILM_SIZE = (640, 360)
_BAR_PX = 64
_LAST_S = 1.0
"""How long the last frame stays."""
_COLOURS = {"moveit": (32, 108, 214), "teleop": (20, 140, 90), "policy": (150, 62, 190)}
_NOBODY = (96, 96, 96)


class Bar(NamedTuple):
    """Text of the bar under a picture."""

    driver: str
    caption: str
    state: str
    controllers: str
    colour: tuple[int, int, int]

    @classmethod
    def of(cls, stack: ControlStack[Plant], turn: Turn) -> "Bar":
        """Return the text of this moment."""
        source = stack.output.active_source
        if source is None:
            colour = _NOBODY
            driver = f"{turn.mode} requested: arms held"
        else:
            colour = _COLOURS[source]
            driver = f"{source} drives"
        state = f"arbiter: {stack.state}   t = {stack.plant.time:5.1f} s"
        controllers = f"controllers: {' + '.join(stack.manager.active)}"
        return cls(driver, turn.caption, state, controllers, colour)


class Shot(NamedTuple):
    """One frame, before it is drawn.

    Attributes:
        qpos: (nq,).
        arrows: Forces of the hands.
        bar: Under the picture.
    """

    qpos: Array
    arrows: tuple[Arrow, ...]
    bar: Bar


def shots_of(
    steps: Iterator[Turn],
    stack: ControlStack[Plant],
    world: Simulation,
) -> list[Shot]:
    """Run `steps`; return the frames of a film at FILM_FPS."""
    shots: list[Shot] = []
    began_s = stack.plant.time
    for turn in steps:
        if (stack.plant.time - began_s) * FILM_FPS >= len(shots):
            bar = Bar.of(stack, turn)
            shots.append(Shot(world.data.qpos.copy(), force_arrows(world), bar))
    return shots


def frames_of(shots: list[Shot], model: mujoco.MjModel) -> Iterator[Image]:
    """Draw shots with a film's model; yield captioned frames, the last one for 1 s."""
    frame: Image | None = None
    with FilmCamera(model, FILM_SIZE) as camera:
        for shot in shots:
            frame = captioned(camera.picture(shot.qpos, shot.arrows), shot.bar)
            yield frame
    if frame is not None:
        yield from [frame] * round(_LAST_S * FILM_FPS)


def captioned(picture: Image, bar: Bar) -> Image:
    """Return the picture (H, W, 3) above a caption bar."""
    height, width = picture.shape[:2]
    frame = Picture.new("RGB", (width, height + _BAR_PX), bar.colour)
    frame.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(frame)
    large = ImageFont.load_default(size=22)
    small = ImageFont.load_default(size=15)
    left = 14
    right = width - 14
    draw.text((left, height + 6), bar.driver, fill="white", font=large)
    draw.text((left, height + 38), bar.caption, fill="white", font=small)
    draw.text((right, height + 10), bar.state, fill="white", font=small, anchor="ra")
    draw.text((right, height + 38), bar.controllers, fill="white", font=small, anchor="ra")
    return np.asarray(frame)
