"""One training by reinforcement: demonstrations, cloning, PPO, validation, progress."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.callbacks import BaseCallback

from minidual import durable, emergency
from minidual.config.methods import RlConfig
from minidual.config.root import Config
from minidual.config.seeds import stream, subseed
from minidual.errors import DataError
from minidual.policies.progress import ProgressFile
from minidual.policies.rl.cloned_ppo import ClonedPpo, make_ppo, normalisation_of
from minidual.policies.rl.lesson import Demonstrated, Lesson, WorldsWanted
from minidual.policies.rl.network import Description, Normalisation, RlNetwork
from minidual.policies.rl.vector_env import SteppedWorlds
from minidual.workers import processor_time_s

TRAINING = "rl-training"
"""Random stream of the starts that the policy tries."""
VALIDATION = "rl-validation"
"""Random stream of the starts that choose the best policy; no test uses it."""
_PROGRESS_EVERY = 4
"""Updates between two writings of the progress."""
_NEVER = 10**9
"""Updates between two tables that Stable-Baselines3 would print."""
_LOOK_STEPS = 64
"""Random actions of each world that tell how observations vary, where nothing is demonstrated."""

type Advance = Callable[[int, str], None]


class RlJob(NamedTuple):
    """Inputs of a training.

    Attributes:
        config: With the task.
        lesson: Of the task.
        seed: Of this training.
        progress: File that survives an interruption.
        advance: Gets actions since the last call, and a note.
    """

    config: Config
    lesson: Lesson
    seed: int
    progress: Path
    advance: Advance

    @property
    def settings(self) -> RlConfig:
        """Settings of the method."""
        return self.config.methods.rl


class RlTrained(NamedTuple):
    """Result of a training.

    Attributes:
        network: The best on the validation starts, or the last one without any.
        steps: Actions that were tried.
        curve: A row for each validation.
        resumed_from: Step from which an interrupted training went on, or 0.
        demonstrations_n: Recorded actions that it began from.
        validation_rate: Success of `network` on the validation starts, or NaN.
        processor_s: Processor time of the training, interrupted parts included.
    """

    network: RlNetwork
    steps: int
    curve: list[dict[str, float]]
    resumed_from: int
    demonstrations_n: int
    validation_rate: float
    processor_s: float


def train_rl(job: RlJob) -> RlTrained:
    """Train a policy.

    On one machine, equal jobs that are not interrupted give equal networks.

    Raises:
        DataError: The training diverged.
    """
    settings = job.settings
    torch.set_num_threads(settings.threads)
    wanted = WorldsWanted(settings.worlds_n, job.seed, TRAINING, settings.randomise)
    worlds = SteppedWorlds(job.lesson.worlds(job.config, wanted))
    try:
        return Training(job, worlds).run()
    finally:
        worlds.close()


class Training:
    """The parts of one training."""

    def __init__(self, job: RlJob, worlds: SteppedWorlds) -> None:
        self._began_s = processor_time_s()
        self.job = job
        self.worlds = worlds
        self.description: Description = job.lesson.describe(job.config)
        self.demonstrations = _demonstrations(job)
        self.normalisation: Normalisation = normalisation_of(self._typical_observations())
        self.model: ClonedPpo = make_ppo(
            worlds,
            job.settings,
            self.normalisation,
            self.demonstrations,
            subseed(job.seed, "rl/ppo") % 2**31,
        )
        self.file = ProgressFile(job.progress, _fingerprint(job), "train-rl")
        self.curve: list[dict[str, float]] = []
        self.best: RlNetwork | None = None
        self.best_rate = float("nan")
        self.resumed_from = 0
        self.spent_s = 0.0

    def run(self) -> RlTrained:
        """Clone or go on, learn, and return the best policy."""
        steps = self.job.settings.steps
        self._resume()
        if self.resumed_from == 0 and self.demonstrations is not None:
            loss = self.model.clone(self.job.settings.clone_steps)
            self.job.advance(0, f"cloned, loss {loss:.4f}")
            self.validate({})
        if self.model.num_timesteps < steps:
            self.model.learn(
                steps - self.model.num_timesteps,
                callback=_Course(self),
                log_interval=_NEVER,
                reset_num_timesteps=self.resumed_from == 0,
            )
        self.validate({})
        network = self.best
        if network is None:
            network = self.network()
        durable.remove(self.job.progress)
        return RlTrained(
            network,
            self.model.num_timesteps,
            self.curve,
            self.resumed_from,
            0 if self.demonstrations is None else len(self.demonstrations.actions),
            self.best_rate,
            self.processor_s,
        )

    @property
    def processor_s(self) -> float:
        """Processor time of the training, interrupted parts included."""
        return self.spent_s + processor_time_s() - self._began_s

    def network(self) -> RlNetwork:
        """Return the present policy.

        Raises:
            DataError: It holds values that are not finite.
        """
        try:
            return self.model.network(self.description, self.normalisation)
        except DataError as error:
            raise DataError(
                "the training diverged: the policy holds values that are not finite",
                remedy="lower methods.rl.learning_rate",
            ) from error

    def validate(self, measures: dict[str, float]) -> None:
        """Try the present policy on the validation starts, note it, and keep the best."""
        network = self.network()
        rate = validation_rate(self.job, network)
        if self.best is None or not rate < self.best_rate:
            self.best = network
            self.best_rate = rate
        row = {
            "step": float(self.model.num_timesteps),
            "processor_s": round(self.processor_s, 1),
            "validation_success_rate": rate,
            "deviation": float(self.model.policy.log_std.detach().exp().mean()),
        }
        self.curve.append({**row, **measures})

    def write_progress(self) -> None:
        """Write down all that an interrupted training needs to go on."""
        best = self.best
        self.file.write(
            {
                "policy": self.model.policy.state_dict(),
                "optimizer": self.model.policy.optimizer.state_dict(),
                "steps": self.model.num_timesteps,
                "updates": self.model.updates,
                "spent_s": self.processor_s,
                "curve": [dict(row) for row in self.curve],
                "best_rate": self.best_rate,
                "best": None if best is None else _tensors(best),
            },
        )

    def _resume(self) -> None:
        record = self.file.read(self.job.settings.device)
        if record is None:
            return
        self.model.policy.load_state_dict(record["policy"])
        self.model.policy.optimizer.load_state_dict(record["optimizer"])
        self.model.num_timesteps = record["steps"]
        self.model.updates = record["updates"]
        self.spent_s = record["spent_s"]
        self.curve = record["curve"]
        self.best_rate = record["best_rate"]
        if record["best"] is not None:
            self.best = self._network_of(record["best"])
        self.resumed_from = record["steps"]
        self.job.advance(record["steps"], "goes on")

    def _network_of(self, tensors: list[torch.Tensor]) -> RlNetwork:
        network = self.network()
        arrays = [tensor.numpy() for tensor in tensors]
        count = len(network.layers.weights)
        layers = network.layers._replace(
            weights=tuple(arrays[:count]),
            biases=tuple(arrays[count:]),
        )
        return RlNetwork(self.description, self.normalisation, layers)

    def _typical_observations(self) -> Any:
        """Return observations (T, n) by which all are normalised."""
        if self.demonstrations is not None:
            return self.demonstrations.observations
        rng = stream(self.job.seed, "rl/look")
        observations = [self.worlds.reset()]
        shape = (self.worlds.num_envs, *(self.worlds.action_space.shape or ()))
        for _ in range(_LOOK_STEPS):
            actions = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
            observations.append(self.worlds.step(actions)[0])
        return np.concatenate(observations)


class _Course(BaseCallback):
    """Follows a training: progress bar, emergency stop, validation, progress file."""

    def __init__(self, training: Training) -> None:
        super().__init__()
        self._training = training
        self._successes: list[bool] = []
        self._rewards: list[float] = []
        self._rollouts = 0

    def _on_step(self) -> bool:
        emergency.check()
        self._rewards.append(float(np.mean(self.locals["rewards"])))
        for info in self.locals["infos"]:
            if "success" in info:
                self._successes.append(info["success"])
        return True

    def _on_rollout_start(self) -> None:
        """Evaluate the policy after the latest update."""
        training = self._training
        updates = training.model.updates
        if self._rollouts > 0 and updates % training.job.settings.validate_every_updates == 0:
            rate = float(np.mean(self._successes)) if self._successes else float("nan")
            measures = {"success_rate": rate, "reward_mean": float(np.mean(self._rewards))}
            training.validate(measures)
            self._successes = []
            self._rewards = []
        if self._rollouts > 0 and updates % _PROGRESS_EVERY == 0:
            training.write_progress()
        self._rollouts += 1

    def _on_rollout_end(self) -> None:
        job = self._training.job
        actions_n = job.settings.rollout * job.settings.worlds_n
        rate = self._training.best_rate
        job.advance(actions_n, f"validation {100.0 * rate:.0f} %" if rate == rate else "")


def validation_rate(job: RlJob, network: RlNetwork) -> float:
    """Return the success of a policy on the validation starts, or NaN without any."""
    count = job.settings.validation_starts
    if count == 0:
        return float("nan")
    wanted = WorldsWanted(count, job.seed, VALIDATION, job.settings.randomise, once=True)
    worlds = SteppedWorlds(job.lesson.worlds(job.config, wanted))
    try:
        return float(np.mean(first_episodes(worlds, network)))
    finally:
        worlds.close()


def first_episodes(worlds: SteppedWorlds, network: RlNetwork) -> list[bool]:
    """Return whether the first episode of each world succeeds."""
    successes: dict[int, bool] = {}
    observations: Any = worlds.reset()
    while len(successes) < worlds.num_envs:
        emergency.check()
        observations, _, ended, infos = worlds.step(network.act(observations))
        for world in np.flatnonzero(ended):
            successes.setdefault(int(world), infos[world]["success"])
    return [successes[world] for world in sorted(successes)]


def _demonstrations(job: RlJob) -> Demonstrated | None:
    count = job.settings.demonstrations_n
    if count == 0:
        return None
    job.advance(0, f"{count} demonstrations")
    return job.lesson.demonstrations(job.config, count, job.seed)


def _tensors(network: RlNetwork) -> list[torch.Tensor]:
    arrays = (*network.layers.weights, *network.layers.biases)
    return [torch.as_tensor(array) for array in arrays]


def _fingerprint(job: RlJob) -> str:
    """Return a hash of everything that determines the training."""
    settings = job.config.model_dump(mode="json")
    relevant = {key: settings[key] for key in ("task", "scene", "robot", "arbiter", "supervisor")}
    ingredients = [
        job.seed,
        relevant,
        job.settings.model_dump(mode="json"),
        list(job.lesson.describe(job.config)),
        torch.__version__,
        stable_baselines3.__version__,
    ]
    return hashlib.sha256(json.dumps(ingredients, sort_keys=True).encode()).hexdigest()
