"""The deterministic training loop.

Steps draw from the stream (seed, step), so resuming gives the same weights.
"""

import copy
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from minidual import emergency
from minidual.config.learning import TrainConfig
from minidual.config.seeds import stream
from minidual.errors import DataError, UsageError
from minidual.policies.batches import BatchMaker, BatchStream, Stats, dataset_statistics
from minidual.policies.demonstrations import Split, split_episodes
from minidual.policies.kinds import Advance, LossRow, Training, TrainResult
from minidual.policies.lerobot_policy import Trained, threads
from minidual.policies.optimiser import Optimiser, learning_rate
from minidual.policies.progress import ProgressFile, TrainState, training_fingerprint
from minidual.policies.shares import Shares
from minidual.policies.validation import Validation, ValidationErrors

_WARM_STEPS = 2
_TIMED_STEPS = 10
"""Steps that tell how many fit into `train.budget_s`."""


def train(
    build: Callable[[Stats], Trained],
    job: Training,
    *,
    draws_in_forward: bool = False,
) -> tuple[TrainResult, Trained]:
    """Train the policy built from statistics; see `PolicyKind.train`.

    `draws_in_forward`: the policy draws random numbers which no `with_draws` draws for it.
    """
    demos = job.demos
    config = job.config
    split = split_episodes(
        demos.episode_bounds(),
        config.validation_fraction,
        stream(job.seed, "train.split"),
    )
    stats = dataset_statistics(demos, demos.rows_of(split.training), config.std_floor)
    shared = splits(config) and not draws_in_forward
    shares_n = min(config.threads, config.batch_size) if shared else 1
    torch_threads = 1 if shared else config.threads
    with torch.random.fork_rng(devices=_cuda_devices(config)), threads(torch_threads):
        torch.manual_seed(int(stream(job.seed, "train.weights", 0).integers(2**63)))
        trained = build(stats)
        fingerprint = training_fingerprint(demos, config, job.seed, trained.policy)
        progress = ProgressFile(job.progress, fingerprint)
        record = progress.read(config.device)
        if config.budget_s is not None:
            if record is None:
                steps = _fitting_steps(job, trained.policy, split, stats, shares_n)
            else:
                steps = record["steps"]
            job = job._replace(config=config.model_copy(update={"steps": steps}))
        loop = _Loop(job, trained.policy, split, stats, progress, shares_n)
        if record is not None:
            loop.resume(record)
        try:
            loop.run(job.advance)
        except KeyboardInterrupt as stop:
            loop.save()
            if loop.progress.set_aside is not None:  # no result will tell
                reason = str(stop) or "interrupted"
                place = loop.progress.set_aside
                stop.args = (f"{reason}; an earlier training's progress is in {place}",)
            raise
        finally:
            loop.close()
    return loop.result(), trained._replace(policy=loop.optimiser.averaged)


def splits(config: TrainConfig) -> bool:
    """Return whether each thread computes a share of the batch.

    Dropout and the VAE draw random numbers in `forward`, which threads would draw in any order.
    """
    return config.device == "cpu" and not config.use_vae and config.dropout == 0.0


def _cuda_devices(config: TrainConfig) -> list[int]:
    if config.device == "cuda" and torch.cuda.is_available():
        return [torch.cuda.current_device()]
    return []


def _fitting_steps(
    job: Training,
    policy: Any,
    split: Split,
    stats: Stats,
    shares_n: int,
) -> int:
    """Return how many steps fit into the budget, by timing a few on a copy of the policy."""
    assert job.config.budget_s is not None
    began = time.perf_counter()
    progress = ProgressFile(None, "")
    loop = _Loop(job, copy.deepcopy(policy), split, stats, progress, shares_n)
    try:
        step_s = loop.timed_step_s()
    finally:
        loop.close()
    left_s = job.config.budget_s - (time.perf_counter() - began)
    return max(1, int(left_s / step_s))


