"""Shared style of the figures."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from minidual.durable import replacing

INK = "#1f3b57"
LIMIT = "#c0392b"
BLUE = "#2f6db5"
ORANGE = "#e07b27"
GREEN = "#3a9a5b"
_STYLES: dict[Any, Any] = {"svg.fonttype": "none"}
"""Text stays text: it can be searched, and has the font of the page."""
LINES = (
    (BLUE, "-"),
    (ORANGE, "--"),
    (GREEN, "-."),
    ("#7d5bbf", ":"),
    ("#b04066", (0, (5, 1, 1, 1, 1, 1))),
    ("#66717e", (0, (1, 3))),
    (INK, (0, (8, 3))),
)
"""Colour and dashes of the lines of a plot: they are told apart in grey too."""


_CHARACTERS_PER_IN = 13
"""Of a title over an image, at most: wider ones would run into the next."""


def new_figure(
    rows: int,
    columns: int,
    width_in: float,
    height_in: float,
    **options: Any,
) -> tuple[Figure, Any]:
    """Return a figure and its axes (rows, columns); `options` are those of `Figure.subplots`."""
    figure = Figure(figsize=(width_in, height_in), dpi=110, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes


def save_plot(figure: Figure, path: Path) -> None:
    """Write a plot as SVG. The same figure gives the same bytes: no date, no random names."""
    with mpl.rc_context({**_STYLES, "svg.hashsalt": path.stem}):
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None})


def limit_line(axis: Any, at: float, label: str | None = "limit", style: str = "--") -> None:
    """Draw a horizontal limit line."""
    axis.axhline(at, color=LIMIT, lw=1, ls=style, label=label)


def sheet(
    images: Sequence[tuple[str, Any]],
    columns: int,
    path: Path,
    title: str = "",
    width_in: float = 3.4,
) -> None:
    """Write titled images (H, W, 3) to one PNG, atomically.

    Args:
        images: (title, image), all of the size of the first.
        columns: Images a row.
        path: Of the PNG.
        title: Above all images.
        width_in: Of one image [in].
    """
    rows = -(-len(images) // columns)  # rounded up
    height_px, width_px = images[0][1].shape[:2]
    image_height_in = width_in * height_px / width_px
    figure, axes = new_figure(
        rows,
        columns,
        width_in * columns,
        (image_height_in + 0.3) * rows + 0.3,
    )
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, (name, image) in zip(axes.flat, images, strict=False):  # the last row may be short
        axis.imshow(image)
        lines = textwrap.fill(name, round(_CHARACTERS_PER_IN * width_in))
        axis.set_title(lines, fontsize=10, loc="left")
    if title:
        figure.suptitle(title, fontsize=12)
    with replacing(path) as partial:  # `plan --picture` may replace a user's file
        figure.savefig(partial, format="png", metadata={"Software": None})


def draw_occlusion(maps: Mapping[str, tuple[Any, Any]], path: Path) -> None:
    """Draw where a policy looks, a row per camera.

    Args:
        maps: {camera: (picture (H, W, 3), mean change of the joint targets by covered cell [rad])}.
        path: Of the figure.
    """
    first_picture, _ = next(iter(maps.values()))
    height_px, width_px = first_picture.shape[:2]
    row_height_in = 3.7 * height_px / width_px + 0.4
    extent = (-0.5, width_px - 0.5, height_px - 0.5, -0.5)
    figure, axes = new_figure(len(maps), 2, 8.4, len(maps) * row_height_in)
    for (camera, (picture, changes)), (left, right) in zip(maps.items(), axes, strict=True):
        left.imshow(picture)
        left.set_title(f"camera {camera}", fontsize=10, loc="left")
        right.imshow(picture.mean(axis=2), cmap="gray", vmin=0, vmax=255)
        overlay = right.imshow(changes, cmap="inferno", alpha=0.65, extent=extent, vmin=0.0)
        right.set_title("joint targets change where this is covered", fontsize=10, loc="left")
        figure.colorbar(overlay, ax=right, label="mean change [rad]")
        left.set_axis_off()
        right.set_axis_off()
    figure.savefig(path, metadata={"Software": None})
