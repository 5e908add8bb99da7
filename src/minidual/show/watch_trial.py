"""Show trials in a live view, whichever method drives."""

from __future__ import annotations

from dataclasses import replace

from minidual.control.stack import ControlStack
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.show.narrate import StackNarrator
from minidual.show.view.protocol import View
from minidual.show.watch_world import Narration, Narrator, Watcher
from minidual.trials.methods import Method


class TrialWatch:
    """A step hook of `run_trial` that shows each step; trials of one world follow one another.

    Args:
        view: Where to show them.
        world: The world of the trials.
        kinematics: For the ways of the hands.
        method: Name of the method.
        speed_max: Simulated seconds a second that may not be exceeded; 0 for no limit.
    """

    def __init__(
        self, view: View, world: World, kinematics: Kinematics, method: str, *, speed_max: float = 0.0
    ) -> None:
        self.title = method
        """What the view calls the trial."""
        self._name = method
        self._kinematics = kinematics
        self._driver: Method | None = None
        self._tell: Narrator = Narration
        self._watcher = Watcher(view, world, lambda: self._tell(), speed_max=speed_max)

    def __call__(self, world: World, method: Method) -> None:
        """Show the world if a picture is due."""
        if method is not self._driver:
            self._driver = method
            self._tell = self._narrator(method)
        self._watcher(world)

    def _narrator(self, method: Method) -> Narrator:
        stack = getattr(method, "stack", None)
        if isinstance(stack, ControlStack):
            tell = StackNarrator(stack, self._kinematics, self.title, lambda: method.phase)
            return lambda: _with_reason(tell(), method.aborted)
        # A method that writes torques itself is the only source in its world.
        return lambda: Narration(
            title=self.title, mode=self._name, source=self._name, state=method.phase, status=method.aborted or ""
        )


def _with_reason(narration: Narration, aborted: str | None) -> Narration:
    """Return it with why the method stopped itself, where nothing else is to be said."""
    return narration if narration.status or not aborted else replace(narration, status=aborted)
