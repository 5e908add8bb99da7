"""Rewards: small terms, composed in a list.

A `gain` pays the increase of a potential, so that what is lost again is paid back (Ng, Harada,
Russell 1999); a `rate` pays in each step, an `event` once, when it begins. Terms read the true state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.environments.senses import hand_yaw, nearest_turn
from minidual.robot.pair import Array
from minidual.tasks.truth import AIRBORNE_M

Flags = npt.NDArray[np.bool_]

_HOVER_M = 0.08
"""Hands that are not over their grasps yet approach from above, not through the object."""
_LATERAL_M = 0.02
_LATERAL_RANGE_M = 0.03
_TURN_M_PER_RAD = 0.05
"""Weight of a turn beside a distance."""
_FIRM_N = 25.0
"""Pinch from which a hand holds: more than the 20 N that the judge asks for."""
_NEAR_M = 0.025
_NEAR_RAD = 0.2
_STRAINED = 0.7
"""Share of the supervisor's bounds above which contact is paid for."""
_MOST_STRAIN = 2.0


class LiftState(NamedTuple):
    """True state of N worlds in which both hands carry one object.

    Attributes:
        hands: Tcp poses (N, 2, 4, 4).
        opening: Of the hands (N, 2), 0..1.
        grasps: T_object_tcp (2, 4, 4).
        xyz, yaw, tilt, clearance: Of the object (N, 3), (N,), (N,), (N,).
        rest_m: Height of its centre on the table.
        pinch_n: (N, 2).
        lifted_m: Largest clearance so far while both hands pinched it (N,).
        goal: (N, 3), x, y [m], yaw [rad].
        rise_m: Height to which the task asks it to rise.
        tilt_max: Limit of the task [rad].
        symmetry: Yaws that look alike in a turn.
        strain: Largest share of a supervisor's bound in the step (N,).
        violated: Whether a condition is violated, or the supervisor would have stopped (N,).
        succeeded: Whether the trial is over and a success (N,).
    """

    hands: Array
    opening: Array
    grasps: Array
    xyz: Array
    yaw: Array
    tilt: Array
    clearance: Array
    rest_m: float
    pinch_n: Array
    lifted_m: Array
    goal: Array
    rise_m: float
    tilt_max: float
    symmetry: int
    strain: Array
    violated: Flags
    succeeded: Flags


class RewardTerm[State](NamedTuple):
    """One term of a reward on a state of N worlds.

    Attributes:
        kind: "gain" of a potential, "rate" a step, or "event".
    """

    name: str
    weight: float
    kind: Literal["gain", "rate", "event"]
    value: Callable[[State], Array]


# What the object's way has reached ------------------------------------------------------------


def lifted_share(state: LiftState) -> Array:
    """Return the share (N,), 0..1, of the required height that the object has reached in both hands."""
    return np.clip(state.lifted_m / (1.05 * state.rise_m), 0.0, 1.0)


def is_high(state: LiftState) -> Flags:
    """Return whether both hands have lifted the object as high as required (N,)."""
    return state.lifted_m > state.rise_m


def goal_distance(state: LiftState) -> tuple[Array, Array]:
    """Return distance [m] and turn [rad] (N,) of the object from its goal."""
    distance_m = np.linalg.norm(state.xyz[:, :2] - state.goal[:, :2], axis=1)
    turn = np.abs(nearest_turn(state.yaw - state.goal[:, 2], state.symmetry))
    return distance_m, turn


def is_over_goal(state: LiftState) -> Flags:
    """Return whether the object has been lifted and is at its goal, at any height (N,)."""
    distance_m, turn = goal_distance(state)
    return is_high(state) & (distance_m < _NEAR_M) & (turn < _NEAR_RAD)


# Terms ----------------------------------------------------------------------------------------


def reach(state: LiftState) -> Array:
    """Nearness of the hands to their grasps, mostly of the hand that is further; 1 once lifted."""
    c = np.cos(state.yaw)
    s = np.sin(state.yaw)
    near: list[Array] = []
    for hand, T_grasp in enumerate(state.grasps):
        x, y, z = T_grasp[:3, 3]
        grasp_x = state.xyz[:, 0] + c * x - s * y
        grasp_y = state.xyz[:, 1] + s * x + c * y
        T_hand = state.hands[:, hand]
        away = np.hypot(T_hand[:, 0, 3] - grasp_x, T_hand[:, 1, 3] - grasp_y)
        turn = np.abs(nearest_turn(hand_yaw(T_hand) - state.yaw - hand_yaw(T_grasp)))
        lateral = away + _TURN_M_PER_RAD * turn
        hover = _HOVER_M * np.clip((lateral - _LATERAL_M) / _LATERAL_RANGE_M, 0.0, 1.0)
        below = np.abs(T_hand[:, 2, 3] - (state.xyz[:, 2] + z) - hover)
        near.append(1.0 - np.tanh(3.0 * (lateral + below)))
    further = np.minimum(near[0], near[1])
    nearness = 0.7 * further + 0.15 * (near[0] + near[1])
    return np.where(is_high(state), np.maximum(nearness, 1.0), nearness)


