"""Film of the three modes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.control.stack import ControlStack
from minidual.plant.render import Camera, Image
from minidual.plant.world import World
from minidual.show.figures.film import FILM_FPS

FILM_SIZE = (720, 540)
_BAR_PX = 64
_LAST_S = 1.0
_COLOURS = {"moveit": (32, 108, 214), "teleop": (20, 140, 90), "policy": (150, 62, 190)}
_NOBODY = (96, 96, 96)


def filmed(
    steps: Iterator[tuple[str, str]], stack: ControlStack[World], world: World, camera: Camera
) -> Iterator[Image]:
    """Run `steps`; yield captioned frames at FILM_FPS, the last one for 1 s."""
    count = 0
    mode = doing = ""
    for mode, doing in steps:
        if world.time * FILM_FPS >= count:
            count += 1
            yield captioned(camera.picture(world.data, "overview"), stack, mode, doing)
    last = captioned(camera.picture(world.data, "overview"), stack, mode, doing)
    for _ in range(round(_LAST_S * FILM_FPS)):
        yield last


def captioned(picture: Image, stack: ControlStack[World], mode: str, doing: str) -> Image:
    """Return the picture above a caption bar."""
    height, width = picture.shape[:2]
    source = stack.output.active_source
    colour = _NOBODY if source is None else _COLOURS[source]
    whole = Picture.new("RGB", (width, height + _BAR_PX), colour)
    whole.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(whole)
    large, small = ImageFont.load_default(size=22), ImageFont.load_default(size=15)
    driver = f"{source} drives" if source is not None else f"{mode} requested: arms held"
    draw.text((14, height + 6), driver, fill="white", font=large)
    draw.text((14, height + 38), doing, fill="white", font=small)
    arbiter = f"arbiter: {stack.state}"
    active = f"controllers: {' + '.join(stack.manager.active)}"
    draw.text(
        (width - 14, height + 10), f"{arbiter}   t = {stack.plant.time:5.1f} s", fill="white", font=small, anchor="ra"
    )
    draw.text((width - 14, height + 38), active, fill="white", font=small, anchor="ra")
    return np.asarray(whole)
