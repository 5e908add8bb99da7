"""Settings of the configuration, as a mapping of dotted paths."""

from collections.abc import Mapping
from typing import Any

from minidual.config.loader import Override, load_config
from minidual.config.root import Config

type Settings = Mapping[str, Any]
"""{dotted path: value}, such as {"carry.impedance.internal_force_n": 30.0}; like `--set`."""


def configured(task: str, settings: Settings | None = None) -> Config:
    """Return the configuration of the profile `standard` with a task and settings.

    Raises:
        ConfigError: An unknown path, or a value out of bounds.
    """
    values: Settings = {"task": task, **(settings or {})}
    overrides = [
        Override(path, _plain(value), f"settings: {path}={value}") for path, value in values.items()
    ]
    return load_config(overrides=overrides).config


def _plain(value: Any) -> Any:
    """Return a value as YAML would give it: lists for tuples."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value
