"""Settings of the methods that have some: `methods.NAME...`, those of other distributions too."""

from __future__ import annotations

from typing import Literal, cast

from pydantic import ConfigDict, Field, JsonValue

from minidual.config.base import Rate, StrictModel
from minidual.errors import UsageError, check_name
from minidual.registry import Registry


class RlConfig(StrictModel):
    """Training by reinforcement: PPO, seeded with scripted demonstrations.

    Source of the algorithm: Schulman et al. 2017, arXiv 1707.06347.
    """

    # Experience
    steps: int = Field(default=150_000, ge=1, le=1_000_000_000)
    """Actions of all worlds together."""
    worlds_n: int = Field(default=64, ge=1, le=4096)
    """Simulations that run side by side in the process."""
    rollout: int = Field(default=64, ge=2, le=4096)
    """Actions of each world between two updates."""
    randomise: Rate = 0.5
    """Share of the episodes with drawn masses, frictions and sensor offsets."""

    episodes_of_start: int = Field(default=4, ge=1, le=1000)
    """Tries from one start, where a planner prepares each start."""
    senses_force: bool = True
    """Whether the policy reads forces at the hands, where the lesson lets one leave them out."""

    # Demonstrations
    demonstrations_n: int = Field(default=150, ge=0, le=100_000)
    """Scripted demonstrations that the policy copies first; 0: from scratch."""
    clone_steps: int = Field(default=3000, ge=0, le=1_000_000)
    """Steps of behaviour cloning before the first update."""
    clone_weight: float = Field(default=0.5, ge=0.0, le=100.0)
    """Weight of the cloning loss beside PPO's, at first."""
    clone_until: Rate = 0.5
    """Share of the training in which that weight falls to zero."""
    value_warmup: int = Field(default=4, ge=0, le=10_000)
    """Updates of the value alone, before the cloned policy may change."""
    value_epochs: int = Field(default=20, ge=1, le=1000)
    """Epochs of each of them."""

    # PPO
    learning_rate: float = Field(default=3e-4, gt=0.0, le=1.0)
    """Of the policy."""
    value_rate: float = Field(default=1e-3, gt=0.0, le=1.0)
    """Learning rate of the value."""
    discount: float = Field(default=0.985, gt=0.0, le=1.0)
    gae_lambda: float = Field(default=0.95, gt=0.0, le=1.0)
    epochs: int = Field(default=6, ge=1, le=100)
    batch_size: int = Field(default=1024, ge=2, le=1_000_000)
    clip: float = Field(default=0.2, gt=0.0, le=1.0)
    entropy: float = Field(default=0.001, ge=0.0, le=1.0)
    kl_max: float = Field(default=0.03, gt=0.0, le=10.0)
    """An update ends early beyond this change of the policy."""
    hidden: int = Field(default=256, ge=8, le=4096)
    """Width of the two layers of policy and value."""
    deviation: float = Field(default=0.1, gt=0.0, le=2.0)
    """Standard deviation of the actions at first; an action is between -1 and 1."""

    # Bookkeeping
    validation_starts: int = Field(default=64, ge=0, le=10_000)
    """Starts of their own on which the policy is tested as it trains; 0: none."""
    validate_every_updates: int = Field(default=5, ge=1, le=1_000_000)
    threads: int = Field(default=1, ge=1, le=256)
    """Torch threads on the CPU."""
    device: Literal["cpu", "cuda"] = "cpu"


class MethodsConfig(StrictModel):
    """Settings by method.

    Methods of other distributions have a section as well: the loader checks it with the model that
    their row names (docs/howto-method.md).
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, dict[str, JsonValue]] = Field(init=False)  # type: ignore[assignment]

    rl: RlConfig = RlConfig()

    def of[M: StrictModel](self, name: str, model: type[M]) -> M:
        """Return the settings of a method.

        Args:
            name: Row of the methods.
            model: Its settings model.

        Raises:
            pydantic.ValidationError: A value is wrong; the loader has checked what it loaded.
        """
        if name in type(self).model_fields:
            return cast(M, getattr(self, name))
        return model.model_validate((self.__pydantic_extra__ or {}).get(name, {}))

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the sections that belong to other distributions."""
        return tuple(self.__pydantic_extra__ or {})


_ROWS: Registry[object] = Registry("method", group="minidual.methods")
"""Methods of other distributions. Their rows are loaded only where a section names them."""


def settings_model(name: str) -> type[StrictModel]:
    """Return the settings model of a method of another distribution.

    Raises:
        UsageError: There is no such method, or it has no settings.
    """
    check_name("method with settings of its own", name, {*MethodsConfig.model_fields, *_ROWS})
    model = getattr(_ROWS[name], "config", None)
    if isinstance(model, type) and issubclass(model, StrictModel):
        return model
    raise UsageError(
        f"the method '{name}' has no settings of its own",
        remedy=f"leave methods.{name} out, or name its model in the row: config=...",
    )
