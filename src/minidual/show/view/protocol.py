"""Interface of a live view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import mujoco

from minidual.show.view.overlay import Array, Overlay, Slider


class View(Protocol):
    """Shows a moving model without changing the simulation.

    Call `open` once, then:

        if view.due():
            view.update(data, Overlay(data.time, mode="moveit"))

    `update` copies; it never waits for clients nor raises when they disconnect.
    """

    name: str
    """Value of `--view`."""
    url: str | None
    """Browser address."""
    speed_max: float
    """Limit of simulated time / wall time; 0: none."""
    alive: bool
    """Whether it is visible; False after `close` or an error."""

    def open(self, model: mujoco.MjModel) -> None:
        """Replace the shown model; it needs visual meshes."""
        ...

    def due(self) -> bool:
        """Return whether a new frame is due."""
        ...

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Show body poses, current as after mj_step or mj_kinematics.

        Its model may lack meshes.
        """
        ...

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders."""
        ...

    def slider_values(self) -> Array:
        """Return the values (n,) within bounds."""
        ...

    def close(self) -> None:
        """End the view; idempotent."""
        ...
