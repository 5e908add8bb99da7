"""Validated changes of a configuration."""

from collections.abc import Mapping
from typing import Any, cast

from pydantic import BaseModel

from minidual.config.root import Config
from minidual.errors import unknown_name


def changed(config: Config, settings: Mapping[str, Any]) -> Config:
    """Return the configuration with {dotted path: value} applied, such as {"carry.sensing.delay_s": 0.02}.

    Raises:
        UsageError: There is no such path.
        pydantic.ValidationError: A value is invalid.
    """
    document = config.model_dump()
    for path, value in settings.items():
        *sections, name = path.split(".")
        section: dict[str, Any] = document
        for step in sections:
            if not isinstance(section.get(step), dict):
                raise unknown_name("configuration section", step, section)
            section = cast(dict[str, Any], section[step])
        if name not in section:
            raise unknown_name("configuration value", path, section)
        section[name] = value
    return Config.model_validate(document)


def preset[M: BaseModel](section: M, values: Mapping[str, Any]) -> M:
    """Return a section with {dotted path: value} applied where the user set nothing.

    Raises:
        UsageError: There is no such path.
        pydantic.ValidationError: The values are invalid together.
    """
    wanted: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        name, _, rest = path.partition(".")
        if name not in type(section).model_fields:
            raise unknown_name("configuration value", path, type(section).model_fields)
        now = getattr(section, name)
        if rest:
            inner.setdefault(name, {})[rest] = value
        elif name not in section.model_fields_set:
            wanted[name] = value
        elif isinstance(now, BaseModel) and isinstance(value, BaseModel):
            inner.setdefault(name, {}).update({k: getattr(value, k) for k in value.model_fields_set})
    wanted |= {name: preset(getattr(section, name), part) for name, part in inner.items()}
    return replaced(section, **wanted)


def replaced[M: BaseModel](section: M, **values: Any) -> M:
    """Return a validated copy with `values`; other unset fields stay unset."""
    known = {name: getattr(section, name) for name in section.model_fields_set}
    return type(section).model_validate({**known, **values})
