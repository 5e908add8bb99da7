"""Drive planned segments through the control stack, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.commands import ArbiterState, TrajectoryCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.robot.pair import Array
from minidual.skills.pipeline.state import Segment

SOURCE = "moveit"
"""The arbiter's source of motions that are planned before they run."""


class Drive:
    """Proposes each segment when the one before it has ended; call `step` until `done`.

    Args:
        stack: The way to the motors; its arms are where the first segment starts.
        segments: In the order of time.

    Attributes:
        aborted: Why it stopped early, or None.
    """

    def __init__(self, stack: ControlStack, segments: Sequence[Segment]) -> None:
        self.stack = stack
        self.aborted: str | None = None
        self._left = list(segments)
        self._proposed = 0
        self._began_s = 0.0
        if self._left:
            stack.request(SOURCE)

    @property
    def segment(self) -> Segment | None:
        """What is driven now."""
        return self._left[0] if self._left else None

    @property
    def phase(self) -> str:
        """Name of the present phase."""
        return self._left[0].phase if self._left else "done"

    @property
    def done(self) -> bool:
        """Whether nothing is left to drive."""
        return not self._left

    @property
    def elapsed_s(self) -> float:
        """Time since the present segment was proposed [s]; zero before the first."""
        return self.stack.plant.time - self._began_s if self._proposed else 0.0

    def step(self) -> None:
        """Run one control and physics step."""
        stack = self.stack
        if self._left and not stack.executing and stack.source == SOURCE:
            self._propose_next()
        if self._left:
            stack.affirm(SOURCE)
        try:
            stack.step()
        except ReflexError as error:
            self.aborted = f"phase '{self.phase}': {error.message}"
            self._left = []
        if self._left and stack.state == ArbiterState.STOPPED:
            self._abort("the arms were not handed over")

    def _propose_next(self) -> None:
        refused = next((r for r in self.stack.refusals if r.source == SOURCE), None)
        if refused is None:
            if self._proposed > 0:
                self._left.pop(0)
            if not self._left:
                return
            self._proposed += 1
            self._began_s = self.stack.plant.time
            segment = self._left[0]
            command = TrajectoryCommand(segment.trajectory, np.array(segment.openings), self._began_s, self._proposed)
            refused = self.stack.propose(SOURCE, command)
        if refused is not None:
            self._abort(f"{refused.name}: {refused.detail}")

    def _abort(self, reason: str) -> None:
        self.aborted = f"the arbiter stopped phase '{self.phase}' ({reason})"
        self._left = []


@dataclass
class Driven:
    """What happened while one segment was driven.

    Attributes:
        phase: Its phase.
        duration_s: Simulated time.
        tracking_max_rad: Largest distance of a joint from the plan.
        object_off_max_m: Largest distance of an object in both hands from its plan; None elsewhere.
    """

    phase: str
    duration_s: float = 0.0
    tracking_max_rad: float = 0.0
    object_off_max_m: float | None = None


def measured(
    drive: Drive, T_world_object: Callable[[], Array], on_step: Callable[[str], None] | None = None
) -> tuple[Driven, ...]:
    """Drive to the end; return one entry a segment that was begun.

    Args:
        drive: Fresh.
        T_world_object: Reads the true pose (4, 4) of the object, for the measurement only.
        on_step: Gets the phase after every step.
    """
    done: list[Driven] = []
    world, last = drive.stack.plant, None
    while not drive.done:
        drive.step()
        segment = drive.segment
        if segment is None or drive.elapsed_s == 0.0:
            continue
        if segment is not last:
            done.append(Driven(segment.phase))
            last = segment
        now, t = done[-1], drive.elapsed_s
        now.duration_s = t
        now.tracking_max_rad = float(max(now.tracking_max_rad, np.abs(world.q - segment.trajectory.sample(t)[0]).max()))
        if segment.Ts_world_object is not None:
            row = min(round(t / segment.trajectory.dt_s), len(segment.Ts_world_object) - 1)
            distance = float(np.linalg.norm(T_world_object()[:3, 3] - segment.Ts_world_object[row, :3, 3]))
            now.object_off_max_m = max(now.object_off_max_m or 0.0, distance)
        if on_step is not None:
            on_step(segment.phase)
    return tuple(done)
