"""What a live view offers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import mujoco

from minidual.show.view.overlay import Array, Overlay, Slider


class View(Protocol):
    """Shows a model in motion, and changes nothing in the simulation.

    Call `open` once, then as often as you like:

        if view.due():
            view.update(data, Overlay(data.time, mode="moveit"))

    Between two pictures `due` only reads the clock. `update` copies and returns: it neither waits for a client nor raises
    when one goes away.
    """

    @property
    def name(self) -> str:
        """Value of `--view`."""
        ...

    @property
    def url(self) -> str | None:
        """Address to open in a browser, if there is one."""
        ...

    @property
    def speed_max(self) -> float:
        """Simulated seconds a second that a watched run may not exceed; 0 for no limit."""
        ...

    @property
    def alive(self) -> bool:
        """Whether anybody can still see it; False after `close`."""
        ...

    def open(self, model: mujoco.MjModel) -> None:
        """Show `model`, with visual meshes, in place of the one before.

        The states given to `update` may come from a model without meshes: only the poses of its bodies are read.
        """
        ...

    def due(self) -> bool:
        """Return whether a new picture is wanted."""
        ...

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Show this state; its bodies must be up to date, as after mj_step or mj_kinematics."""
        ...

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Offer values to set."""
        ...

    def slider_values(self) -> Array:
        """Return the present values (n,) of the sliders offered, inside their bounds; (0,) without any."""
        ...

    def close(self) -> None:
        """End; may be called twice."""
        ...
