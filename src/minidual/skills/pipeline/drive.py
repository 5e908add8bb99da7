"""Execute planned segments in turn through the control stack."""

from collections.abc import Sequence

import numpy as np

from minidual.control.commands import TrajectoryCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.robot.pair import SIDES
from minidual.skills.faults import Fault
from minidual.skills.phases import Segment

SOURCE = "moveit"
"""Arbiter source of pre-planned motions."""
_FEEL_S = 1.0  # longest wait for a grip


class Drive:
    """Proposes each segment when the last has ended; call `step` until `done`.

    The arms must be at the first start. A hand opens in the air only when the other one feels the object. `aborted` says
    why it stopped early.
    """

    def __init__(self, stack: ControlStack, segments: Sequence[Segment]) -> None:
        self.stack = stack
        self.aborted: str | None = None
        self._left = list(segments)
        self._proposed = 0
        self._refused_n = stack.refused_n
        self._began_s = self._ended_s = 0.0
        self._under_way = False
        if self._left:
            stack.request(SOURCE)

    @property
    def phase(self) -> str:
        """Present phase."""
        return self._left[0].phase if self._left else "done"

    @property
    def done(self) -> bool:
        """Whether no segment is left, and nothing brakes the arms any more."""
        return not (self._left or self.stack.stopping or self.stack.arbiter.switching)

    @property
    def elapsed_s(self) -> float:
        """Time since the segment's proposal [s]; zero before the first."""
        return self.stack.plant.time - self._began_s if self._proposed else 0.0

    def step(self) -> None:
        """Run one control step."""
        stack = self.stack
        if self._left and not stack.executing and stack.source == SOURCE:
            try:
                self._propose_next()
            except Exception as error:  # the arms need this step's torque
                stack.fail(error)
        if self._left:
            stack.affirm(SOURCE)
        try:
            stack.step()
        except ReflexError as error:
            self._stopped(error)
        if (
            self._left
            and stack.source != SOURCE
            and (self._proposed or not stack.arbiter.switching)
        ):
            self._abort(
                "the arms were taken over" if self._proposed else "the arms were not handed over",
            )

    def _propose_next(self) -> None:
        refused = next(
            (r for r in self.stack.refused_since(self._refused_n) if r.source == SOURCE),
            None,
        )
        if refused is None:
            if self._under_way:
                self._left.pop(0)
                self._under_way = False
                self._ended_s = self.stack.plant.time
            if not self._left or not self._felt(self._left[0]):
                return
            self._under_way = True
            segment = self._left[0]
            self._proposed += 1
            self._began_s = self.stack.plant.time
            self._tell_held(segment)
            self._take_control(segment)
            command = TrajectoryCommand(
                segment.trajectory,
                np.array(segment.openings),
                self._began_s,
                self._proposed,
            )
            refused = self.stack.propose(SOURCE, command)
        if refused is not None:
            self._abort(f"{refused.name}: {refused.detail}")

    def _felt(self, segment: Segment) -> bool:
        """Return whether the keeping hands feel the object; too long without is a fault."""
        unfelt = [hand for hand in segment.kept_by if not self.stack.holds(SIDES.index(hand))]
        now_s = self.stack.plant.time
        if unfelt and now_s - self._ended_s > _FEEL_S:
            detail = f"the {unfelt[0]} hand feels no grip after {_FEEL_S} s"
            self.aborted = Fault("missed_grasp", detail, now_s).text
            self._left = []
        return not unfelt

    def _tell_held(self, segment: Segment) -> None:
        supervisor = self.stack.supervisor
        if segment.scene is None:
            return
        supervisor.hold(None)
        for held in segment.scene.attached:
            supervisor.hold(
                segment.scene.robot.tcp_names.index(held.link),
                held.shape.T_parent_shape,
            )

    def _take_control(self, segment: Segment) -> None:
        """Choose the controllers of a segment."""

    def _stopped(self, error: ReflexError) -> None:
        self.aborted = f"phase '{self.phase}': {error.message}"
        self._left = []

    def _abort(self, reason: str) -> None:
        self.aborted = f"the arbiter stopped phase '{self.phase}' ({reason})"
        self._left = []
