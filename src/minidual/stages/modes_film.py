"""The film of `minidual modes`: the scene above a bar that says who drives."""

from collections.abc import Iterator

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.control.stack import ControlStack
from minidual.plant.render import Image
from minidual.plant.world import World
from minidual.show.figures.film import FILM_FPS
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.forces import force_arrows
from minidual.trials.modes_turns import Turn

FILM_SIZE = (640, 360)
_BAR_PX = 64
_LAST_S = 1.0
"""How long the last frame stays."""
_COLOURS = {"moveit": (32, 108, 214), "teleop": (20, 140, 90), "policy": (150, 62, 190)}
_NOBODY = (96, 96, 96)


def filmed(
    steps: Iterator[Turn], stack: ControlStack[World], camera: FilmCamera
) -> Iterator[Image]:
    """Run `steps`; yield captioned frames at FILM_FPS, the last one for 1 s."""
    frames = 0
    world = stack.plant
    last: Image | None = None
    for turn in steps:
        if world.time * FILM_FPS >= frames:
            frames += 1
            last = captioned(_picture(world, camera), stack, turn)
            yield last
    if last is not None:
        yield from [last] * round(_LAST_S * FILM_FPS)


def _picture(world: World, camera: FilmCamera) -> Image:
    return camera.picture(world.data.qpos, force_arrows(world))


def captioned(picture: Image, stack: ControlStack[World], turn: Turn) -> Image:
    """Return the picture (H, W, 3) above a caption bar."""
    height, width = picture.shape[:2]
    source = stack.output.active_source
    if source is None:
        colour = _NOBODY
        driver = f"{turn.mode} requested: arms held"
    else:
        colour = _COLOURS[source]
        driver = f"{source} drives"
    state = f"arbiter: {stack.state}   t = {stack.plant.time:5.1f} s"
    controllers = f"controllers: {' + '.join(stack.manager.active)}"
    frame = Picture.new("RGB", (width, height + _BAR_PX), colour)
    frame.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(frame)
    large = ImageFont.load_default(size=22)
    small = ImageFont.load_default(size=15)
    left = 14
    right = width - 14
    draw.text((left, height + 6), driver, fill="white", font=large)
    draw.text((left, height + 38), turn.caption, fill="white", font=small)
    draw.text((right, height + 10), state, fill="white", font=small, anchor="ra")
    draw.text((right, height + 38), controllers, fill="white", font=small, anchor="ra")
    return np.asarray(frame)
