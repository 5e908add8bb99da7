"""The policy runtime, and a test of it on recorded pictures.

The runtime runs `n_action_steps` of each chunk, then blends in the next: they differ by up to
0.05 rad.
"""

import math
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from minidual.demos.lerobot_features import STATE
from minidual.errors import DataError, UsageError
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.chunks import ChunkQueue
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import load_policy
from minidual.policies.plausible import Plausible, PolicyStoppedError
from minidual.robot.pair import GRIPPERS_N, Array, Robot

_SAMPLES_N = 256
Limits = tuple[Array, Array]
"""Lower and upper (n,) [rad]."""
Pictures = Mapping[str, Image | Callable[[], Image]]
"""Images (H, W, 3) uint8 by camera, or functions that render them when needed."""


class Latency(NamedTuple):
    """How much simulated time passes until an answer comes.

    Attributes:
        rate_hz: Of actions.
        answer_s: Time of every answer; None: that of `ChunkPolicy.answer_s`.
    """

    rate_hz: float = 50.0
    answer_s: float | None = None


AS_MEASURED = Latency()
"""Latency at the usual rate, as long as the policy's answers take."""


class PolicyRuntime:
    """Maps images and state to actions.

    Args:
        policy: The network behind it.
        n_action_steps: See DeployConfig.
        blend_ticks: See DeployConfig.
        limits: Joint limits (lower, upper) [rad] for clamping.
        latency: How long answers take.

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
        latency: Latency = AS_MEASURED,
    ) -> None:
        self.policy = policy
        self.joints_n = policy.dim - GRIPPERS_N
        self.cameras = policy.cameras
        if policy.own_pace:
            n_action_steps = 1
            blend_ticks = 0
        if not 1 <= n_action_steps <= policy.chunk_size:
            raise UsageError(
                f"n_action_steps {n_action_steps} is outside 1..{policy.chunk_size}, "
                "this policy's chunk",
                remedy=f"--set deploy.n_action_steps={policy.chunk_size}, or fewer",
            )
        self._latency = latency
        self._steps = n_action_steps
        self._blend_ticks = blend_ticks
        self._queue = ChunkQueue(n_action_steps, blend_ticks)
        self._lower = np.full(policy.dim, -np.inf)
        self._upper = np.full(policy.dim, np.inf)
        if limits is not None:
            self._set_limits(limits)
        self._plausible = Plausible(self._lower, self._upper)
        self.times_s: list[float] = []
        """Wall times of inferences without rendering."""
        self.processor_times_s: list[float] = []
        """Processor times of the same, summed over all threads of the process."""
        self.reset()

    @classmethod
    def load(
        cls,
        checkpoint: Path,
        device: str = "cpu",
        *,
        threads: int | None = 1,
        n_action_steps: int = 25,
        blend_ticks: int = 8,
        limits: Limits | None = None,
    ) -> Self:
        """Load any checkpoint; raises as `load_policy`."""
        return cls(
            load_policy(checkpoint, device, threads),
            n_action_steps=n_action_steps,
            blend_ticks=blend_ticks,
            limits=limits,
        )

    @property
    def inference_hz(self) -> float:
        """Mean rate per second of processor time, or NaN.

        Time in which the process waits for a busy machine does not count. The threads of torch
        do, each with its own time, and so do other threads: measure a runtime that runs alone.
        """
        return _mean_rate(self.processor_times_s)

    @property
    def inference_wall_hz(self) -> float:
        """Mean rate per second of wall time, or NaN; a busy machine lowers it."""
        return _mean_rate(self.times_s)

    @property
    def inputs(self) -> Mapping[str, int]:
        """Entries of what a state holds behind joints and openings, by signal (`demos.sensed`)."""
        return self.policy.inputs

    def with_usual_inputs(self, measured: Array) -> Array:
        """Return a state (state_dim,) of joints and openings, with inputs as they were on average."""
        inputs = np.zeros(self.policy.inputs_n)
        mean = self.policy.facts.middles.get(STATE)
        if mean is not None and self.policy.inputs_n:
            inputs = np.array(mean[len(measured) :][: self.policy.inputs_n], dtype=float)
        return np.concatenate([measured, inputs])

    def reset(self) -> None:
        """Drop the queue (new episode or mode)."""
        self._queue.reset()
        self._plausible.reset()
        self.policy.reset()

    def act(self, images: Pictures, state: Array) -> Array:
        """Return this tick's action (dim,): joint targets [rad], then openings.

        `state` is (state_dim,): joints and openings, then what `inputs` names.

        Raises:
            DataError: Missing or wrong input; PolicyStoppedError: what no clamp may hide.
        """
        if self._queue.is_due:
            chunk = self._infer(images, state)
            self._queue.add(chunk, self._delay_ticks())
        # Without a chunk the arms stay where they are.
        action = self._queue.next(np.asarray(state, dtype=float)[: self.policy.dim])
        self._plausible.action(action)
        return np.clip(action, self._lower, self._upper)

    def predict_chunk(self, images: Mapping[str, Image], state: Array) -> Array:
        """Return one raw chunk (chunk_size, dim)."""
        began_s = time.perf_counter()
        processor_began_s = time.process_time()
        self._check_cameras(images)
        checked_images = {camera: self._checked_image(images, camera) for camera in self.cameras}
        chunk = self.policy.predict(checked_images, self._checked_state(state))
        self.processor_times_s.append(time.process_time() - processor_began_s)
        self.times_s.append(time.perf_counter() - began_s)
        if not np.isfinite(chunk).all():
            raise DataError(
                "the policy emitted an action that is not finite",
                remedy="minidual train-act --force",
            )
        return chunk

    def _set_limits(self, limits: Limits) -> None:
        measured = self.policy.state_dim - self.policy.inputs_n
        if np.shape(limits) != (2, self.joints_n) or measured != self.policy.dim:
            raise UsageError(
                f"the checkpoint drives {self.joints_n} joints; the limits are {np.shape(limits)}",
                remedy="choose the arm that was recorded: --set robot.arm=NAME",
            )
        lower, upper = limits
        self._lower = np.concatenate([lower, np.zeros(GRIPPERS_N)])
        self._upper = np.concatenate([upper, np.ones(GRIPPERS_N)])

    def _infer(self, images: Pictures, state: Array) -> Array:
        """Return a checked chunk for the cameras' pictures."""
        rendered = self._rendered(images)
        chunk = self.predict_chunk(rendered, state)
        used = {camera: rendered[camera] for camera in self.cameras}
        self._plausible.pictures(used, np.asarray(state)[: self.joints_n])
        self._plausible.chunk(chunk[: self._steps + self._blend_ticks])
        return chunk

    def _rendered(self, images: Pictures) -> dict[str, Image]:
        """Render the policy's cameras, in the order of `images`."""
        self._check_cameras(images)
        rendered: dict[str, Image] = {}
        for camera, image in images.items():
            if camera in self.cameras:
                rendered[camera] = image() if callable(image) else image
        return rendered

    def _check_cameras(self, images: Collection[str]) -> None:
        """Raise DataError if a camera of the policy is missing."""
        for camera in self.cameras:
            if camera not in images:
                present = ", ".join(sorted(images)) or "none"
                raise DataError(
                    f"no image of camera '{camera}': "
                    f"the policy needs {', '.join(self.cameras)}, given were {present}",
                )

    def _delay_ticks(self) -> int:
        """Return after how many ticks the last answer comes."""
        latency = self._latency
        answer_s = self.policy.answer_s if latency.answer_s is None else latency.answer_s
        ticks = math.ceil(answer_s * latency.rate_hz - 1e-9)
        if ticks >= self.policy.chunk_size:
            limit_s = self.policy.chunk_size / latency.rate_hz
            raise PolicyStoppedError("late_answer", age_s=answer_s, limit_s=limit_s)
        return ticks

    def _checked_state(self, state: Array) -> NDArray[np.float32]:
        array = np.asarray(state, dtype=np.float32)
        dim = self.policy.state_dim
        if array.shape != (dim,):
            inputs = [f"{name} ({entries})" for name, entries in self.inputs.items()]
            entries = [f"{self.joints_n} joints", f"{GRIPPERS_N} grippers", *inputs]
            raise DataError(
                f"the state has shape {array.shape}, not ({dim},): {', '.join(entries)}",
            )
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            raise DataError(f"the state is not finite at index {int(bad[0])}")
        return array

    def _checked_image(self, images: Mapping[str, Image], camera: str) -> Image:
        image = images[camera]
        expected = (*self.cameras[camera], 3)
        if image.shape != expected or image.dtype != np.uint8:
            raise DataError(
                f"camera '{camera}' gives {image.dtype} images of shape {image.shape}; "
                f"the policy was trained on uint8 {expected}",
                remedy="render at the recorded size, or record and train again",
            )
        return np.ascontiguousarray(image)


