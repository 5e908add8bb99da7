"""A simulated leader arm with motors, in the compliant hand of a person."""

from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from minidual.demos.leader import Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.scripted import plan_demonstration
from minidual.demos.station import Button
from minidual.robot.pair import Array
from minidual.skills.operator import Demonstration
from minidual.tasks.task import Trial

_STEP_S = 0.001


@dataclass(frozen=True)
class HandModel:
    """A passive hand on a joint: a spring and a damper to where it means to be, and an inertia.

    Attributes:
        stiffness: [Nm/rad].
        damping: [Nm s/rad].
        inertia: Of hand and leader joint [kg m^2].
        added_damping: Of the leader's motors [Nm s/rad].
        torque_max_nm: That the leader's motors render.
    """

    stiffness: float = 60.0
    damping: float = 5.0
    inertia: float = 0.1
    added_damping: float = 0.0
    torque_max_nm: float = 10.0


@dataclass
class SimulatedLeader(Leader):
    """Leads along a demonstration with arms that render the torques which come back.

    Attributes:
        demonstration: What the hands mean to do; planned for each trial without one.
        hand: Of every joint.
    """

    features: ClassVar[Features] = Features(feedback=True)

    demonstration: Demonstration | None = None
    hand: HandModel = field(default_factory=HandModel)
    setup: LeaderSetup | None = None
    _q: Array = field(default_factory=lambda: np.zeros(0))
    _v: Array = field(default_factory=lambda: np.zeros(0))
    _felt_nm: Array = field(default_factory=lambda: np.zeros(0))
    _time_s: float = 0.0

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Return a leader that plans each trial as the scripted operator does."""
        return cls(setup=setup)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Take the posture of the arms; plan the trial."""
        if self.setup is not None:
            self.demonstration = plan_demonstration(self.setup, trial)
        self.begin(q_follower)

    def begin(self, q_follower: Array) -> None:
        """Stand still at (n,) [rad]."""
        self._q = np.array(q_follower, dtype=float)
        self._v = np.zeros_like(self._q)
        self._felt_nm = np.zeros_like(self._q)
        self._time_s = 0.0

    def read(self, now_s: float) -> LeaderSample | None:
        """Return where the leader's joints are at a time."""
        if self.demonstration is None:
            return None
        q_demonstrated, openings = self.demonstration.at(now_s)
        while self._time_s < now_s - 0.5 * _STEP_S:
            self._step(q_demonstrated)
        has_ended = now_s >= self.demonstration.duration_s - 0.5 / self.demonstration.rate_hz
        return LeaderSample(
            openings, q=self._q.copy(), pressed=(Button.SUCCESS,) if has_ended else ()
        )

    def feedback(self, feedback: Feedback) -> None:
        """Render the torques on the arms."""
        most = self.hand.torque_max_nm
        self._felt_nm = np.clip(feedback.external_nm, -most, most)

    def _step(self, q_demonstrated: Array) -> None:
        hand = self.hand
        torque = (
            hand.stiffness * (q_demonstrated - self._q) - hand.damping * self._v + self._felt_nm
        )
        damped = 1.0 + _STEP_S * hand.added_damping / hand.inertia
        self._v = (self._v + _STEP_S / hand.inertia * torque) / damped
        self._q = self._q + _STEP_S * self._v
        self._time_s += _STEP_S
