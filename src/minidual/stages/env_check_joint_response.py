"""How each joint answers a step of its own, and what the swing of all leaves: one row a joint."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from minidual.robot.constants import DOF, JOINT_NAMES
from minidual.stages.env_check_joint_tracking import Tracking


@dataclass(frozen=True)
class JointResponse:
    """One joint.

    Attributes:
        joint: Name.
        step_rad: Size of its step, with its sign.
        rise_s: Time from 10 % to 90 % of the step; NaN if it never gets there.
        overshoot_rad: How far it went beyond the target.
        settled_rad: Largest error of the 14-D norm in the last fifth of a second: the others must stand still too.
        sine_rms_rad: RMS error while all joints swing.
        sine_peak_rad: Largest error meanwhile.
    """

    joint: str
    step_rad: float
    rise_s: float
    overshoot_rad: float
    settled_rad: float
    sine_rms_rad: float
    sine_peak_rad: float


def joint_responses(steps: Sequence[Tracking], sine: Tracking) -> list[JointResponse]:
    """Return one row a joint.

    Args:
        steps: The step of each joint alone, in the order of the joints (14).
        sine: The swing of all joints.
    """
    peak = np.abs(sine.reference - sine.measured).max(axis=0)
    rows = []
    for j in range(DOF):
        step = steps[j]
        way = float(step.reference[-1, j] - step.start[j])
        rows.append(
            JointResponse(
                JOINT_NAMES[j],
                way,
                rise_time_s(step, j),
                _overshoot(step, j, way),
                step.settled,
                float(sine.joint_rms[j]),
                float(peak[j]),
            )
        )
    return rows


def rise_time_s(step: Tracking, joint: int) -> float:
    """Return the time in which a joint goes from 10 % to 90 % of its step [s], NaN if it does not."""
    share = _share(step, joint)
    first, last = share >= 0.1, share >= 0.9
    if not last.any():
        return float("nan")
    return float(step.t[np.argmax(last)] - step.t[np.argmax(first)])


def _share(step: Tracking, joint: int) -> np.ndarray:
    """Return how much of its way the joint has gone (T,), 1 at the target."""
    way = step.reference[-1, joint] - step.start[joint]
    return (step.measured[:, joint] - step.start[joint]) / way


def _overshoot(step: Tracking, joint: int, way: float) -> float:
    return max(0.0, float(np.max(_share(step, joint)) - 1.0) * abs(way))


def write_joints(path: Path, rows: Sequence[JointResponse]) -> None:
    """Write the rows as CSV, one column a field."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(asdict(rows[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(row).items()} for row in rows)
