"""Acceptance test of a new checkpoint."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.policies.demonstrations import Demonstrations
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Robot


@dataclass(frozen=True)
class EmittedActions:
    """Actions on recorded observations.

    Attributes:
        in_limits: Share of predicted joint targets inside the limits.
        in_limits_emitted: The same after clamping.
        overshoot_max_rad: Largest predicted excess.
        joints_n, grippers_n: Entries per action.
        samples: Observations.
    """

    in_limits: float
    in_limits_emitted: float
    overshoot_max_rad: float
    joints_n: int
    grippers_n: int
    samples: int
    inference_hz: float


def exercise_checkpoint(
    checkpoint: Path, demos: Demonstrations, robot: Robot, *, samples: int = 256, device: str = "cpu"
) -> EmittedActions:
    """Run `checkpoint` as deployed on `samples` evenly spaced ticks."""
    lower, upper = robot.q_lower, robot.q_upper
    runtime = PolicyRuntime.load(checkpoint, device, n_action_steps=1, blend_ticks=0, limits=(lower, upper))
    rows = np.linspace(0, len(demos) - 1, min(samples, len(demos))).astype(np.int64)
    chunks, emitted = [], []
    for row in rows:
        images = {camera: demos.images[camera][row] for camera in demos.cameras}
        state = demos.state[row].astype(np.float64)
        chunks.append(runtime.predict_chunk(images, state))
        runtime.reset()
        emitted.append(runtime.act(images, state))
    raw = np.concatenate(chunks)
    joints, sent = raw[:, : robot.dof], np.array(emitted)[:, : robot.dof]
    outside = np.maximum(np.maximum(lower - joints, joints - upper), 0.0)
    return EmittedActions(
        in_limits=float((outside == 0.0).mean()),
        in_limits_emitted=float(((sent >= lower) & (sent <= upper)).mean()),
        overshoot_max_rad=float(outside.max()),
        joints_n=joints.shape[1],
        grippers_n=raw.shape[1] - robot.dof,
        samples=len(rows),
        inference_hz=runtime.inference_hz,
    )
