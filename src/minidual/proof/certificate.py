"""The certificate: proof from few samples that a trajectory touches nothing.

On each stretch every moving pair needs a separating plane (`minidual.proof.planes`). Unproven
stretches are halved.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from minidual.proof import planes
from minidual.proof.layout import Motion
from minidual.proof.limits import check_robot
from minidual.proof.solids import Solids
from minidual.robot.compiled import floats
from minidual.robot.pair import SIDES, Array
from minidual.robot.trajectory import Trajectory

_SLACK_M = 2e-5  # for rounding; the engines' vertices differ by 1e-7 m
_FIRST_RAD = 0.5
"""Length of the first stretches, summed over joints."""
_STRETCHES_MAX = 256
_EVERY = 8  # samples; the length is only to divide the motion


class Certificate(NamedTuple):
    """Outcome of a proof.

    Attributes:
        reason: The unproven pair and time, or "".
        samples_n: Number of stretch ends.
    """

    reason: str
    samples_n: int


def certify(solids: Solids, trajectory: Trajectory) -> Certificate:
    """Prove that a trajectory touches nothing.

    Raises:
        UsageError: A trajectory of another robot.
    """
    q = floats(trajectory.q)
    v = floats(trajectory.v)
    check_robot(solids.robot, trajectory)
    work = solids.workspace(len(q))
    # Pairs without a moving part are checked at the start alone.
    everything = np.arange(len(solids.pairs))
    start_padding = solids.padding(_SLACK_M)
    if planes.survey(solids.geometry, q[:1], everything, start_padding, work) == 0:
        return _refusal(solids, trajectory, [0], int(everything[0]))
    proof = planes.prove(
        solids.geometry,
        Motion(q, v, trajectory.dt_s),
        first_stretches(q, _FIRST_RAD),
        _moving_pairs(solids, q, v),
        _SLACK_M,
        work,
    )
    if proof.sample >= 0:
        return _refusal(solids, trajectory, [proof.sample, proof.sample + 1], proof.pair)
    return Certificate("", int(proof.ends.sum()))


def _moving_pairs(solids: Solids, q: Array, v: Array) -> np.ndarray:
    """Return the rows of the pairs with a part that moves."""
    # Joints whose samples all agree may still move between them.
    moved = ((q != q[0]) | (v != 0.0)).any(axis=0)
    groups = solids.robot.groups
    return solids.of_arms([side for side in SIDES if moved[groups[f"{side}_arm"]].any()])


def first_stretches(q: Array, length_rad: float) -> np.ndarray:
    """Return first and last samples (s, 2) of stretches of about this length, summed over joints.

    `q` holds the samples (n, dof).
    """
    way = float(np.abs(np.diff(q[::_EVERY], axis=0)).clip(max=1e6).sum())
    count = max(1, min(_STRETCHES_MAX, len(q) - 1, math.ceil(way / length_rad)))
    ends = np.arange(count + 1) * (len(q) - 1) // count
    return np.column_stack([ends[:-1], ends[1:]])


def _refusal(
    solids: Solids,
    trajectory: Trajectory,
    samples: Sequence[int],
    pair: int,
) -> Certificate:
    """Return why a pair is not proven apart at, or between, these samples."""
    a, b = sorted(solids.pairs[pair])
    row = np.array([pair])
    for k in samples:
        if not solids.clearance(trajectory.q[[k]], 1.0, row) > 0.0:
            time_s = trajectory.times[k]
            return Certificate(f"collision at {time_s:.3f} s: {a} and {b} touch", len(samples))
    time_s = trajectory.times[samples[0]]
    reason = f"{a} and {b} could not be proven apart after {time_s:.3f} s"
    return Certificate(reason, len(samples))
