"""Tell a live view what a control stack does: whose turn it is, what the arbiter does, and what is under way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from minidual.control.command_checks import own_columns
from minidual.control.commands import TrajectoryCommand
from minidual.control.stack import ControlStack
from minidual.robot.constants import GROUPS, Array
from minidual.robot.kinematics import Kinematics
from minidual.show.view.overlay import LEFT_RGB, NO_PREVIEW, RIGHT_RGB, PathLine, Preview
from minidual.show.watch_world import Narration

_PATH_POINTS = 60
_HOLDING = "none, posture held"


def tcp_preview(kinematics: Kinematics, qs: Array) -> Preview:
    """Return the ways of both tool centre points along postures (n, 14); one that stays put has none."""
    rows = np.unique(np.linspace(0, len(qs) - 1, min(len(qs), _PATH_POINTS)).round().astype(int))
    points = np.array([[T[:3, 3] for T in kinematics.tcp_poses(qs[row])] for row in rows])
    lines = [
        PathLine(name, points[:, arm], rgb)
        for arm, (name, rgb) in enumerate((("left", LEFT_RGB), ("right", RIGHT_RGB)))
        if np.ptp(points[:, arm], axis=0).max() > 1e-3
    ]
    return Preview(tuple(lines))


class StackNarrator:
    """Called once a picture; see minidual.show.watch_world.Watcher.

    Args:
        stack: What drives the arms.
        kinematics: For the ways of the hands.
        title: What runs.
        phase: Adds the phase of the one who drives.
    """

    def __init__(
        self, stack: ControlStack, kinematics: Kinematics, title: str = "", phase: Callable[[], str] | None = None
    ) -> None:
        self.title = title
        self._stack, self._kinematics, self._phase = stack, kinematics, phase
        self._drawn: tuple[object, ...] = ()
        self._preview = NO_PREVIEW

    def __call__(self) -> Narration:
        """Return what the stack does now."""
        stack = self._stack
        state = str(stack.state)
        phase = self._phase() if self._phase is not None else ""
        return Narration(
            title=self.title,
            mode=stack.source or "hold",
            source=stack.output.active_source or _HOLDING,
            state=f"{state}, {phase}" if phase and phase != state else state,
            status="" if stack.reflex is None else stack.reflex.message,
            preview=self._planned(),
        )

    def _planned(self) -> Preview:
        """Return the ways of the trajectories under way, computed once for each."""
        commands = tuple(
            command
            for execution in self._stack.arbiter.executions
            if isinstance(command := execution.command, TrajectoryCommand)
        )
        if tuple(map(id, commands)) != tuple(map(id, self._drawn)):
            self._drawn = commands
            lines: list[PathLine] = []
            for command in commands:
                motion = command.motion
                times = np.linspace(0.0, motion.duration_s, _PATH_POINTS)
                found = motion.sample_many(times)[0]
                qs = np.tile(self._stack.world.q, (len(times), 1))
                qs[:, GROUPS[command.group]] = found[:, own_columns(command)]
                lines += tcp_preview(self._kinematics, qs).paths
            self._preview = Preview(tuple(lines)) if lines else NO_PREVIEW
        return self._preview
