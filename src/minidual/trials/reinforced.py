"""The method `rl`: its trainer, and its trials. A lesson holds what differs by task."""

from minidual.config.root import Config, preset
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.policies.rl.lesson import LESSONS
from minidual.policies.rl.network import RlNetwork
from minidual.trials.methods import Factory, MethodInputs
from minidual.trials.trainer import TrainingJob, TrainingSummary

_CURVE = {
    "validation_success_rate": "success on validation starts",
    "success_rate": "success while trying",
}


class RlTrainer:
    """Trains policies by reinforcement."""

    def check(self, config: Config) -> None:
        """Raise UsageError or EnvironmentMissingError for a task that cannot be trained."""
        LESSONS[config.task]
        try:
            import stable_baselines3  # noqa: F401
        except ImportError as error:
            raise EnvironmentMissingError(
                "a training by reinforcement needs the library Stable-Baselines3",
                remedy="pip install 'minidual[rl]'",
            ) from error
        import torch

        if config.methods.rl.device == "cuda" and not torch.cuda.is_available():
            raise EnvironmentMissingError(
                "methods.rl.device is cuda, and PyTorch finds no CUDA device",
                remedy="--set methods.rl.device=cpu",
            )

    def steps(self, config: Config) -> int:
        """Return the actions of a training."""
        return suited(config).methods.rl.steps

    def train(self, job: TrainingJob) -> TrainingSummary:
        """Train, and write the checkpoint."""
        from minidual.policies.rl.training import RlJob, train_rl

        lesson = LESSONS[job.config.task]
        rl_job = RlJob(suited(job.config), lesson, job.seed, job.progress, job.advance)
        result = train_rl(rl_job)
        result.network.write(job.folder / "checkpoint")
        numbers = {
            "steps": result.steps,
            "processor_s": round(result.processor_s, 1),
            "demonstrated_actions": result.demonstrations_n,
            "parameters": result.network.parameters_n,
            "validation_success_rate": result.validation_rate,
        }
        return TrainingSummary(result.steps, result.resumed_from, numbers, result.curve, _CURVE)


def suited(config: Config) -> Config:
    """Return the configuration with the values of `methods.rl` that the task's lesson prefers."""
    preferred = getattr(LESSONS[config.task], "settings", {})
    return preset(config, {f"methods.rl.{name}": value for name, value in preferred.items()})


def driven(inputs: MethodInputs) -> Factory:
    """Run the policy of the checkpoint.

    Raises:
        UsageError: There is no checkpoint, or it is that of another task.
        DataError: The checkpoint is damaged.
    """
    task = inputs.config.task
    if inputs.checkpoint is None:
        raise UsageError(
            f"rl needs a policy for the task '{task}'",
            remedy=f"minidual train rl --task {task}",
        )
    network = RlNetwork.read(inputs.checkpoint)
    trained = network.description.task
    if trained != task:
        raise UsageError(
            f"the policy in {inputs.checkpoint} is trained on '{trained}', not on '{task}'",
        )
    return LESSONS[task].driver(inputs, network)
