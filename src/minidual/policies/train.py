"""The training loop: deterministic from its seed, stopped by steps, resumable at any step.

Every step draws its rows, noise and dropout from a stream named by (seed, step), so a run that was interrupted
and resumed ends with the same weights as one that was not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from minidual.config.learning import TrainConfig
from minidual.config.seeds import stream
from minidual.errors import DataError, UsageError
from minidual.policies.batches import BatchMaker
from minidual.policies.checkpoint import load_progress, save_policy, save_progress, training_fingerprint
from minidual.policies.demonstrations import JOINTS_N, Demonstrations, WeightedRows, split_episodes
from minidual.policies.factory import build_policy, parameters_n, use_bf16
from minidual.policies.normalisation import dataset_statistics

VALIDATION_ROWS = 512
Advance = Callable[[int, float], None]


@dataclass(frozen=True)
class LossRow:
    """One line of the loss curve: means since the last line, and validation where it was computed."""

    step: int
    loss: float
    l1: float
    keyframe: float | None
    learning_rate: float
    validation_l1: float | None = None
    validation_keyframe_rad: float | None = None


@dataclass
class TrainResult:
    """What a training run did. L1 is in units of the action's std; it does not select checkpoints."""

    steps: int
    steps_asked: int
    train_s: float
    samples_per_s: float
    parameters: int
    loss_initial: float
    loss_final: float
    loss_ratio: float
    validation_l1: float | None
    validation_keyframe_rad: float | None
    training_episodes: list[int]
    validation_episodes: list[int]
    ticks: int
    bf16: bool
    resumed_from_step: int
    stopped_by: str
    curve: list[LossRow] = field(default_factory=list)


@dataclass
class _State:
    """What a resumed run needs beside weights and optimiser."""

    step: int = 0
    spent_s: float = 0.0
    first_l1: list[float] = field(default_factory=list)
    curve: list[LossRow] = field(default_factory=list)


def train(
    demos: Demonstrations,
    config: TrainConfig,
    seed: int,
    checkpoint_dir: Path,
    *,
    resume_dir: Path | None = None,
    advance: Advance | None = None,
) -> TrainResult:
    """Train a policy on `demos` and write it to `checkpoint_dir` in LeRobot's layout.

    Args:
        demos: the dataset in memory; it is read, never copied.
        config: architecture, optimisation and sampling.
        seed: seed of the run; on a CPU the same seed, data and thread count give the same weights.
        checkpoint_dir: new folder; it appears only when it is whole.
        resume_dir: where progress is kept every `checkpoint_every_steps` and on Ctrl-C; a later call with the
            same data, configuration and seed goes on from there. None keeps none.
        advance: called after each step with (steps done since the last call, loss).

    Raises:
        DataError: the dataset cannot be used.
        UsageError: the loss is no longer finite.
        EnvironmentMissingError: the device is missing.
    """
    sizes = {camera: demos.images[camera].shape[1:3] for camera in demos.cameras}
    training, validation = split_episodes(
        list(demos.episode_bounds()), config.validation_fraction, stream(seed, "train.split")
    )
    rows = demos.rows_of(training)
    stats = dataset_statistics(demos, rows, config.std_floor)
    with _torch_settings(config, seed):
        policy, preprocessor, postprocessor = build_policy(config, sizes, stats)
        loop = _Loop(demos, config, seed, policy, rows, demos.rows_of(validation) if validation else None, stats)
        fingerprint = training_fingerprint(demos, config, seed)
        resumed = loop.resume(resume_dir, fingerprint)
        try:
            stopped_by = loop.run(resume_dir, fingerprint, advance)
        except KeyboardInterrupt:
            loop.save(resume_dir, fingerprint)
            raise
        loop.use_averaged_weights()
        save_policy(policy, preprocessor, postprocessor, checkpoint_dir)
    return loop.result(training, validation, resumed, stopped_by, use_bf16(config))


@contextmanager
def _torch_settings(config: TrainConfig, seed: int) -> Iterator[None]:
    """Set threads and the torch generator for the training, and put both back afterwards."""
    threads = torch.get_num_threads()
    devices = [torch.cuda.current_device()] if config.device == "cuda" and torch.cuda.is_available() else []
    with torch.random.fork_rng(devices=devices):
        torch.set_num_threads(config.threads)
        torch.manual_seed(_torch_seed(seed, "train.weights", 0))
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def _torch_seed(seed: int, name: str, index: int) -> int:
    return int(stream(seed, name, index).integers(2**63))


