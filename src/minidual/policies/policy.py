"""The policy runtime, and tests of it on pictures.

The runtime runs `n_action_steps` of each chunk, then blends in the next: they differ by up to 0.05 rad.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError, UsageError
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import ChunkPolicy, Image, load_policy
from minidual.policies.plausible import Plausible
from minidual.robot.pair import GRIPPERS_N, Array, Robot

CELL_PX = 8
_SAMPLES_N = 256
Limits = tuple[Array, Array]
"""Lower and upper (n,) [rad]."""


class PolicyRuntime:
    """Maps images and state to actions.

    Args:
        n_action_steps, blend_ticks: See DeployConfig.
        limits: Joint limits (lower, upper) [rad] for clamping.

    Raises:
        UsageError: Settings unfit for the checkpoint.
    """

    def __init__(
        self,
        policy: ChunkPolicy,
        *,
        n_action_steps: int = 25,
        blend_ticks: int = 8,
        limits: Limits | None = None,
    ) -> None:
        self.policy = policy
        self.joints_n = policy.dim - GRIPPERS_N
        self.cameras = policy.cameras
        if not 1 <= n_action_steps <= policy.chunk_size:
            raise UsageError(
                f"n_action_steps {n_action_steps} is outside 1..{policy.chunk_size}, this policy's chunk",
            )
        self._steps = n_action_steps
        self._blend = blend_ticks
        self._lower = np.full(policy.dim, -np.inf)
        self._upper = np.full(policy.dim, np.inf)
        if limits is not None:
            if np.shape(limits) != (2, self.joints_n):
                what = f"the checkpoint drives {self.joints_n} joints; the limits are {np.shape(limits)}"
                raise UsageError(
                    what,
                    remedy="choose the arm that was recorded: --set robot.arm=NAME",
                )
            self._lower, self._upper = np.concatenate(
                [limits, [[0.0] * GRIPPERS_N, [1.0] * GRIPPERS_N]],
                axis=1,
            )
        self._plausible = Plausible(self._lower, self._upper)
        self.times_s: list[float] = []
        """Inference times without rendering."""
        self.reset()

    @classmethod
    def load(
        cls,
        checkpoint: Path,
        device: str = "cpu",
        *,
        threads: int | None = 1,
        **options: Any,
    ) -> Self:
        """Load any checkpoint; raises as `load_policy`."""
        return cls(load_policy(checkpoint, device, threads), **options)

    @property
    def inference_hz(self) -> float:
        """Mean rate without the first (warm-up) inference, or NaN."""
        times = self.times_s[1:] or self.times_s
        return 1.0 / float(np.mean(times)) if times else float("nan")

    def reset(self) -> None:
        """Drop the queue (new episode or mode)."""
        self._chunk: Array | None = None
        self._old: Array | None = None
        self._cursor = 0
        self._plausible.reset()
        self.policy.reset()

    def act(self, images: Mapping[str, Image | Callable[[], Image]], state: Array) -> Array:
        """Return this tick's action (dim,): joint targets [rad], then openings.

        `images` are (H, W, 3) uint8, or functions that render them when needed; `state` is (dim,).

        Raises:
            DataError: Missing or wrong input; PolicyStoppedError: what no clamp may hide.
        """
        n = self.joints_n
        if self._chunk is None or self._cursor >= self._steps:
            seen: dict[str, Any] = {
                c: i() if callable(i) and c in self.cameras else i for c, i in images.items()
            }
            chunk = self.predict_chunk(seen, state)
            self._plausible.pictures(
                {camera: seen[camera] for camera in self.cameras},
                np.asarray(state)[:n],
            )
            self._plausible.chunk(chunk[: self._steps + self._blend])
            if self._chunk is not None:
                left = self._chunk[self._cursor :]
                # Without overlap the last action is held while the new chunk is blended in.
                self._old = left if len(left) else np.repeat(self._chunk[-1:], self._blend, axis=0)
            self._chunk = chunk
            self._cursor = 0
        action = self._chunk[self._cursor]
        if self._old is not None and self._cursor < min(self._blend, len(self._old)):
            share = (self._cursor + 1) / (self._blend + 1)
            action = share * action + (1 - share) * self._old[self._cursor]
        self._cursor += 1
        self._plausible.action(action)
        return np.clip(action, self._lower, self._upper)

    def predict_chunk(self, images: Mapping[str, Image], state: Array) -> Array:
        """Return one raw chunk (chunk_size, dim)."""
        started = time.perf_counter()
        seen = {camera: self._checked_image(images, camera) for camera in self.cameras}
        chunk = self.policy.predict(seen, self._checked_state(state))
        self.times_s.append(time.perf_counter() - started)
        if not np.isfinite(chunk).all():
            raise DataError(
                "the policy emitted an action that is not finite",
                remedy="minidual train-act --force",
            )
        return chunk

    def _checked_state(self, state: Array) -> NDArray[np.float32]:
        array = np.asarray(state, dtype=np.float32)
        dim = self.policy.dim
        if array.shape != (dim,):
            raise DataError(
                f"the state has shape {array.shape}, not ({dim},): {self.joints_n} joints, 2 grippers",
            )
        if not np.isfinite(array).all():
            raise DataError(
                f"the state is not finite at index {int(np.flatnonzero(~np.isfinite(array))[0])}",
            )
        return array

    def _checked_image(self, images: Mapping[str, Image], camera: str) -> Image:
        if camera not in images:
            given = f"given were {', '.join(sorted(images)) or 'none'}"
            raise DataError(
                f"no image of camera '{camera}': the policy needs {', '.join(self.cameras)}, {given}",
            )
        image = images[camera]
        expected = (*self.cameras[camera], 3)
        if image.shape != expected or image.dtype != np.uint8:
            given = f"camera '{camera}' gives {image.dtype} images of shape {image.shape}"
            remedy = "render at the recorded size, or record and train again"
            raise DataError(f"{given}; the policy was trained on uint8 {expected}", remedy=remedy)
        return np.ascontiguousarray(image)


class EmittedActions(NamedTuple):
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
    checkpoint: Path,
    demos: Demonstrations,
    robot: Robot,
    device: str = "cpu",
) -> EmittedActions:
    """Run `checkpoint` on evenly spaced ticks, without clamping."""
    runtime = PolicyRuntime.load(checkpoint, device, n_action_steps=1, blend_ticks=0)
    chunks = []
    for row in np.linspace(0, len(demos) - 1, min(_SAMPLES_N, len(demos))).astype(np.int64):
        images = {camera: demos.images[camera][row] for camera in demos.cameras}
        runtime.reset()
        chunks.append(runtime.predict_chunk(images, demos.state[row].astype(np.float64)))
    raw = np.concatenate(chunks)
    in_limits = overshoot = float("nan")
    if raw.shape[1] == robot.dof + GRIPPERS_N:
        joints = raw[:, : robot.dof]
        outside = np.maximum(np.maximum(robot.q_lower - joints, joints - robot.q_upper), 0.0)
        in_limits = float((outside == 0.0).mean())
        overshoot = float(outside.max())
    return EmittedActions(in_limits, overshoot, raw.shape[1], runtime.inference_hz)


def occlusion(predict: Callable[[Image], NDArray[np.float64]], image: Image) -> NDArray[np.float64]:
    """Return the mean change of predicted values when a cell shows the median colour around it, (H, W) in cells."""
    plain = predict(image)
    (height, width, _) = image.shape
    changes = np.zeros((height // CELL_PX, width // CELL_PX))
    for row, column in np.ndindex(*changes.shape):
        covered = image.copy()
        y = CELL_PX * row
        x = CELL_PX * column
        around = image[max(0, y - CELL_PX) : y + 2 * CELL_PX, max(0, x - CELL_PX) : x + 2 * CELL_PX]
        covered[y : y + CELL_PX, x : x + CELL_PX] = np.median(around, axis=(0, 1))
        changes[row, column] = np.abs(predict(covered) - plain).mean()
    return changes


def on_object(changes: NDArray[np.float64], image: Image, without: Image) -> float:
    """Return the mean change in cells with the object over the others, 0 where it is not seen; `without` lacks it."""
    rows, columns = changes.shape
    differs = (image != without).any(axis=2)[: CELL_PX * rows, : CELL_PX * columns]
    shown = differs.reshape(rows, CELL_PX, columns, CELL_PX).any(axis=(1, 3))
    return float(changes[shown].mean() / max(changes[~shown].mean(), 1e-12)) if shown.any() else 0.0
