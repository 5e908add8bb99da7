"""The continuous proof: from few samples, that a trajectory touches nothing at any time.

The motion is cut into stretches. On each, every pair of parts that moves must have a plane between them that both ends
keep clear of by more than the parts can deviate in between (`minidual.proof.planes`; the trajectory is a cubic between
its samples, so this is a bound). A stretch without such planes is halved. One from a sample to the next that has none
refuses the motion, so samples should be as dense as those of a plan, a millisecond apart.

No collision library has a say in it; audits (`minidual.proof.verify`) ask two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.proof import planes
from minidual.proof.solids import Solids
from minidual.robot.compiled import floats
from minidual.robot.trajectory import Trajectory

_SLACK_M = 2e-5
"""Distance that every plane must show beside: what rounding may take (the engines' vertices differ by 1e-7 m)."""
_FIRST_RAD = 0.5
"""Length of the first stretches, summed over the joints."""


@dataclass(frozen=True)
class Certificate:
    """What was proven.

    ok: Every moment is proven free.
    reason: Empty if ok, else the pair and the time that are not.
    samples_n: States at which a stretch ends.
    """

    ok: bool
    reason: str
    samples_n: int


def certify(solids: Solids, trajectory: Trajectory) -> Certificate:
    """Return what can be proven about a trajectory; it never raises for a bad one."""
    # Samples that stand still may be passed at speed.
    moved = ((trajectory.q != trajectory.q[0]) | (trajectory.v != 0.0)).any(axis=0)
    groups = solids.robot.groups
    sides = [side for side in solids.robot.sides if moved[groups[f"{side}_arm"]].any()]
    work, q, v = solids.workspace(), floats(trajectory.q), floats(trajectory.v)
    # What does not move is looked at once; from there on only what does.
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
    """Say why a motion is refused that the planes do not separate for a pair between two samples."""
    a, b = sorted(solids.pairs[pair])
    for k in (first, last):
        if not solids.clearance(trajectory.q[[k]], 1.0, np.array([pair])) > 0.0:
            return Certificate(False, f"collision at {trajectory.times[k]:.3f} s: {a} and {b} touch", last - first + 1)
    reason = f"{a} and {b} could not be proven apart after {trajectory.times[first]:.3f} s"
    return Certificate(False, reason, last - first + 1)
