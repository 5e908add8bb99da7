"""Live views behind one small protocol: a window, a page in the browser, or nothing at all."""

from minidual.show.view.overlay import NO_PREVIEW, Arrow, Overlay, PathLine, Preview, Slider
from minidual.show.view.protocol import View
from minidual.show.view.registry import NAMES, make_view

__all__ = ["NAMES", "NO_PREVIEW", "Arrow", "Overlay", "PathLine", "Preview", "Slider", "View", "make_view"]
