"""Waypoints of two hands that take a cube, bring it to the middle, and pass it on.

A hand always points away from the base of its arm. Then the forearm never turns about itself; other
ways lead through postures of a straight wrist, where the joints can take one of two ways, and a
policy that has seen both takes their mean.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]

_EXCHANGE_M = np.array([0.0, 0.5, 0.27])
_STEEP = np.deg2rad(60.0)
"""Pitch of the right hand: so steep that its palm stays clear of the table and of the left hand."""
_UPRIGHT = np.deg2rad(90.0)
"""Roll of the left hand in the exchange: it pinches the faces that the right hand leaves free."""
_ABOVE_M = 0.10
_BESIDE_M = 0.12
_DEEP_M = 0.01
"""How far beyond the cube's middle the finger tips of the right hand go."""


class Waypoint(NamedTuple):
    """Where a hand shall be at a time.

    Attributes:
        at_s: Time in the episode [s].
        tip_m: Of the point between the finger tips (3,), world frame [m].
        pitch: How far the hand points below the horizon [rad].
        roll: Of the hand about the axis along which it points [rad]; 0 opens horizontally.
        opening: 0 closed, 1 open.
    """

    at_s: float
    tip_m: Array
    pitch: float
    roll: float
    opening: float


class Hand(NamedTuple):
    """A hand at the beginning.

    Attributes:
        base_m: Where its arm stands (3,), world frame [m].
        tip_m: Of the point between the finger tips (3,), world frame [m].
        pitch: How far it points below the horizon [rad].
    """

    base_m: Array
    tip_m: Array
    pitch: float


def pointing(base_m: Array, waypoint: Waypoint) -> Array:
    """Return the rotation (3, 3) of a hand: x ahead, away from the base; y along the opening."""
    away_m = waypoint.tip_m[:2] - base_m[:2]
    level = np.array([*away_m / np.linalg.norm(away_m), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    ahead = np.cos(waypoint.pitch) * level - np.sin(waypoint.pitch) * up
    aside = np.cross(up, level)
    across = np.cos(waypoint.roll) * aside + np.sin(waypoint.roll) * np.cross(ahead, aside)
    return np.column_stack([ahead, across, np.cross(ahead, across)])


def waypoint_at(way: list[Waypoint], time_s: float) -> Waypoint:
    """Return the interpolated waypoint; hands start and stop smoothly."""
    if time_s <= way[0].at_s:
        return way[0]
    for before, after in pairwise(way):
        if time_s < after.at_s:
            share = (time_s - before.at_s) / (after.at_s - before.at_s)
            smooth = share * share * (3.0 - 2.0 * share)
            return Waypoint(
                time_s,
                before.tip_m + smooth * (after.tip_m - before.tip_m),
                before.pitch + smooth * (after.pitch - before.pitch),
                before.roll + smooth * (after.roll - before.roll),
                before.opening + share * (after.opening - before.opening),
            )
    return way[-1]


def ways(cube_m: Array, left: Hand, right: Hand) -> tuple[list[Waypoint], list[Waypoint]]:
    """Return the waypoints of the left and of the right hand."""
    grasp_m = cube_m + _deeper(right.base_m, cube_m)
    above_m = grasp_m + np.array([0.0, 0.0, _ABOVE_M])
    brought_m = _EXCHANGE_M + _deeper(right.base_m, _EXCHANGE_M)
    beside_m = _EXCHANGE_M - np.array([_BESIDE_M, 0.0, 0.0])
    right_way = [
        Waypoint(0.0, right.tip_m, right.pitch, 0.0, 1.0),
        Waypoint(1.2, above_m, _STEEP, 0.0, 1.0),
        Waypoint(1.9, grasp_m, _STEEP, 0.0, 1.0),
        Waypoint(2.3, grasp_m, _STEEP, 0.0, 0.0),
        Waypoint(3.6, brought_m, _STEEP, 0.0, 0.0),
        Waypoint(6.0, brought_m, _STEEP, 0.0, 0.0),
    ]
    left_way = [
        Waypoint(0.0, left.tip_m, left.pitch, 0.0, 1.0),
        Waypoint(1.6, left.tip_m, left.pitch, 0.0, 1.0),
        Waypoint(3.4, beside_m, 0.0, _UPRIGHT, 1.0),
        Waypoint(4.2, _EXCHANGE_M, 0.0, _UPRIGHT, 1.0),
        Waypoint(4.6, _EXCHANGE_M, 0.0, _UPRIGHT, 0.0),
        Waypoint(6.0, _EXCHANGE_M, 0.0, _UPRIGHT, 0.0),
    ]
    return left_way, right_way


def _deeper(base_m: Array, tip_m: Array) -> Array:
    """Return the step (3,) from a place to where the tips of the right hand go [m]."""
    there = Waypoint(0.0, tip_m, _STEEP, 0.0, 1.0)
    return _DEEP_M * pointing(base_m, there)[:, 0]
