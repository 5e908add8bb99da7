"""What a fresh checkpoint must do before it may drive anything: load, emit 16 finite numbers, stay inside limits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minidual.policies.demonstrations import JOINTS_N, Demonstrations
from minidual.policies.policy import PolicyRuntime

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EmittedActions:
    """What the reloaded policy emitted on recorded observations.

    `in_limits` is the share of joint targets inside the limits as the network gives them; `in_limits_emitted` the
    same for the actions that leave the runtime, which clamps. `overshoot_max_rad` is how far the worst raw target
    lies outside. `joints_n` and `grippers_n` are the widths of an action.
    """

    in_limits: float
    in_limits_emitted: float
    overshoot_max_rad: float
    joints_n: int
    grippers_n: int
    samples: int
    inference_hz: float


def exercise_checkpoint(
    checkpoint: Path, demos: Demonstrations, lower: Floats, upper: Floats, *, samples: int = 256, device: str = "cpu"
) -> EmittedActions:
    """Load `checkpoint` as deployment does and run it on `samples` ticks spread evenly over the dataset.

    Args:
        checkpoint: folder of the checkpoint.
        demos: the recorded observations.
        lower: (14,) lower joint limits [rad].
        upper: (14,) upper joint limits [rad].
        samples: how many ticks.
        device: where to run.
    """
    runtime = PolicyRuntime.load(checkpoint, device, n_action_steps=1, blend_ticks=0, limits=(lower, upper))
    rows = np.linspace(0, len(demos) - 1, min(samples, len(demos))).astype(np.int64)
    chunks: list[Floats] = []
    emitted: list[Floats] = []
    for row in rows:
        images = {camera: demos.images[camera][row] for camera in demos.cameras}
        state = demos.state[row].astype(np.float64)
        chunks.append(runtime.predict_chunk(images, state))
        runtime.reset()
        emitted.append(runtime.act(images, state))
    raw = np.concatenate(chunks)
    joints, sent = raw[:, :JOINTS_N], np.array(emitted)[:, :JOINTS_N]
    outside = np.maximum(np.maximum(lower - joints, joints - upper), 0.0)
    return EmittedActions(
        in_limits=float((outside == 0.0).mean()),
        in_limits_emitted=float(((sent >= lower) & (sent <= upper)).mean()),
        overshoot_max_rad=float(outside.max()),
        joints_n=joints.shape[1],
        grippers_n=raw.shape[1] - JOINTS_N,
        samples=len(rows),
        inference_hz=runtime.inference_hz,
    )