def grasp_each(state: LiftState) -> Array:
    """Mean firmness of the hands' pinches; 1 once the object is over its goal."""
    firm = np.clip(state.pinch_n / _FIRM_N, 0.0, 1.0).mean(axis=1)
    return np.where(is_over_goal(state), 1.0, firm)


def grasp_both(state: LiftState) -> Array:
    """Firmness of the weaker pinch: one hand alone earns nothing; 1 once over the goal."""
    firm = np.clip(state.pinch_n / _FIRM_N, 0.0, 1.0).min(axis=1)
    return np.where(is_over_goal(state), 1.0, firm)


def lift(state: LiftState) -> Array:
    """Share of the height, of the lower end and of the weaker hand: one hand alone earns nothing."""
    return lifted_share(state)


def along(state: LiftState) -> Array:
    """Nearness of the lifted object to its goal."""
    distance_m, turn = goal_distance(state)
    near = 0.8 * (1.0 - np.tanh(4.0 * distance_m)) + 0.2 * (1.0 - np.tanh(2.0 * turn))
    return np.where(is_high(state), near, 0.0)


def lower(state: LiftState) -> Array:
    """How far the object has come down over its goal."""
    height_m = state.xyz[:, 2] - state.rest_m
    down = np.clip(1.0 - height_m / (1.2 * state.rise_m), 0.0, 1.0)
    return np.where(is_over_goal(state), down, 0.0)


def release(state: LiftState) -> Array:
    """Opening of the hands over an object that stands on its goal."""
    stands = is_over_goal(state) & (state.clearance < AIRBORNE_M)
    return np.where(stands, 0.5 + 0.5 * state.opening.mean(axis=1), 0.0)


def level(state: LiftState) -> Array:
    """Tilt of the object in relation to its limit."""
    return state.tilt / state.tilt_max


def time(state: LiftState) -> Array:
    """Each step alike."""
    return np.ones(len(state.yaw))


def contact(state: LiftState) -> Array:
    """Strain above 0.7 of what the supervisor stops at."""
    return np.clip(state.strain - _STRAINED, 0.0, _MOST_STRAIN)


def violation(state: LiftState) -> Array:
    """A condition of success is violated, or the supervisor would have stopped the arms."""
    return state.violated.astype(float)


def success(state: LiftState) -> Array:
    """The trial is over, and a success by the judge of all methods."""
    return state.succeeded.astype(float)


LIFT_REWARD: tuple[RewardTerm[LiftState], ...] = (
    RewardTerm("reach", 1.0, "gain", reach),
    RewardTerm("grasp_each", 0.4, "gain", grasp_each),
    RewardTerm("grasp_both", 0.6, "gain", grasp_both),
    RewardTerm("lift", 2.0, "gain", lift),
    RewardTerm("along", 2.0, "gain", along),
    RewardTerm("lower", 1.5, "gain", lower),
    RewardTerm("release", 1.0, "gain", release),
    RewardTerm("level", -0.2, "gain", level),
    RewardTerm("time", -0.01, "rate", time),
    RewardTerm("contact", -0.05, "rate", contact),
    RewardTerm("violation", -0.5, "event", violation),
    RewardTerm("success", 5.0, "event", success),
)
TOGETHER = ("grasp_both", "lift", "along", "lower", "release", "success")
"""Terms that pay only for joint work of both hands."""


class Reward[State]:
    """The sum of terms, of N worlds.

    Args:
        discount: Of the learner; a gain is discount * potential - the last potential. 1 pays the
            plain increase.
    """

    def __init__(
        self,
        terms: Sequence[RewardTerm[State]],
        worlds_n: int,
        discount: float = 1.0,
    ) -> None:
        self.terms = tuple(terms)
        self._discount = discount
        self._last: dict[str, Array] = {term.name: np.zeros(worlds_n) for term in self.terms}

    def restart(self, state: State, worlds: Flags) -> None:
        """Take the potentials of new trials, in which no event has happened."""
        for term in self.terms:
            value = _finite(term.value(state)) if term.kind == "gain" else np.zeros(len(worlds))
            self._last[term.name][worlds] = value[worlds]

    def pay(self, state: State) -> Mapping[str, Array]:
        """Return the weighted reward (N,) of each term."""
        paid: dict[str, Array] = {}
        for term in self.terms:
            value = _finite(term.value(state))
            last = self._last[term.name]
            self._last[term.name] = value
            paid[term.name] = term.weight * self._of_kind(term, value, last)
        return paid

    def _of_kind(self, term: RewardTerm[State], value: Array, last: Array) -> Array:
        if term.kind == "gain":
            return self._discount * value - last
        if term.kind == "event":
            return np.maximum(0.0, value - last)
        return value


def _finite(values: Array) -> Array:
    """Return values with 0 where a world has diverged."""
    return np.where(np.isfinite(values), values, 0.0)
