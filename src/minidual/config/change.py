"""A configuration with some values replaced, validated like one that was read from a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from minidual.config.root import Config
from minidual.errors import unknown_name


def changed(config: Config, settings: Mapping[str, Any]) -> Config:
    """Return the configuration with values at dotted paths replaced, e.g. {"carry.sensing.delay_s": 0.02}.

    Raises:
        UsageError: There is no such path.
        pydantic.ValidationError: A value out of its bounds.
    """
    document = config.model_dump()
    for path, value in settings.items():
        *sections, name = path.split(".")
        section = document
        for step in sections:
            if not isinstance(section.get(step), dict):
                raise unknown_name(
                    "configuration section", step, [k for k, v in section.items() if isinstance(v, dict)]
                )
            section = section[step]
        if name not in section:
            raise unknown_name("configuration value", path, section)
        section[name] = value
    return Config.model_validate(document)
