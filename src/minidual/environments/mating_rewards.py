"""Reward of putting two held parts together: small terms of the true state, composed in a list."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from minidual.environments.rewards import Flags, RewardTerm
from minidual.robot.pair import Array

_NEAR_M = 0.004
_ENTERED_M = 0.002
"""Depth from which the tip has found the mouth."""
_FIRM_N = 25.0
"""Pinch from which a hand holds: more than the 20 N that the judge asks for."""
_GENTLE_N = 15.0
_FORCE_UNIT_N = 10.0
_MOST_FORCE = 2.0


class MatingState(NamedTuple):
    """True state of N worlds in which each hand holds a part.

    Attributes:
        beside_m: Distance of the tip from the axis of the bore (N,).
        before_m: How far the tip is before the mouth (N,); negative inside.
        depth_m: Of the tip inside the bore (N,), 0 unless it fits from mouth to tip.
        needed_m: Depth that the task asks for.
        pinch_n: Of the hand that should hold each part (N, 2).
        aloft: Whether both parts are as high as the task asks for (N,).
        force_n: Largest force of a hand on its part since the last action (N,).
        violated: Whether a condition is violated, or the supervisor stopped the arms (N,).
        succeeded: Whether the trial is over and a success (N,).
    """

    beside_m: Array
    before_m: Array
    depth_m: Array
    needed_m: float
    pinch_n: Array
    aloft: Flags
    force_n: Array
    violated: Flags
    succeeded: Flags


def together(state: MatingState) -> Array:
    """How firmly the weaker hand holds its part in the air (N,), 0..1: one hand alone earns nothing."""
    firm = np.clip(state.pinch_n / _FIRM_N, 0.0, 1.0).min(axis=1)
    return np.where(state.aloft, firm, 0.0)


def near(state: MatingState) -> Array:
    """Nearness of the tip to the mouth, 1 once it is inside; of both hands together."""
    entered = state.depth_m > _ENTERED_M
    beside = 1.0 - np.tanh(state.beside_m / _NEAR_M)
    return together(state) * np.where(entered, 1.0, beside)


def depth(state: MatingState) -> Array:
    """Share of the depth that the task asks for; of both hands together."""
    share = np.clip(state.depth_m / (1.1 * state.needed_m), 0.0, 1.0)
    return together(state) * share


def force(state: MatingState) -> Array:
    """Force of a hand above 15 N."""
    return np.clip((state.force_n - _GENTLE_N) / _FORCE_UNIT_N, 0.0, _MOST_FORCE)


def time(state: MatingState) -> Array:
    """Each action alike."""
    return np.ones(len(state.depth_m))


def violation(state: MatingState) -> Array:
    """A condition of success is violated, or the supervisor stopped the arms."""
    return state.violated.astype(float)


def success(state: MatingState) -> Array:
    """The trial is over, and a success by the judge of all methods."""
    return state.succeeded.astype(float)


MATING_REWARD: tuple[RewardTerm[MatingState], ...] = (
    RewardTerm("near", 1.5, "gain", near),
    RewardTerm("depth", 4.0, "gain", depth),
    RewardTerm("force", -0.02, "rate", force),
    RewardTerm("time", -0.01, "rate", time),
    RewardTerm("violation", -2.0, "event", violation),
    RewardTerm("success", 3.0, "event", success),
)
MATED_TOGETHER = ("near", "depth", "success")
"""Terms that pay only for joint work of both hands."""
