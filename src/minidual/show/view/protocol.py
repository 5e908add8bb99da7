"""What every back-end of the live view offers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from minidual.show.view.overlay import Array, Overlay, Slider

if TYPE_CHECKING:
    import mujoco


class View(Protocol):
    """Shows a model in motion. It reads; nothing that a view does reaches the simulation.

    The one who moves the arms calls `open` once and then, as often as it likes:

        if view.due():
            view.update(data, Overlay(data.time, mode="moveit"))

    `due` costs a look at the clock, so that between two pictures nothing is gathered. `update` copies and returns:
    it neither waits for a client nor raises when one goes away.
    """

    @property
    def name(self) -> str:
        """Name of the back-end."""
        ...

    @property
    def speed_max(self) -> float:
        """Simulated seconds a second that a watched run may not exceed; 0 for no limit."""
        ...

    @property
    def url(self) -> str | None:
        """Address to open in a browser, if there is one."""
        ...

    @property
    def alive(self) -> bool:
        """Whether anybody can still see it; False after `close`, and when its window was closed."""
        ...

    def open(self, model: mujoco.MjModel) -> None:
        """Show `model`; another model replaces the one before.

        Args:
            model: With visual meshes. The states given to `update` may come from one without: only the poses
                of its bodies are read, so the simulated model stays the one that would run unwatched.
        """
        ...

    def due(self) -> bool:
        """Return whether a new picture is wanted."""
        ...

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Show this state (its bodies' poses must be those of its qpos, as after mj_step or mj_kinematics)."""
        ...

    def offer(self, sliders: Sequence[Slider]) -> bool:
        """Offer values to set; return whether this view can."""
        ...

    def slider_values(self) -> Array:
        """Return the present values (n,) of the sliders offered, or (0,) where there are none."""
        ...

    def close(self) -> None:
        """End; may be called twice."""
        ...
