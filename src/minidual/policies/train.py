"""The deterministic training loop.

Steps draw from the stream (seed, step), so resuming gives the same weights.
"""

import copy
import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.optim.swa_utils import get_ema_multi_avg_fn

from minidual import durable, emergency
from minidual.config.learning import TrainConfig
from minidual.config.seeds import stream
from minidual.demos.lerobot_reader import Rows
from minidual.errors import DataError, UsageError
from minidual.policies.batches import BatchMaker, Shares, Stats, dataset_statistics
from minidual.policies.demonstrations import Demonstrations, split_episodes
from minidual.policies.kinds import Advance, LossRow, Training, TrainResult

VALIDATION_ROWS = 512
DIGEST_BYTES = 32
"""Of the SHA-256 with which a progress file begins."""


class Trained(NamedTuple):
    """A LeRobot policy with processors."""

    policy: Any
    preprocessor: Any
    postprocessor: Any


@dataclass
class _State:
    step: int = 0
    spent_s: float = 0.0
    first_l1: list[float] = field(default_factory=list)
    recent: list[tuple[float, float, float | None]] = field(default_factory=list)
    curve: list[LossRow] = field(default_factory=list)


def train(build: Callable[[Stats], Trained], job: Training) -> tuple[TrainResult, Trained]:
    """Train the policy built from statistics; see `PolicyKind.train`."""
    demos = job.demos
    config = job.config
    seed = job.seed
    rng = stream(seed, "train.split")
    training, validation = split_episodes(demos.episode_bounds(), config.validation_fraction, rng)
    rows = demos.rows_of(training)
    stats = dataset_statistics(demos, rows, config.std_floor)
    devices = (
        [torch.cuda.current_device()]
        if config.device == "cuda" and torch.cuda.is_available()
        else []
    )
    with torch.random.fork_rng(devices=devices), threads(1 if splits(config) else config.threads):
        torch.manual_seed(int(stream(seed, "train.weights", 0).integers(2**63)))
        trained = build(stats)
        loop = _Loop(job, trained.policy, rows, demos.rows_of(validation), stats)
        resumed = loop.resume()
        try:
            stopped_by = loop.run(job.advance)
        except KeyboardInterrupt as stop:
            loop.save()
            if loop.set_aside is not None:  # no result will tell
                stop.args = (
                    f"{str(stop) or 'interrupted'}; an earlier training's progress is in {loop.set_aside}",
                )
            raise
        finally:
            loop.shares.close()
            loop.beside.shutdown(cancel_futures=True)
    return loop.result(training, validation, resumed, stopped_by), trained._replace(
        policy=loop.averaged,
    )


def splits(config: TrainConfig) -> bool:
    """Return whether each thread computes a share of the batch; no policy that draws random numbers can."""
    return config.device == "cpu" and not config.use_vae and config.dropout == 0.0


@contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Set torch's threads temporarily; None leaves them."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Loop:
    def __init__(
        self,
        job: Training,
        policy: Any,
        rows: Rows,
        validation_rows: Rows,
        stats: Stats,
    ) -> None:
        demos = job.demos
        config = job.config
        seed = job.seed
        self.config = config
        self.seed = seed
        self.policy = policy
        self.stats = stats
        self.joints_n = demos.joints_n
        self.ticks = len(rows)
        self.shares = Shares(
            policy,
            min(config.threads, config.batch_size) if splits(config) else 1,
        )
        self.beside = ThreadPoolExecutor(1)
        self.ahead: Future[tuple[int, dict[str, torch.Tensor]]] | None = None
        self.batches = BatchMaker(demos, config, stats)
        self.rows = rows
        weights = np.where(demos.phase[rows] == 0, config.approach_weight, 1.0)
        self.shares_of_rows = weights / weights.sum()
        count = min(VALIDATION_ROWS, len(validation_rows))
        self.validation_rows = validation_rows[
            np.linspace(0, len(validation_rows) - 1, count).astype(np.int64)
        ]
        self.parameters = [p for p in policy.parameters() if p.requires_grad]
        rate = config.learning_rate
        decay = config.weight_decay
        self.optimiser = torch.optim.AdamW(
            policy.get_optim_params(),
            lr=rate,
            weight_decay=decay,
            fused=True,
        )
        self.rates = [group["lr"] / rate for group in self.optimiser.param_groups]
        self.averaged = copy.deepcopy(policy) if config.ema_decay > 0 else policy
        self.average = [p for p in self.averaged.parameters() if p.requires_grad]
        # consistent: weights, moving average, optimiser and state are those of one step
        self.state = _State()
        self.consistent = True
        self.progress = job.progress
        self.fingerprint = training_fingerprint(demos, config, seed, policy)
        self.set_aside = None

    def learning_rate(self, step: int) -> float:
        """Linear warm-up, then cosine decay to one hundredth."""
        config = self.config
        warmup = max(1, round(config.warmup_fraction * config.steps))
        if step < warmup:
            return config.learning_rate * (step + 1) / warmup
        done = (step - warmup) / max(1, config.steps - warmup)
        return config.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * done)))

    def run(self, advance: Advance) -> str:
        """Train; return "steps" or "time limit"."""
        config = self.config
        state = self.state
        self.policy.train()
        if state.step:
            self._log_if_due()  # interrupted before it was
            advance(state.step, state.recent[-1][0] if state.recent else state.curve[-1].loss)
        last = time.perf_counter()
        while state.step < config.steps:
            emergency.check()
            loss = self._step(state.step)
            state.step += 1
            self.consistent = True
            self._log_if_due()
            now = time.perf_counter()
            state.spent_s = state.spent_s + now - last
            last = now
            if state.step % config.checkpoint_every_steps == 0 or state.step == config.steps:
                self.save()  # the last one too: the next seed may be interrupted
            advance(1, loss)
            if state.spent_s > config.time_limit_s and state.step < config.steps:
                self._log()
                return "time limit"
        return "steps"

    def _step(self, step: int) -> float:
        seed, batch = self.ahead.result() if self.ahead is not None else self._batch(step)
        # cut while the gradient is computed: a sixth of a step
        self.ahead = (
            self.beside.submit(self._batch, step + 1) if step + 1 < self.config.steps else None
        )
        torch.manual_seed(seed)
        rate = self.learning_rate(step)
        for group, share in zip(self.optimiser.param_groups, self.rates, strict=True):
            group["lr"] = share * rate
        value, parts = self.shares.gradient(batch)
        if not math.isfinite(value):
            at = f"at step {step} (learning rate {rate:.2g}, gradient clip {self.config.gradient_clip:g})"
            names = "learning_rate", "backbone_learning_rate"
            lower = " ".join(
                f"--set train.{name}={getattr(self.config, name) / 3:.1g}" for name in names
            )
            raise UsageError(
                f"the training loss became {value} {at}",
                remedy=f"lower both rates, for example {lower}",
            )
        torch.nn.utils.clip_grad_norm_(self.parameters, self.config.gradient_clip)
        self.consistent = False
        self.optimiser.step()
        if self.config.ema_decay > 0:
            # Short memory at first, so that the random initial weights leave the average.
            decay = min(self.config.ema_decay, (1 + step) / (10 + step))
            get_ema_multi_avg_fn(decay)(self.average, self.parameters, 0)
        self.state.recent.append((value, parts["l1_loss"], parts.get("keyframe_loss")))
        if len(self.state.first_l1) < 5:
            self.state.first_l1.append(parts["l1_loss"])
        return value

    def _batch(self, step: int) -> tuple[int, dict[str, torch.Tensor]]:
        rng = stream(self.seed, "train.batch", step)
        seed = int(rng.integers(2**63))
        rows = rng.choice(self.rows, self.config.batch_size, p=self.shares_of_rows)
        return seed, self.batches.training(rows, rng)

    def _log_if_due(self) -> None:
        if (
            self.state.step % self.config.log_every_steps == 0
            or self.state.step == self.config.steps
        ):
            self._log()

    def _log(self) -> None:
        state = self.state
        config = self.config
        if state.curve and state.curve[-1].step == state.step:
            state.recent.clear()  # an interruption may have come before it
            return
        keyframes = [k for _, _, k in state.recent if k is not None]
        logged = state.curve[-1].step if state.curve else 0
        due = state.step // config.validate_every_steps > logged // config.validate_every_steps
        validation = self._validate() if due or state.step == config.steps else (None, None)
        loss = float(np.mean([r[0] for r in state.recent]))
        l1 = float(np.mean([r[1] for r in state.recent]))
        keyframe = float(np.mean(keyframes)) if keyframes else None
        state.curve.append(
            LossRow(
                state.step, loss, l1, keyframe, self.learning_rate(state.step - 1), *validation
            ),
        )
        state.recent.clear()

    @torch.no_grad()
    def _validate(self) -> tuple[float | None, float | None]:
        """Return held-out L1 [std] and keyframe error [rad] of the averaged weights."""
        if not len(self.validation_rows):
            return None, None
        l1: list[float] = []
        keyframe: list[torch.Tensor] = []
        for start in range(0, len(self.validation_rows), 64):
            batch = self.batches.clean(self.validation_rows[start : start + 64])
            observation = {k: v for k, v in batch.items() if k.startswith("observation.")}
            self.averaged.reset()
            chunk = self.averaged.predict_action_chunk(observation)
            l1.extend((chunk - batch["action"]).abs().mean(dim=(1, 2)).tolist())
            if getattr(self.averaged.config, "keyframes", 0):
                error = (self.averaged.model(observation)[2] - batch["keyframe"]).abs()
                error = error * self.stats["action"]["std"].to(error.device)
                keyframe.append(error[..., : self.joints_n].mean(-1)[batch["keyframe_is_valid"]])
        self.policy.train()
        errors = torch.cat(keyframe) if keyframe else torch.zeros(0)
        return float(np.mean(l1)), float(errors.mean()) if errors.numel() else None

    def save(self) -> None:
        """Write the progress, unless it is cut within a step: then the last written one stands."""
        if self.progress is None or not self.consistent:
            return
        record = {
            "fingerprint": self.fingerprint,
            "state": asdict(self.state),
            "weights": self.policy.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        content = io.BytesIO()
        torch.save(record, content)
        with durable.replacing(self.progress) as partial:
            partial.write_bytes(hashlib.sha256(content.getbuffer()).digest() + content.getbuffer())

    def resume(self) -> int:
        """Load matching progress and return its step; move any other to `set-aside` beside it."""
        if self.progress is None or not self.progress.exists():
            return 0
        content = self.progress.read_bytes() if self.progress.is_file() else b""
        # The checksum comes first: a damaged file would fail anywhere below, or later in training.
        digest = content[:DIGEST_BYTES]
        rest = content[DIGEST_BYTES:]
        intact = hashlib.sha256(rest).digest() == digest
        saved = (
            torch.load(io.BytesIO(rest), map_location=self.config.device, weights_only=True)
            if intact
            else {}
        )
        if saved.get("fingerprint") != self.fingerprint:
            self.set_aside = durable.set_aside(
                self.progress,
                f"train-act.{'other' if intact else 'damaged'}-progress",
            )
            return 0
        self.policy.load_state_dict(saved["weights"])
        self.optimiser.load_state_dict(saved["optimiser"])
        self.averaged.load_state_dict(saved["averaged"])
        self.state = _State(**saved["state"])
        self.state.curve = [LossRow(**row) for row in saved["state"]["curve"]]
        return self.state.step

    def result(
        self,
        training: list[int],
        validation: list[int],
        resumed: int,
        stopped_by: str,
    ) -> TrainResult:
        """Summarise; the final loss averages the last twentieth."""
        state = self.state
        curve = self.state.curve
        if not curve:
            raise DataError("training ended without a single step")
        initial = float(np.mean(state.first_l1))
        final = float(np.mean([row.l1 for row in curve[-max(1, len(curve) // 20) :]]))
        validated = [row for row in curve if row.validation_l1 is not None]
        about: Any = {
            "training_episodes": training,
            "validation_episodes": validation,
            "ticks": self.ticks,
        }
        about |= {
            "resumed_from_step": resumed,
            "set_aside": self.set_aside,
            "stopped_by": stopped_by,
            "curve": curve,
        }
        return TrainResult(
            **about,
            steps=state.step,
            steps_asked=self.config.steps,
            train_s=state.spent_s,
            samples_per_s=state.step * self.config.batch_size / max(state.spent_s, 1e-9),
            parameters=sum(p.numel() for p in self.parameters),
            loss_initial=initial,
            loss_final=final,
            loss_ratio=final / initial,
            validation_l1=validated[-1].validation_l1 if validated else None,
            validation_keyframe_rad=validated[-1].validation_keyframe_rad if validated else None,
            bf16=any(getattr(module, "bf16", False) for module in self.policy.modules()),
        )


def training_fingerprint(demos: Demonstrations, config: TrainConfig, seed: int, policy: Any) -> str:
    """Return a hash of what determines the weights (images sampled)."""
    digest = hashlib.sha256()
    free = {
        "seeds_n",
        "log_every_steps",
        "validate_every_steps",
        "checkpoint_every_steps",
        "time_limit_s",
    }
    settings = config.model_dump(exclude=free | {"loss_ratio_max", "actions_in_limits_min"})
    layout = [(name, list(values.shape)) for name, values in policy.state_dict().items()]
    digest.update(json.dumps([seed, settings, layout, torch.__version__], sort_keys=True).encode())
    for array in (demos.state, demos.action, demos.episode_index):
        digest.update(array.tobytes())
    for camera in demos.cameras:
        digest.update(camera.encode())
        digest.update(demos.images[camera][:: max(1, len(demos) // 256)].tobytes())
    return digest.hexdigest()
