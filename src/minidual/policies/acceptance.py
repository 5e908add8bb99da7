"""Acceptance test of a new checkpoint."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.demos.schema import GRIPPERS_N
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Robot


@dataclass(frozen=True)
class EmittedActions:
    """Actions predicted on recorded observations; NaN for other arms.

    Attributes:
        in_limits: Share of joint targets inside the limits.
        overshoot_max_rad: Largest distance outside.
        targets_n: Joint and gripper targets per action.
    """

    in_limits: float
    overshoot_max_rad: float
    targets_n: int
    inference_hz: float


def exercise_checkpoint(
    checkpoint: Path, demos: Demonstrations, robot: Robot, *, samples: int = 256, device: str = "cpu"
) -> EmittedActions:
    """Run `checkpoint` on `samples` evenly spaced ticks, without clamping."""
    runtime = PolicyRuntime.load(checkpoint, device, n_action_steps=1, blend_ticks=0)
    chunks = []
    for row in np.linspace(0, len(demos) - 1, min(samples, len(demos))).astype(np.int64):
        images = {camera: demos.images[camera][row] for camera in demos.cameras}
        chunks.append(runtime.predict_chunk(images, demos.state[row].astype(np.float64)))
    raw = np.concatenate(chunks)
    in_limits = overshoot = float("nan")
    if raw.shape[1] == robot.dof + GRIPPERS_N:
        joints = raw[:, : robot.dof]
        outside = np.maximum(np.maximum(robot.q_lower - joints, joints - robot.q_upper), 0.0)
        in_limits, overshoot = float((outside == 0.0).mean()), float(outside.max())
    return EmittedActions(in_limits, overshoot, raw.shape[1], runtime.inference_hz)
