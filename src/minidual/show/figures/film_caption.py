"""Captions of films."""

import textwrap
from typing import NamedTuple

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.plant.render import Image

_RUNNING = (38, 50, 66)
_SUCCESS = (22, 110, 60)
_FAILURE = (168, 40, 34)
_FRAME_PX = 4
_REFERENCE_WIDTH_PX = 480
_MARGIN_PX = 10
_LARGE_PX = 20
_SMALL_PX = 14
_CHARACTER_SHARE = 0.50
"""Mean width of a character, of the font's size."""
_DETAIL_LINES = 2


class Caption(NamedTuple):
    """Caption below a picture.

    Attributes:
        title: Left, large.
        clock: Right, large.
        text: What goes on, or the result.
        detail: Forces, or why it failed; up to two lines.
        success: None while it is under way.
    """

    title: str
    clock: str
    text: str
    detail: str
    success: bool | None = None

    @property
    def colour(self) -> tuple[int, int, int]:
        """Of the bar, from 0 to 255."""
        if self.success is None:
            return _RUNNING
        return _SUCCESS if self.success else _FAILURE


def bar_height(width_px: int) -> int:
    """Return the height [px] of the bar below a picture; even, as films need it."""
    scale = _scale(width_px)
    text_px = _LARGE_PX + (1 + _DETAIL_LINES) * _SMALL_PX
    return 2 * round(scale * 1.25 * (text_px + _MARGIN_PX) / 2)


def captioned(picture: Image, caption: Caption) -> Image:
    """Return the picture (H, W, 3) above a bar; a failure has a red frame."""
    height, width = picture.shape[:2]
    scale = _scale(width)
    frame = Picture.new("RGB", (width, height + bar_height(width)), caption.colour)
    frame.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(frame)
    if caption.success is False:
        edge = (0, 0, width - 1, height - 1)
        draw.rectangle(edge, outline=caption.colour, width=round(scale * _FRAME_PX))
    large = ImageFont.load_default(size=scale * _LARGE_PX)
    small = ImageFont.load_default(size=scale * _SMALL_PX)
    left = scale * _MARGIN_PX
    top = height + scale * 0.4 * _MARGIN_PX
    draw.text((left, top), caption.title, fill="white", font=large)
    draw.text((width - left, top), caption.clock, fill="white", font=large, anchor="ra")
    top += scale * 1.3 * _LARGE_PX
    characters = int((width - 2 * left) / (scale * _SMALL_PX * _CHARACTER_SHARE))
    lines = [
        *textwrap.wrap(caption.text, characters)[:1],
        *textwrap.wrap(caption.detail, characters, max_lines=_DETAIL_LINES, placeholder=" ..."),
    ]
    for line in lines:
        draw.text((left, top), line, fill="white", font=small)
        top += scale * 1.3 * _SMALL_PX
    return np.asarray(frame)


def _scale(width_px: int) -> float:
    return width_px / _REFERENCE_WIDTH_PX
