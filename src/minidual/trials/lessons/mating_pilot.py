"""A planned insertion in which a policy mates the parts: the planner brings them, and it ends.

The same skill acts in trials and in training; in training, its policy is somebody at the other end
of a pipe (`mating_worlds`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property

import numpy as np

from minidual.environments.actions import arms_of
from minidual.environments.mating import (
    ACTION,
    MatingReadings,
    MatingSensed,
    MatingSenses,
    Parts,
    RelativePose,
    mating_size,
    observe_mating,
)
from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.policies.rl.network import Description, RlNetwork
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.askew import EVERY_S, Mating, Meeting
from minidual.skills.compliant_carry import CompliantCarry
from minidual.tasks.insertion import MOUTH, PEG, SOCKET
from minidual.tasks.task import Task, Trial
from minidual.trials import factories
from minidual.trials.methods import Factory, MethodInputs

RATE_HZ = 10.0
"""Rate of actions."""
BEGINS_M = 0.015
"""The policy takes over when the planned tip is this far before the mouth."""
MATING_S = 8.0
"""A mating that has not ended by then has failed."""
_UPDATES_N = round(1.0 / (RATE_HZ * EVERY_S))
"""Updates of the skill in an action."""

type Policy = Callable[[MatingSensed], Array]
"""Readings -> action (5,) in -1..1."""


class LearnedMating:
    """Moves the reference of a straight push as a policy asks, ten times a second.

    With actions of zero it is the straight push.

    Args:
        carry: The trial.
        meeting: The parts.
        parts: Their shapes.
        policy: Gives the actions.

    Attributes:
        actions: What the policy has done.
        began_s: When it took over; None before.
    """

    def __init__(
        self,
        carry: CompliantCarry,
        meeting: Meeting,
        parts: Parts,
        policy: Policy,
    ) -> None:
        self._plant = carry.plant
        self._observer = carry.stack.supervisor.observer
        self._law = meeting.law
        self._senses = MatingSenses(parts, meeting)
        self._policy = policy
        self._updates = 0
        self.actions = RelativePose()
        self.began_s: float | None = None

    def busy(self, now_s: float) -> bool:
        """Whether the policy has time left."""
        return self.began_s is None or now_s < self.began_s + MATING_S

    def update(self, q: Array, q_ref: Array, now_s: float) -> None:
        """See `Mating`."""
        if self.began_s is None:
            if self._senses.planned(q_ref)[1] < -BEGINS_M:
                return
            self.began_s = now_s
        within = self._updates % _UPDATES_N
        if within == 0:
            self.actions.begin(self._policy(self.sense(q, q_ref, now_s)))
        self._updates += 1
        self._move(self.actions.at((within + 1) / _UPDATES_N))

    def sense(self, q: Array, q_ref: Array, now_s: float) -> MatingSensed:
        """Return the present readings; to be called once an action."""
        gaps_m = 2.0 * self._plant.fingers
        torque = self._observer.external.copy()
        readings = MatingReadings(q, q_ref, gaps_m, torque, now_s)
        return self._senses.read(readings, self.actions)

    def _move(self, value: Array) -> None:
        x, y, z = value[:3].tolist()
        self._law.shift_m = (x, y, z)
        self._law.correct(*self._senses.held(value))


class LearnedInsertion(CompliantCarry):
    """One planned trial in which a policy drives the insertion, from `BEGINS_M` before the mouth.

    Attributes:
        policy: Gives the actions; set before the first step. None pushes straight on.
        mating: The skill, once the parts are before each other.
    """

    policy: Policy | None = None
    mating: LearnedMating | None = None

    @property
    def inference_s(self) -> float:
        """Mean time of this trial's inferences, or NaN."""
        return getattr(self.policy, "inference_s", float("nan"))

    @cached_property
    def _parts(self) -> Parts:
        return parts_of(self.task, arms_of(self.plant.robot).frames)

    def _new_mating(self, meeting: Meeting) -> Mating | None:
        if self.policy is None:
            return None
        self.mating = LearnedMating(self, meeting, self._parts, self.policy)
        return self.mating


def parts_of(task: Task, frames: Array) -> Parts:
    """Return peg and socket."""
    widths = [2.0 * task.objects[name].body.half_width_m for name in (PEG, SOCKET)]
    return Parts(frames, task.objects[PEG].touches_m, MOUTH, (widths[0], widths[1]))


class Inference:
    """A network as a policy; it reads the terms that it was trained on."""

    def __init__(self, network: RlNetwork) -> None:
        self._network = network
        self._times_s: list[float] = []

    @property
    def inference_s(self) -> float:
        """Mean time of the inferences so far, or NaN."""
        return float(np.mean(self._times_s)) if self._times_s else float("nan")

    def __call__(self, sensed: MatingSensed) -> Array:
        """Return the action (5,).

        Raises:
            DataError: A reading is not finite.
        """
        observation = observe_mating(self._network.description.observation, sensed)
        began_s = time.perf_counter()
        action = self._network.act(observation)
        self._times_s.append(time.perf_counter() - began_s)
        return action.astype(float)


def learned_insertions(inputs: MethodInputs, make_policy: Callable[[], Policy | None]) -> Factory:
    """Return the factory of trials in which a policy mates the parts."""
    planned = factories.planned(inputs, LearnedInsertion)

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> LearnedInsertion:
        carry = planned(plant, kinematics, trial)
        if not isinstance(carry, LearnedInsertion):
            raise TypeError(f"a planned trial is a {type(carry).__name__}")
        carry.policy = make_policy()
        return carry

    return make


def driver(inputs: MethodInputs, network: RlNetwork) -> Factory:
    """Return the factory of trials.

    Raises:
        UsageError: The policy reads or gives what this version does not know.
    """
    check_fits(network)
    return learned_insertions(inputs, lambda: Inference(network))


def check_fits(network: RlNetwork) -> None:
    """Raise UsageError unless a network has the inputs and outputs of the skill."""
    description: Description = network.description
    reads_n = mating_size(description.observation)
    gives_n = len(RelativePose.names)
    if (reads_n, gives_n) != (network.observation_size, network.action_size):
        raise UsageError(
            f"the policy reads {network.observation_size} numbers and gives {network.action_size}; "
            f"its observation has {reads_n} and its action {gives_n}",
            remedy="train it again: minidual train rl --task insertion",
        )
    if description.action != ACTION or description.rate_hz != RATE_HZ:
        raise UsageError(
            f"the policy gives '{description.action}' at {description.rate_hz} Hz; "
            f"the insertion takes '{ACTION}' at {RATE_HZ} Hz",
            remedy="train it again: minidual train rl --task insertion",
        )