class _Loop:
    def __init__(
        self,
        job: Training,
        policy: Any,
        split: Split,
        stats: Stats,
        progress: ProgressFile,
        shares_n: int,
    ) -> None:
        demos = job.demos
        config = job.config
        rows = demos.rows_of(split.training)
        self._config = config
        self._policy = policy
        self._split = split
        self._ticks = len(rows)
        self._shares = Shares(policy, shares_n)
        maker = BatchMaker(demos, config, stats)
        self._batches = BatchStream(maker, demos, rows, config, job.seed)
        validation_rows = demos.rows_of(split.validation)
        self._validation = Validation(maker, validation_rows, stats, demos.joints)
        self.optimiser = Optimiser(policy, config)
        self.progress = progress
        self._state = TrainState()
        self._consistent = True
        """Whether weights, moving average, optimiser and state are those of one step."""
        self._resumed_from_step = 0
        self._stopped_by = "steps"

    def resume(self, record: dict[str, Any]) -> None:
        """Load the progress of this training."""
        self._policy.load_state_dict(record["weights"])
        self.optimiser.load_state_dict(record["optimiser"])
        self.optimiser.averaged.load_state_dict(record["averaged"])
        self._state = TrainState.from_record(record["state"])
        self._resumed_from_step = self._state.step

    def save(self) -> None:
        """Write the progress.

        Within a step nothing is written: the progress written before stays.
        """
        if not self._consistent:
            return
        self.progress.write(
            {
                "steps": self._config.steps,
                "state": self._state.record(),
                "weights": self._policy.state_dict(),
                "averaged": self.optimiser.averaged.state_dict(),
                "optimiser": self.optimiser.state_dict(),
            },
        )

    def close(self) -> None:
        """End the threads."""
        self._shares.close()
        self._batches.close()

    def run(self, advance: Advance) -> None:
        """Train until the last step or the time limit."""
        config = self._config
        state = self._state
        self._policy.train()
        if state.step:
            self._log_if_due()  # interrupted before it was
            advance(state.step, state.last_loss)
        last = time.perf_counter()
        while state.step < config.steps:
            emergency.check()
            loss = self._step(state.step)
            state.step += 1
            self._consistent = True
            self._log_if_due()
            now = time.perf_counter()
            state.spent_s += now - last
            last = now
            is_last = state.step == config.steps
            if is_last or state.step % config.checkpoint_every_steps == 0:
                self.save()  # the last one too: the next seed may be interrupted
            advance(1, loss)
            if state.spent_s > config.time_limit_s and not is_last:
                self._log()
                self._stopped_by = "time limit"
                return

    def timed_step_s(self) -> float:
        """Return the time of a step, with its share of validations; the weights change."""
        self._policy.train()
        for step in range(_WARM_STEPS):
            self._step(step)
        began = time.perf_counter()
        for step in range(_WARM_STEPS, _WARM_STEPS + _TIMED_STEPS):
            self._step(step)
        stepped = time.perf_counter()
        self._validate()
        validation_s = time.perf_counter() - stepped
        step_s = (stepped - began) / _TIMED_STEPS
        return step_s + validation_s / self._config.validate_every_steps

    def _step(self, step: int) -> float:
        """Update the weights once; return the loss."""
        drawn = self._batches.take(step)
        torch.manual_seed(drawn.seed)
        rate = self.optimiser.set_rate(step)
        batch_loss = self._shares.gradient(drawn.tensors)
        if not math.isfinite(batch_loss.loss):
            raise self._diverged(batch_loss.loss, step, rate)
        self.optimiser.clip()
        self._consistent = False
        self.optimiser.update(step)
        self._state.add(batch_loss)
        return batch_loss.loss

    def _diverged(self, loss: float, step: int, rate: float) -> UsageError:
        config = self._config
        lower = (
            f"--set train.learning_rate={config.learning_rate / 3:.1g} "
            f"--set train.backbone_learning_rate={config.backbone_learning_rate / 3:.1g}"
        )
        return UsageError(
            f"the training loss became {loss} at step {step} "
            f"(learning rate {rate:.2g}, gradient clip {config.gradient_clip:g})",
            remedy=f"lower both rates, for example {lower}",
        )

    def _log_if_due(self) -> None:
        step = self._state.step
        if step % self._config.log_every_steps == 0 or step == self._config.steps:
            self._log()

    def _log(self) -> None:
        """Add a row to the loss curve."""
        state = self._state
        if state.curve and state.logged_step == state.step:
            state.recent.clear()  # an interruption came before it
            return
        errors = self._validate() if self._validation_is_due() else ValidationErrors()
        mean = state.recent_mean()
        row = LossRow(
            step=state.step,
            loss=mean.total,
            l1=mean.l1,
            keyframe=mean.keyframe,
            learning_rate=learning_rate(self._config, state.step - 1),
            validation_l1=errors.l1,
            validation_keyframe_rad=errors.keyframe_rad,
        )
        state.curve.append(row)
        state.recent.clear()

    def _validation_is_due(self) -> bool:
        state = self._state
        every = self._config.validate_every_steps
        if state.step == self._config.steps:
            return True
        return state.step // every > state.logged_step // every

    def _validate(self) -> ValidationErrors:
        """Return the errors of the averaged weights."""
        errors = self._validation.measure(self.optimiser.averaged)
        self._policy.train()
        return errors

    def result(self) -> TrainResult:
        """Summarise; the final loss averages the last twentieth."""
        state = self._state
        curve = state.curve
        if not curve:
            raise DataError("training ended without a single step")
        last_rows = curve[-max(1, len(curve) // 20) :]
        initial = float(np.mean(state.first_l1))
        final = float(np.mean([row.l1 for row in last_rows]))
        validated = [row for row in curve if row.validation_l1 is not None]
        last_validated = validated[-1] if validated else None
        samples_n = state.step * self._config.batch_size
        return TrainResult(
            steps=state.step,
            steps_asked=self._config.steps,
            train_s=state.spent_s,
            samples_per_s=samples_n / max(state.spent_s, 1e-9),
            parameters=self.optimiser.parameters_n,
            loss_initial=initial,
            loss_final=final,
            loss_ratio=final / initial,
            training_episodes=self._split.training,
            validation_episodes=self._split.validation,
            ticks=self._ticks,
            validation_l1=last_validated.validation_l1 if last_validated else None,
            validation_keyframe_rad=(
                last_validated.validation_keyframe_rad if last_validated else None
            ),
            bf16=any(getattr(module, "bf16", False) for module in self._policy.modules()),
            resumed_from_step=self._resumed_from_step,
            set_aside=self.progress.set_aside,
            stopped_by=self._stopped_by,
            curve=curve,
        )
