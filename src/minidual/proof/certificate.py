"""Certificate: proves from few samples that a trajectory touches nothing.

On each stretch every moving pair needs a separating plane (`minidual.proof.planes`). Unproven
stretches are halved, down to two neighbouring samples.
"""

import math
from dataclasses import dataclass

import numpy as np

from minidual.proof import planes
from minidual.proof.solids import Solids
from minidual.robot.compiled import floats
from minidual.robot.pair import SIDES, Array
from minidual.robot.trajectory import Trajectory

_SLACK_M = 2e-5  # for rounding; the engines' vertices differ by 1e-7 m
_FIRST_RAD = 0.5
"""Length of the first stretches, summed over joints."""
_STRETCHES_MAX = 256


@dataclass(frozen=True)
class Certificate:
    """Result of a proof.

    Attributes:
        reason: Unproven pair and time, or "".
        samples_n: Number of stretch ends.
    """

    ok: bool
    reason: str
    samples_n: int


def certify(solids: Solids, trajectory: Trajectory) -> Certificate:
    """Prove a trajectory; never raises."""
    q, v = floats(trajectory.q), floats(trajectory.v)
    # Joints whose samples all agree may still move between them.
    moved = ((q != q[0]) | (v != 0.0)).any(axis=0)
    moving = solids.of_arms([side for side in SIDES if moved[solids.robot.groups[f"{side}_arm"]].any()])
    work = solids.workspace(len(q))
    # Fixed pairs are checked once, at the start; only moving pairs afterwards.
    everything = np.arange(len(solids.pairs))
    if planes.survey(solids.geometry, q[:1], everything, solids.keep(_SLACK_M), work) == 0:
        return _refusal(solids, trajectory, [0], int(everything[0]))
    stretches = first_stretches(q, _FIRST_RAD)
    asked, failed, pair = planes.prove(solids.geometry, q, v, trajectory.dt_s, stretches, moving, _SLACK_M, work)
    if failed >= 0:
        return _refusal(solids, trajectory, [failed, failed + 1], pair)
    return Certificate(True, "", int(asked.sum()))


def first_stretches(q: Array, length_rad: float) -> np.ndarray:
    """Return first and last samples (s, 2) of stretches of about this length, summed over joints."""
    gone = np.cumsum(np.abs(np.diff(q, axis=0)))[q.shape[1] - 1 :: q.shape[1]]
    count = max(1, min(_STRETCHES_MAX, math.ceil(gone[-1] / length_rad)))
    bounds = [0]
    for sample in np.searchsorted(gone, np.arange(1, count) * gone[-1] / count).tolist():
        bounds.append(1 + max(bounds[-1], sample))
    bounds = [sample for sample in bounds if sample < len(gone)]
    return np.column_stack([bounds, [*bounds[1:], len(gone)]])


def _refusal(solids: Solids, trajectory: Trajectory, samples: list[int], pair: int) -> Certificate:
    a, b = sorted(solids.pairs[pair])
    for k in samples:
        if not solids.clearance(trajectory.q[[k]], 1.0, np.array([pair])) > 0.0:
            return Certificate(False, f"collision at {trajectory.times[k]:.3f} s: {a} and {b} touch", len(samples))
    reason = f"{a} and {b} could not be proven apart after {trajectory.times[samples[0]]:.3f} s"
    return Certificate(False, reason, len(samples))
