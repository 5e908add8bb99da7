"""The policy runtime: queue, blending, flush, clamps, and errors that name what is wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from minidual.errors import DataError, UsageError
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.policy import PolicyRuntime

IMAGE = {"high": np.zeros((12, 16, 3), np.uint8)}
STATE = np.zeros(16)


class CountingPolicy(ChunkPolicy):
    """Emits chunk number n as n + k / 1000 for tick k, so that every action tells where it comes from."""

    def __init__(self, chunk: int, cameras: tuple[str, ...] = ("high",)) -> None:
        self.calls = 0
        self.seen: list[dict[str, Image]] = []
        self.resets = 0
        self.chunk_size = chunk
        self.dim = 16
        self.cameras = dict.fromkeys(cameras, (12, 16))

    def reset(self) -> None:
        self.resets += 1

    def predict(self, images: Mapping[str, Image], state: np.ndarray) -> np.ndarray:
        self.calls += 1
        self.seen.append(dict(images))
        return np.repeat(
            (self.calls + np.arange(self.chunk_size) / 1000)[:, None],
            self.dim,
            axis=1,
        )


def counting(chunk: int = 10, **options: Any) -> tuple[PolicyRuntime, CountingPolicy]:
    policy = CountingPolicy(chunk)
    return PolicyRuntime(policy, **{"n_action_steps": 5, "blend_ticks": 0, **options}), policy


def first(runtime: PolicyRuntime, ticks: int) -> list[float]:
    return [round(float(runtime.act(IMAGE, STATE)[0]), 6) for _ in range(ticks)]


def test_a_chunk_runs_for_its_steps_and_then_the_next_is_inferred() -> None:
    runtime, policy = counting()
    assert first(runtime, 7) == pytest.approx(
        [1.0, 1.001, 1.002, 1.003, 1.004, 2.0, 2.001],
        abs=1e-6,
    )
    assert policy.calls == 2


def test_after_a_reset_nothing_of_the_old_chunk_runs() -> None:
    runtime, _ = counting(blend_ticks=4)
    first(runtime, 2)
    runtime.reset()
    assert first(runtime, 5) == pytest.approx(
        [2.0, 2.001, 2.002, 2.003, 2.004],
        abs=1e-6,
    )  # no blend with chunk 1


def test_chunks_are_blended_with_what_was_left_of_the_old_one() -> None:
    runtime, _ = counting(blend_ticks=3)
    actions = first(runtime, 10)
    old = [1.005, 1.006, 1.007]
    expected = [
        (1 - s) * o + s * (2 + k / 1000)
        for k, (o, s) in enumerate(zip(old, (0.25, 0.5, 0.75), strict=True))
    ]
    assert actions[5:8] == pytest.approx(expected, abs=1e-6)
    assert actions[8:] == pytest.approx([2.003, 2.004], abs=1e-6)


def test_blending_without_overlap_starts_from_the_last_action() -> None:
    runtime, _ = counting(chunk=5, blend_ticks=2)
    assert first(runtime, 7)[5] == pytest.approx((1.004 * 2 + 2.0) / 3, abs=1e-6)


def test_blending_shrinks_the_jump_at_the_boundary() -> None:
    jumps = []
    for ticks in (0, 8):
        runtime, _ = counting(chunk=50, n_action_steps=25, blend_ticks=ticks)
        jumps.append(np.abs(np.diff(first(runtime, 60))).max())
    assert jumps[1] < 0.2 * jumps[0]


def test_actions_are_clamped_to_the_limits() -> None:
    upper = np.full(14, 1.002)
    runtime, _ = counting(limits=(np.full(14, -1.0), upper))
    actions = np.array([runtime.act(IMAGE, STATE) for _ in range(5)])
    assert actions[:, :14].max() == pytest.approx(1.002)
    assert actions[:, 14:].max() == 1.0  # an opening has limits of its own


def test_pictures_are_rendered_only_when_they_are_looked_at() -> None:
    runtime, _ = counting()
    rendered = 0

    def camera() -> np.ndarray:
        nonlocal rendered
        rendered += 1
        return IMAGE["high"]

    for _ in range(12):
        runtime.act({"high": camera}, STATE)
    assert rendered == 3


def test_timing_counts_inferences_only() -> None:
    runtime, _ = counting()
    first(runtime, 12)
    assert len(runtime.times_s) == 3
    assert runtime.inference_hz == pytest.approx(1 / np.mean(runtime.processor_times_s[1:]))
    assert runtime.inference_wall_hz == pytest.approx(1 / np.mean(runtime.times_s[1:]))


def test_wrong_observations_are_refused() -> None:
    runtime, _ = counting()
    with pytest.raises(DataError, match=r"no image of camera 'high'.*given were left"):
        runtime.act({"left": IMAGE["high"]}, STATE)
    with pytest.raises(DataError, match=r"shape \(24, 32, 3\).*trained on uint8 \(12, 16, 3\)"):
        runtime.act({"high": np.zeros((24, 32, 3), np.uint8)}, STATE)
    with pytest.raises(DataError, match="float64 images"):
        runtime.act({"high": np.zeros((12, 16, 3))}, STATE)
    with pytest.raises(DataError, match=r"state has shape \(14,\)"):
        runtime.act(IMAGE, np.zeros(14))
    with pytest.raises(DataError, match="not finite at index 3"):
        runtime.act(IMAGE, np.where(np.arange(16) == 3, np.nan, 0.0))


def test_an_action_that_is_not_finite_never_leaves() -> None:
    runtime, policy = counting()
    policy.predict = lambda images, state: np.full((10, 16), np.nan)  # type: ignore[method-assign]
    with pytest.raises(DataError, match="emitted an action that is not finite"):
        runtime.act(IMAGE, STATE)


def test_impossible_queues_and_limits_are_refused() -> None:
    with pytest.raises(UsageError, match=r"n_action_steps 11 is outside 1\.\.10"):
        counting(n_action_steps=11)
    with pytest.raises(UsageError, match="drives 14 joints; the limits are"):
        counting(limits=(np.zeros(7), np.ones(7)))
    with pytest.raises(UsageError, match="drives 14 joints") as caught:
        counting(limits=(np.zeros(12), np.ones(12)))
    assert "robot.arm" in str(caught.value.remedy)


def test_cameras_keep_the_order_of_training_whatever_the_order_given() -> None:
    policy = CountingPolicy(10, cameras=("high", "left"))
    runtime = PolicyRuntime(policy, n_action_steps=1)
    bright = np.full((12, 16, 3), 255, np.uint8)
    runtime.act({"left": bright, "right": bright, "high": IMAGE["high"]}, STATE)
    assert list(policy.seen[0]) == ["high", "left"]
    assert policy.seen[0]["left"].min() == 255
    assert policy.seen[0]["high"].max() == 0


def test_a_reset_reaches_the_policy() -> None:
    runtime, policy = counting()
    before = policy.resets
    first(runtime, 12)
    assert policy.resets == before
    runtime.reset()
    assert policy.resets == before + 1
