"""A scripted corrector: it takes over from a policy that strays from the operator's plan."""

from enum import Enum, auto
from typing import ClassVar, Self

import numpy as np

from minidual.demos.leader import Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.scripted import plan_demonstration
from minidual.demos.station import Button
from minidual.robot.pair import Array
from minidual.skills.operator import Demonstration
from minidual.tasks.task import Trial

STRAY_RAD = 0.15
"""Distance of a joint from the plan from which the policy counts as astray."""
STRAY_S = 0.3
"""For how long."""
STALL_S = 2.0
"""Time without progress along the plan after which the corrector takes over."""
LEAD_S = 1.5
"""For how long the corrector leads along the plan before it hands back."""
CORRECTIONS_MAX = 4
"""After as many the corrector leads to the end."""
_WINDOW_S = 1.0
"""How far ahead of the progress the nearest place of the plan is searched."""
_REJOIN_RAD_S = 0.4
"""Mean speed of the way back to the plan."""
_REJOIN_MIN_S = 0.4
_OPEN_MIN = 0.9
"""A hand that is wider open is not closed on anything."""
_END_RAD = 0.1
_LONGEST = 2.5
"""Longest episode, over the duration of the plan."""


class _Way(Enum):
    """Phases of the corrector."""

    WATCH = auto()
    REJOIN = auto()
    LEAD = auto()


class ScriptedCorrector(Leader):
    """Watches how far the arms are along the scripted operator's plan.

    Attributes:
        demonstration: The plan of the trial.
        corrections_n: Of this trial so far.
    """

    features: ClassVar[Features] = Features(
        targets="joints",
        buttons=(Button.SUCCESS, Button.CORRECT),
        feedback=True,
    )

    demonstration: Demonstration

    def __init__(self, setup: LeaderSetup | None = None) -> None:
        self._setup = setup
        self.corrections_n = 0

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Return a corrector that plans when a trial begins."""
        return cls(setup)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Plan the trial."""
        if self._setup is not None:
            self.demonstration = plan_demonstration(self._setup, trial)
        self.begin(q_follower)

    def begin(self, q_follower: Array) -> None:
        """Begin to watch arms that stand at (n,) [rad], hands open."""
        self._q = np.array(q_follower, dtype=float)
        self._openings = np.ones(2)
        self._way = _Way.WATCH
        self._progress = 0
        self._advanced_s = 0.0
        self._stray_since_s: float | None = None
        self._since_s = 0.0
        self._q_from = self._q
        self.corrections_n = 0

    def feedback(self, feedback: Feedback) -> None:
        """Take the measurements of the arms."""
        self._q = feedback.q
        self._openings = feedback.openings

    def resume(self, q_follower: Array) -> None:
        """Lead on from (n,) [rad]."""
        self._q_from = np.array(q_follower, dtype=float)

    def read(self, now_s: float) -> LeaderSample | None:
        """Return the plan from where the arms are, and the buttons that take over or hand back."""
        if self._way is _Way.WATCH:
            return self._watched(now_s)
        if self._way is _Way.REJOIN:
            return self._rejoining(now_s)
        return self._leading(now_s)

    def _watched(self, now_s: float) -> LeaderSample:
        self._advance(now_s)
        plan = self.demonstration
        target = plan.q[self._progress]
        openings = plan.gripper[self._progress]
        if self._has_ended(now_s):
            return LeaderSample(openings, q=target, pressed=(Button.SUCCESS,))
        if self._is_astray(now_s):
            self._way = _Way.REJOIN
            self._since_s = now_s
            self._q_from = self._q.copy()
            self.corrections_n += 1
            return LeaderSample(openings, q=self._q_from, pressed=(Button.CORRECT,))
        return LeaderSample(openings, q=target)

    def _advance(self, now_s: float) -> None:
        """Move on to the place of the plan that is nearest to the arms; hands must agree."""
        plan = self.demonstration
        end = min(self._progress + round(_WINDOW_S * plan.rate_hz), len(plan.q))
        for tick in range(self._progress + 1, end):
            closes = plan.gripper[tick] < 0.5
            if (closes != (self._openings < _OPEN_MIN)).any():
                end = tick
                break
        ahead = np.abs(plan.q[self._progress : end] - self._q).max(axis=1)
        nearest = self._progress + int(np.argmin(ahead))
        if nearest > self._progress:
            self._progress = nearest
            self._advanced_s = now_s

    def _is_astray(self, now_s: float) -> bool:
        off_rad = np.abs(self.demonstration.q[self._progress] - self._q).max()
        if off_rad <= STRAY_RAD:
            self._stray_since_s = None
        elif self._stray_since_s is None:
            self._stray_since_s = now_s
        strays = self._stray_since_s is not None and now_s - self._stray_since_s >= STRAY_S
        return strays or now_s - self._advanced_s >= STALL_S

    def _has_ended(self, now_s: float) -> bool:
        plan = self.demonstration
        is_last = self._progress >= len(plan.q) - 2
        rests = np.abs(plan.q[-1] - self._q).max() <= _END_RAD
        return (is_last and rests) or now_s >= _LONGEST * plan.duration_s

    def _rejoining(self, now_s: float) -> LeaderSample:
        """Lead from where the arms were to the plan, at rest at both ends."""
        plan = self.demonstration
        goal = plan.q[self._progress]
        distance_rad = float(np.abs(goal - self._q_from).max())
        lasts_s = max(_REJOIN_MIN_S, distance_rad / _REJOIN_RAD_S)
        s = min((now_s - self._since_s) / lasts_s, 1.0)
        share = s**3 * (10.0 + s * (6.0 * s - 15.0))
        if s >= 1.0:
            self._way = _Way.LEAD
            self._since_s = now_s
        q = self._q_from + share * (goal - self._q_from)
        return LeaderSample(plan.gripper[self._progress], q=q)

    def _leading(self, now_s: float) -> LeaderSample:
        """Play the plan; hand back after a while."""
        plan = self.demonstration
        self._progress = min(self._progress + 1, len(plan.q) - 1)
        q = plan.q[self._progress]
        openings = plan.gripper[self._progress]
        if self._has_ended(now_s):
            return LeaderSample(openings, q=q, pressed=(Button.SUCCESS,))
        handed_back = now_s - self._since_s >= LEAD_S and self.corrections_n < CORRECTIONS_MAX
        if not handed_back:
            return LeaderSample(openings, q=q)
        self._way = _Way.WATCH
        self._advanced_s = now_s
        self._stray_since_s = None
        return LeaderSample(openings, q=q, pressed=(Button.CORRECT,))
