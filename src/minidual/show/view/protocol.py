"""Interface of a live view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import mujoco

from minidual.show.view.overlay import Array, Overlay, Slider


class View(Protocol):
    """Shows a moving model without changing the simulation.

    Call `open` once, then repeatedly:

        if view.due():
            view.update(data, Overlay(data.time, mode="moveit"))

    `due` only reads the clock. `update` copies; it neither waits for clients nor raises when one disconnects.
    """

    @property
    def name(self) -> str:
        """Value of `--view`."""
        ...

    @property
    def url(self) -> str | None:
        """Browser address, if any."""
        ...

    @property
    def speed_max(self) -> float:
        """Limit of simulated seconds per second; 0: unlimited."""
        ...

    @property
    def alive(self) -> bool:
        """Whether it can still be seen; False after `close` or an internal error."""
        ...

    def open(self, model: mujoco.MjModel) -> None:
        """Replace the shown model; it needs visual meshes.

        `update` reads body poses only, so its data may come from a model without meshes.
        """
        ...

    def due(self) -> bool:
        """Return whether a new frame is due."""
        ...

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Show this state; body poses must be current, as after mj_step or mj_kinematics."""
        ...

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders."""
        ...

    def slider_values(self) -> Array:
        """Return the slider values (n,) within bounds."""
        ...

    def close(self) -> None:
        """End the view; idempotent."""
        ...
