"""Film of the mode demonstration."""

from collections.abc import Iterator

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.control.stack import ControlStack
from minidual.plant.render import Camera, Image
from minidual.plant.world import World
from minidual.show.figures.film import FILM_FPS
from minidual.trials.modes_turns import Turn

FILM_SIZE = (720, 540)
_BAR_PX = 64
_LAST_S = 1.0
_COLOURS = {"moveit": (32, 108, 214), "teleop": (20, 140, 90), "policy": (150, 62, 190)}
_NOBODY = (96, 96, 96)


def filmed(steps: Iterator[Turn], stack: ControlStack[World], camera: Camera) -> Iterator[Image]:
    """Run `steps`; yield captioned frames at FILM_FPS, the last one for 1 s."""
    frames, world = 0, stack.plant
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
    whole = Picture.new("RGB", (width, height + _BAR_PX), _NOBODY if source is None else _COLOURS[source])
    whole.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(whole)
    large, small = ImageFont.load_default(size=22), ImageFont.load_default(size=15)
    driver = f"{source} drives" if source is not None else f"{turn.mode} requested: arms held"
    state = f"arbiter: {stack.state}   t = {stack.plant.time:5.1f} s"
    active = f"controllers: {' + '.join(stack.manager.active)}"
    draw.text((14, height + 6), driver, fill="white", font=large)
    draw.text((14, height + 38), turn.caption, fill="white", font=small)
    draw.text((width - 14, height + 10), state, fill="white", font=small, anchor="ra")
    draw.text((width - 14, height + 38), active, fill="white", font=small, anchor="ra")
    return np.asarray(whole)