class _Loop:
    """The optimiser's state and one step of it."""

    def __init__(
        self,
        demos: Demonstrations,
        config: TrainConfig,
        seed: int,
        policy: Any,
        rows: NDArray[np.int64],
        validation_rows: NDArray[np.int64] | None,
        stats: dict[str, dict[str, Tensor]],
    ) -> None:
        self.config, self.seed, self.policy, self.stats = config, seed, policy, stats
        self.batches = BatchMaker(demos, config, stats)
        weights = np.where(demos.phase[rows] == 0, config.approach_weight, 1.0)
        self.sampler = WeightedRows(rows, weights)
        self.rows_n = len(rows)
        self.validation_rows: NDArray[np.int64] | None = None
        if validation_rows is not None:
            chosen = np.linspace(0, len(validation_rows) - 1, min(VALIDATION_ROWS, len(validation_rows)))
            self.validation_rows = validation_rows[chosen.astype(np.int64)]
        self.parameters = [p for p in policy.parameters() if p.requires_grad]
        self.optimiser = torch.optim.AdamW(
            self.parameters, lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self.average = [p.detach().clone() for p in self.parameters]
        self.state = _State()
        self._recent: list[tuple[float, float, float | None]] = []

    def learning_rate(self, step: int) -> float:
        """Return the rate of a step: linear warm-up, then a cosine down to one hundredth."""
        config = self.config
        warmup = max(1, round(config.warmup_fraction * config.steps))
        if step < warmup:
            return config.learning_rate * (step + 1) / warmup
        done = (step - warmup) / max(1, config.steps - warmup)
        return config.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * done)))

    def run(self, resume_dir: Path | None, fingerprint: str, advance: Advance | None) -> str:
        """Train to the last step; return "steps", or "time limit" if that came first."""
        config, state = self.config, self.state
        self.policy.train()
        last = time.perf_counter()
        while state.step < config.steps:
            loss = self._step(state.step)
            state.step += 1
            if state.step % config.log_every_steps == 0 or state.step == config.steps:
                self._log()
            now = time.perf_counter()
            state.spent_s, last = state.spent_s + now - last, now
            if state.step % config.checkpoint_every_steps == 0 and state.step < config.steps:
                self.save(resume_dir, fingerprint)
            if advance is not None:
                advance(1, loss)
            if state.spent_s > config.time_limit_s and state.step < config.steps:
                self._log()
                return "time limit"
        return "steps"

    def _step(self, step: int) -> float:
        rng = stream(self.seed, "train.batch", step)
        torch.manual_seed(int(rng.integers(2**63)))
        batch = self.batches.training(self.sampler.draw(self.config.batch_size, rng), rng)
        rate = self.learning_rate(step)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        loss, parts = self.policy.forward(batch)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise UsageError(
                f"the training loss became {value} at step {step} (learning rate {rate:.2g}, "
                f"gradient clip {self.config.gradient_clip:g})",
                remedy="lower train.learning_rate, for example --set train.learning_rate="
                f"{self.config.learning_rate / 3:.1g}",
            )
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.parameters, self.config.gradient_clip)
        self.optimiser.step()
        if self.config.ema_decay > 0:
            # A short memory at first: the random initial weights must not linger in the average.
            decay = min(self.config.ema_decay, (1 + step) / (10 + step))
            torch._foreach_lerp_(self.average, [p.detach() for p in self.parameters], 1.0 - decay)
        self._recent.append((value, parts["l1_loss"], parts.get("keyframe_loss")))
        if len(self.state.first_l1) < 5:
            self.state.first_l1.append(parts["l1_loss"])
        return value

    def _log(self) -> None:
        if not self._recent:
            return
        step, config = self.state.step, self.config
        keyframes = [k for _, _, k in self._recent if k is not None]
        due = step // config.validate_every_steps > self._last_logged() // config.validate_every_steps
        validation = self._validate() if due or step == config.steps else (None, None)
        self.state.curve.append(
            LossRow(
                step,
                float(np.mean([r[0] for r in self._recent])),
                float(np.mean([r[1] for r in self._recent])),
                float(np.mean(keyframes)) if keyframes else None,
                self.learning_rate(step - 1),
                *validation,
            )
        )
        self._recent.clear()

    def _last_logged(self) -> int:
        return self.state.curve[-1].step if self.state.curve else 0

    @torch.no_grad()
    def _validate(self) -> tuple[float | None, float | None]:
        """Return L1 (in std) and the mean keyframe error [rad] on held-out episodes, with the averaged weights."""
        if self.validation_rows is None:
            return None, None
        current = [p.detach().clone() for p in self.parameters]
        self.use_averaged_weights()
        self.policy.eval()
        l1: list[float] = []
        keyframe: list[Tensor] = []
        for start in range(0, len(self.validation_rows), 64):
            batch = self.batches.clean(self.validation_rows[start : start + 64])
            observation = {k: v for k, v in batch.items() if k.startswith("observation.")}
            chunk = self.policy.predict_action_chunk(observation)
            l1.extend((chunk - batch["action"]).abs().mean(dim=(1, 2)).tolist())
            if self.config.backbone == "spatial_softmax" and self.config.keyframe_weight > 0:
                error = (self.policy.predict_keyframes(observation) - batch["keyframe"]).abs()
                error = error * self.stats["action"]["std"].to(error.device)
                keyframe.append(error[..., :JOINTS_N].mean(-1)[batch["keyframe_is_valid"]])
        for parameter, value in zip(self.parameters, current, strict=True):
            parameter.copy_(value)
        self.policy.train()
        errors = torch.cat(keyframe) if keyframe else torch.zeros(0)
        return float(np.mean(l1)), float(errors.mean()) if errors.numel() else None

    @torch.no_grad()
    def use_averaged_weights(self) -> None:
        """Put the moving average into the policy, where it is kept."""
        if self.config.ema_decay > 0:
            for parameter, value in zip(self.parameters, self.average, strict=True):
                parameter.copy_(value)

    def save(self, resume_dir: Path | None, fingerprint: str) -> None:
        """Write the progress so far, atomically."""
        if resume_dir is None:
            return
        state = self.state
        save_progress(
            resume_dir,
            {
                "fingerprint": fingerprint,
                "step": state.step,
                "spent_s": state.spent_s,
                "first_l1": state.first_l1,
                "recent": self._recent,
                "curve": [asdict(row) for row in state.curve],
                "weights": self.policy.state_dict(),
                "average": self.average,
                "optimiser": self.optimiser.state_dict(),
            },
        )

    def resume(self, resume_dir: Path | None, fingerprint: str) -> int:
        """Load saved progress of the same training, if there is any; return the step to go on from."""
        saved = None if resume_dir is None else load_progress(resume_dir, self.config.device)
        if saved is None or saved["fingerprint"] != fingerprint:
            return 0
        self.policy.load_state_dict(saved["weights"])
        self.optimiser.load_state_dict(saved["optimiser"])
        self.average = saved["average"]
        self._recent = [tuple(row) for row in saved["recent"]]
        self.state = _State(
            saved["step"], saved["spent_s"], saved["first_l1"], [LossRow(**row) for row in saved["curve"]]
        )
        return self.state.step

    def result(
        self, training: list[int], validation: list[int], resumed: int, stopped_by: str, bf16: bool
    ) -> TrainResult:
        """Sum the run up. The final loss is the mean L1 of the last twentieth of the curve."""
        state, curve = self.state, self.state.curve
        if not curve:
            raise DataError("training ended without a single step")
        tail = curve[-max(1, len(curve) // 20) :]
        initial = float(np.mean(state.first_l1))
        final = float(np.mean([row.l1 for row in tail]))
        validated = [row for row in curve if row.validation_l1 is not None]
        return TrainResult(
            steps=state.step,
            steps_asked=self.config.steps,
            train_s=state.spent_s,
            samples_per_s=state.step * self.config.batch_size / max(state.spent_s, 1e-9),
            parameters=parameters_n(self.policy),
            loss_initial=initial,
            loss_final=final,
            loss_ratio=final / initial,
            validation_l1=validated[-1].validation_l1 if validated else None,
            validation_keyframe_rad=validated[-1].validation_keyframe_rad if validated else None,
            training_episodes=training,
            validation_episodes=validation,
            ticks=self.rows_n,
            bf16=bf16,
            resumed_from_step=resumed,
            stopped_by=stopped_by,
            curve=curve,
        )
