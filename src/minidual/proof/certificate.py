"""Certificate: proves from few samples that a trajectory never touches anything.

On each stretch of motion every moving pair needs a plane that both ends clear by more than the parts can deviate in
between (`minidual.proof.planes`). Unproven stretches are halved, down to the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.proof import planes
from minidual.proof.solids import Solids
from minidual.robot.compiled import floats
from minidual.robot.trajectory import Trajectory

_SLACK_M = 2e-5
"""Clearance for rounding; the engines' vertices differ by 1e-7 m."""
_FIRST_RAD = 0.5
"""First stretches' length, summed over joints."""


@dataclass(frozen=True)
class Certificate:
    """Result of a proof.

    Attributes:
        reason: The unproven pair and time, if any.
        samples_n: Ends of stretches.
    """

    ok: bool
    reason: str
    samples_n: int


def certify(solids: Solids, trajectory: Trajectory) -> Certificate:
    """Prove a trajectory; never raises."""
    # Joints whose samples all agree may still move between them.
    moved = ((trajectory.q != trajectory.q[0]) | (trajectory.v != 0.0)).any(axis=0)
    groups = solids.robot.groups
    sides = [side for side in solids.robot.sides if moved[groups[f"{side}_arm"]].any()]
    work, q, v = solids.workspace(), floats(trajectory.q), floats(trajectory.v)
    # Fixed pairs are checked once, at the start; only moving pairs afterwards.
    everything = np.arange(len(solids.pairs))
    if planes.survey(solids.geometry, q[:1], everything, solids.keep(_SLACK_M), work) == 0:
        return _refusal(solids, trajectory, 0, 0, int(everything[0]))
    asked, failed, pair = planes.prove(
        solids.geometry, q, v, trajectory.dt_s, _FIRST_RAD, solids.of_arms(sides), _SLACK_M, work[0]
    )
    if failed >= 0:
        return _refusal(solids, trajectory, failed, failed + 1, pair)
    return Certificate(True, "", int(asked.sum()))


def _refusal(solids: Solids, trajectory: Trajectory, first: int, last: int, pair: int) -> Certificate:
    """Distinguish contact from a failed proof."""
    a, b = sorted(solids.pairs[pair])
    for k in (first, last):
        if not solids.clearance(trajectory.q[[k]], 1.0, np.array([pair])) > 0.0:
            return Certificate(False, f"collision at {trajectory.times[k]:.3f} s: {a} and {b} touch", last - first + 1)
    reason = f"{a} and {b} could not be proven apart after {trajectory.times[first]:.3f} s"
    return Certificate(False, reason, last - first + 1)