def _mean_rate(times_s: list[float]) -> float:
    """Return the mean rate [Hz] without the first (warm-up) inference, or NaN."""
    warm_s = times_s[1:] or times_s
    total_s = sum(warm_s)
    return len(warm_s) / total_s if total_s > 0.0 else float("nan")


class EmittedActions(NamedTuple):
    """Actions predicted on recorded observations; NaN for other arms.

    Attributes:
        in_limits: Share of joint targets inside the limits.
        overshoot_max_rad: Largest distance outside.
        targets_n: Joint and gripper targets per action.
        inference_hz: Inferences per second of processor time.
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
    samples_n = min(_SAMPLES_N, len(demos))
    rows = np.linspace(0, len(demos) - 1, samples_n).astype(np.int64)
    chunks: list[Array] = []
    for row in rows:
        images = {camera: demos.images[camera][row] for camera in demos.cameras}
        runtime.reset()
        runtime.policy.instruct(demos.instruction(row))
        chunks.append(runtime.predict_chunk(images, demos.sensed[row].astype(np.float64)))
    actions = np.concatenate(chunks)
    targets_n = actions.shape[1]
    if targets_n != robot.dof + GRIPPERS_N:
        unknown = float("nan")
        return EmittedActions(unknown, unknown, targets_n, runtime.inference_hz)
    joints = actions[:, : robot.dof]
    beyond = np.maximum(robot.q_lower - joints, joints - robot.q_upper)
    outside = np.maximum(beyond, 0.0)
    return EmittedActions(
        in_limits=float((outside == 0.0).mean()),
        overshoot_max_rad=float(outside.max()),
        targets_n=targets_n,
        inference_hz=runtime.inference_hz,
    )
