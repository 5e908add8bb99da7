"""The policy runtime: a checkpoint, its queue of actions, and nothing that outlives a reset.

One inference predicts a chunk; `n_action_steps` of it run before the next inference. A new chunk takes over
from what is left of the old one over `blend_ticks`, because consecutive chunks disagree by up to 0.05 rad at
their boundary. `reset` and `flush` drop the queue, so an old chunk can never run after a switch of mode.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray

from minidual.errors import DataError, UsageError
from minidual.policies.checkpoint import load_policy
from minidual.policies.demonstrations import JOINTS_N, STATE_DIM
from minidual.policies.factory import require_device

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
CAMERA_PREFIX = "observation.images.cam_"


@dataclass(frozen=True)
class InferenceTiming:
    """Times of the ticks that ran the network, image preprocessing and post-processing included."""

    inferences: int
    mean_s: float
    median_s: float
    p99_s: float
    max_s: float

    @property
    def hz(self) -> float:
        """Inferences per second at the mean time; nan before the first."""
        return 1.0 / self.mean_s if self.mean_s > 0 else float("nan")


class PolicyRuntime:
    """Drives 14 joints and 2 grippers at 50 Hz from camera images and the measured state.

    Use `PolicyRuntime.load`; then per episode `reset()`, and per tick `act(images, state)`.
    """

    def __init__(
        self,
        policy: Any,
        preprocessor: Any,
        postprocessor: Any,
        *,
        n_action_steps: int = 25,
        blend_ticks: int = 8,
        limits: tuple[Floats, Floats] | None = None,
        threads: int | None = 1,
    ) -> None:
        self._policy, self._preprocessor, self._postprocessor = policy, preprocessor, postprocessor
        chunk = int(policy.config.chunk_size)
        if not 1 <= n_action_steps <= chunk:
            raise UsageError(f"n_action_steps {n_action_steps} is outside 1..{chunk}, the chunk of this checkpoint")
        if blend_ticks < 0:
            raise UsageError(f"blend_ticks {blend_ticks} is negative")
        self._steps, self._blend, self._threads = n_action_steps, blend_ticks, threads
        self._sizes = _camera_sizes(policy.config)
        self._lower, self._upper = _limits(limits)
        self._times: list[float] = []
        self.reset()

    @classmethod
    def load(
        cls,
        checkpoint_dir: Path,
        device: str = "cpu",
        *,
        n_action_steps: int = 25,
        blend_ticks: int = 8,
        limits: tuple[Floats, Floats] | None = None,
        threads: int | None = 1,
    ) -> Self:
        """Load a checkpoint without any network.

        Args:
            checkpoint_dir: folder written by `minidual train-act`, or a LeRobot ACT checkpoint of the same features.
            device: "cpu" or "cuda".
            n_action_steps: ticks of each chunk that run before the next inference.
            blend_ticks: ticks over which a new chunk takes over from the old one.
            limits: (lower, upper) of the actions, each (14,) joint limits [rad] or (16,) with the grippers; actions
                are clamped to them. None clamps nothing.
            threads: torch threads; None leaves them as they are.

        Raises:
            DataError: the checkpoint is missing or corrupt.
            EnvironmentMissingError: there is no such device.
        """
        require_device(device)
        return cls(
            *load_policy(Path(checkpoint_dir), device),
            n_action_steps=n_action_steps,
            blend_ticks=blend_ticks,
            limits=limits,
            threads=threads,
        )

    @property
    def cameras(self) -> dict[str, tuple[int, int]]:
        """Cameras the policy looks through, in its order, with image size (H, W)."""
        return dict(self._sizes)

    @property
    def chunk_size(self) -> int:
        """Actions per inference."""
        return int(self._policy.config.chunk_size)

    @property
    def needs_images(self) -> bool:
        """Whether the next `act` runs the network. Images may be left out, or stay callables, when it does not."""
        return self._chunk is None or self._cursor >= self._steps

    @property
    def timing(self) -> InferenceTiming:
        """Times of all inferences since loading but the first, which pays for warming up."""
        times = np.array(self._times[1:] or self._times or [float("nan")])
        return InferenceTiming(
            len(self._times),
            float(times.mean()),
            float(np.median(times)),
            float(np.quantile(times, 0.99)),
            float(times.max()),
        )

    @property
    def inference_hz(self) -> float:
        """Rate at which whole inferences could run: 1 / mean time of a tick that runs the network."""
        return self.timing.hz

    def reset(self) -> None:
        """Begin an episode: drop the queue and all memory of past actions."""
        self._chunk: Floats | None = None
        self._old: Floats | None = None
        self._cursor = 0

    def flush(self) -> None:
        """Drop the queue, as the arbiter demands on a switch of mode; the next tick infers from what it sees."""
        self.reset()

    def act(self, images: Mapping[str, Image | Callable[[], Image]], state: Floats) -> Floats:
        """Return the action (16,) of this tick: 14 joint targets [rad], then 2 gripper commands.

        Args:
            images: camera name to (H, W, 3) uint8, or to a function that renders it, called only on ticks that run
                the network. More cameras than the policy knows are ignored.
            state: (16,) measured joints [rad], then gripper openings.

        Raises:
            DataError: a camera is missing, an image has another size or type, or a value is not finite.
        """
        if self.needs_images:
            self._infer(images, state)
        assert self._chunk is not None
        action = self._chunk[self._cursor]
        if self._old is not None and self._cursor < min(self._blend, len(self._old)):
            share = (self._cursor + 1) / (self._blend + 1)
            action = share * action + (1 - share) * self._old[self._cursor]
        self._cursor += 1
        return np.clip(action, self._lower, self._upper)

    def predict_chunk(self, images: Mapping[str, Any], state: Floats) -> Floats:
        """Return one whole chunk (chunk_size, 16) as the network gives it: not blended, not clamped, not queued."""
        observation: dict[str, Any] = {"observation.state": torch.from_numpy(self._checked_state(state))}
        for camera in self._sizes:
            pixels = self._checked_image(images, camera)
            observation[CAMERA_PREFIX + camera] = torch.from_numpy(pixels).permute(2, 0, 1).float().div_(255.0)
        with torch.inference_mode():
            batch = self._preprocessor(observation)
            chunk = self._postprocessor(self._policy.predict_action_chunk(batch))
        result = chunk[0].to(torch.float64).numpy()
        if not np.isfinite(result).all():
            raise DataError("the policy emitted an action that is not finite", remedy="minidual train-act --force")
        return result

    def _infer(self, images: Mapping[str, Image | Callable[[], Image]], state: Floats) -> None:
        seen = {c: i() if callable(i) and c in self._sizes else i for c, i in images.items()}
        before = torch.get_num_threads()
        if self._threads is not None and before != self._threads:
            torch.set_num_threads(self._threads)
        started = time.perf_counter()
        chunk = self.predict_chunk(seen, state)
        self._times.append(time.perf_counter() - started)
        if self._threads is not None and before != self._threads:
            torch.set_num_threads(before)
        if self._chunk is not None:
            left = self._chunk[self._cursor :]
            # Without overlap the last action is held while the new chunk takes over.
            self._old = left if len(left) else np.repeat(self._chunk[-1:], self._blend, axis=0)
        self._chunk, self._cursor = chunk, 0

    def _checked_state(self, state: Floats) -> NDArray[np.float32]:
        array = np.asarray(state, dtype=np.float32)
        if array.shape != (STATE_DIM,):
            raise DataError(
                f"the state has shape {array.shape}; the policy reads ({STATE_DIM},): 14 joints, 2 grippers"
            )
        if not np.isfinite(array).all():
            raise DataError(f"the state is not finite at index {int(np.flatnonzero(~np.isfinite(array))[0])}")
        return array

    def _checked_image(self, images: Mapping[str, Any], camera: str) -> Image:
        if camera not in images:
            raise DataError(
                f"no image of camera '{camera}'; the policy looks through {', '.join(self._sizes)}, "
                f"given were {', '.join(sorted(images)) or 'none'}"
            )
        image = images[camera]
        expected = (*self._sizes[camera], 3)
        if image.shape != expected or image.dtype != np.uint8:
            raise DataError(
                f"camera '{camera}' gives {image.dtype} images of shape {image.shape}; "
                f"the policy was trained on uint8 {expected}",
                remedy="render at the recorded size, or record and train again",
            )
        return np.ascontiguousarray(image)


def _camera_sizes(config: Any) -> dict[str, tuple[int, int]]:
    sizes: dict[str, tuple[int, int]] = {}
    for key, feature in config.image_features.items():
        if not key.startswith(CAMERA_PREFIX):
            raise DataError(f"the checkpoint reads '{key}'; cameras here are named {CAMERA_PREFIX}<name>")
        sizes[key.removeprefix(CAMERA_PREFIX)] = (int(feature.shape[1]), int(feature.shape[2]))
    state, action = config.robot_state_feature, config.action_feature
    if state is None or action is None or tuple(state.shape) != (STATE_DIM,) or tuple(action.shape) != (STATE_DIM,):
        raise DataError(f"the checkpoint does not map a state of {STATE_DIM} to actions of {STATE_DIM} numbers")
    return sizes


def _limits(limits: tuple[Floats, Floats] | None) -> tuple[Floats, Floats]:
    lower, upper = np.full(STATE_DIM, -np.inf), np.full(STATE_DIM, np.inf)
    if limits is not None:
        low, high = (np.asarray(bound, dtype=float) for bound in limits)
        if low.shape != high.shape or low.shape not in ((JOINTS_N,), (STATE_DIM,)) or np.any(low > high):
            raise UsageError(f"limits must be two rising arrays of 14 or 16, not {low.shape} and {high.shape}")
        lower[: len(low)], upper[: len(high)] = low, high
    return lower, upper
