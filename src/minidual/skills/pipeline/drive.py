"""Execute planned segments in turn through the control stack."""

from collections.abc import Sequence

import numpy as np

from minidual.control.commands import Refusal, TrajectoryCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.robot.pair import SIDES
from minidual.skills.faults import Fault
from minidual.skills.states import Segment

SOURCE = "moveit"
"""Arbiter source of pre-planned motions."""
_FEEL_S = 1.0
"""Longest wait for a grip."""


class Drive:
    """Proposes each segment when the last has ended; call `step` until `done`.

    The arms must be at the first start. A hand opens in the air only when the other one feels the
    object.

    Attributes:
        stack: Drives the arms.
        aborted: Why it stopped early, or None.
    """

    def __init__(self, stack: ControlStack, segments: Sequence[Segment]) -> None:
        self.stack = stack
        self._begin(segments)

    def _begin(self, segments: Sequence[Segment]) -> None:
        """Drive these segments from now on."""
        self.aborted: str | None = None
        self._left = list(segments)
        self._proposed = 0
        self._refused_n = self.stack.refused_n
        self._began_s = 0.0
        self._ended_s = 0.0
        self._under_way = False
        if self._left:
            self.stack.request(SOURCE)

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
        self._check_source()

    def _check_source(self) -> None:
        """Abort if another source drives, or the arms were not handed over."""
        if not self._left or self.stack.source == SOURCE:
            return
        if self._proposed:
            self._abort("the arms were taken over")
        elif not self.stack.arbiter.switching:
            self._abort("the arms were not handed over")

    def _propose_next(self) -> None:
        """Propose the next segment, once its hands feel the object."""
        refusal = self._own_refusal()
        if refusal is None:
            if self._under_way:
                self._left.pop(0)
                self._under_way = False
                self._ended_s = self.stack.plant.time
            if not self._left or not self._is_felt(self._left[0]):
                return
            refusal = self._propose(self._left[0])
        if refusal is not None:
            self._abort(f"{refusal.name}: {refusal.detail}")

    def _own_refusal(self) -> Refusal | None:
        """Return the first refusal of this source."""
        for refusal in self.stack.refused_since(self._refused_n):
            if refusal.source == SOURCE:
                return refusal
        return None

    def _propose(self, segment: Segment) -> Refusal | None:
        self._under_way = True
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
        return self.stack.propose(SOURCE, command)

    def _is_felt(self, segment: Segment) -> bool:
        """Return whether the keeping hands feel the object; if not for too long, abort."""
        unfelt = [hand for hand in segment.kept_by if not self.stack.holds(SIDES.index(hand))]
        if not unfelt:
            return True
        now_s = self.stack.plant.time
        if now_s - self._ended_s > _FEEL_S:
            detail = f"the {unfelt[0]} hand feels no grip after {_FEEL_S} s"
            self.aborted = Fault("missed_grasp", detail, now_s).text
            self._left = []
        return False

    def _tell_held(self, segment: Segment) -> None:
        """Tell the supervisor which objects the hands hold in a segment."""
        supervisor = self.stack.supervisor
        if segment.scene is None:
            return
        supervisor.hold(None)
        for attached in segment.scene.attached:
            arm = segment.scene.robot.tcp_names.index(attached.link)
            supervisor.hold(arm, attached.shape.T_parent_shape)

    def _take_control(self, segment: Segment) -> None:
        """Choose the controllers of a segment."""

    def _stopped(self, error: ReflexError) -> None:
        self.aborted = f"phase '{self.phase}': {error.message}"
        self._left = []

    def _abort(self, reason: str) -> None:
        self.aborted = f"the arbiter stopped phase '{self.phase}' ({reason})"
        self._left = []
