"""Offer of the stage that puts a held object into another one."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from minidual.robot.pair import Array, pose
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.motions import straight
from minidual.skills.pipeline.stage import Candidate, Offer, Tools
from minidual.skills.states import Arms, Segment, State, still

_SEARCH_M = 0.0035
_SEARCH_PITCH_M = 0.0012
"""Radius and pitch of the spiral."""
_DRIVEN_M = 0.020
"""Distance beyond the end to which an object is driven by force."""


def insert(
    arms: Arms,
    way: Sequence[Array],
    inserted: str,
    into: str,
    start: State,
    tools: Tools,
) -> Iterator[Offer]:
    """Yield the insertion of a held object: it touches, searches across its y axis, and goes in.

    `by_force` drives it without a search.

    Args:
        arms: Hands that hold it.
        way: Its poses (4, 4) at the touch and at the end.
        inserted: Name of the held object.
        into: Name of the other one.
        start: State before.
        tools: Of the search.
    """
    scene = tools.scene(start).allowing(inserted, into, "one goes into the other")
    touch, end = way
    insertion = PHASES["insert"]
    if tools.by_force:
        poses = [end @ pose(np.eye(3), (0.0, _DRIVEN_M, 0.0))]
        hold_s = insertion.force_s
    else:
        poses = [*_spiral(touch), touch, end]
        hold_s = insertion.hold_s
    state = start
    segments: list[Segment] = []
    for T in poses:
        targets = {arm: T @ start.held_by[arm] for arm in arms}
        segment = straight(tools, "insert", state, targets, scene)
        segments.append(replace(segment, soft=arms))
        state = replace(
            state,
            q=segment.trajectory.q[-1],
            objects={**start.objects, inserted: T},
        )
    segments.append(still("settle", state.q, hold_s, state.openings, soft=arms))
    yield Candidate("", 0.0, state, tuple(segments))


def _spiral(T: Array) -> Iterator[Array]:
    """Yield poses (4, 4) on a spiral of even pitch about T, in its x-z plane."""
    count = int(np.pi * (_SEARCH_M / _SEARCH_PITCH_M) ** 2) + 1
    for k in range(count):
        angle = np.sqrt(4.0 * np.pi * k)
        radius_m = _SEARCH_PITCH_M * np.sqrt(k / np.pi)
        yield T @ pose(np.eye(3), (radius_m * np.cos(angle), 0.0, radius_m * np.sin(angle)))
