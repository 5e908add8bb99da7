"""Validated changes of a configuration."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from minidual.errors import unknown_name


def changed[M: BaseModel](section: M, values: Mapping[str, Any], *, unset_only: bool = False) -> M:
    """Return a section with {dotted path: value} applied; with `unset_only` where the user set nothing.

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
        elif not unset_only or name not in section.model_fields_set:
            wanted[name] = value
        elif isinstance(now, BaseModel) and isinstance(value, BaseModel):
            inner.setdefault(name, {}).update({k: getattr(value, k) for k in value.model_fields_set})
    for name, part in inner.items():
        wanted[name] = changed(getattr(section, name), part, unset_only=unset_only)
    return replaced(section, **wanted)


def preset[M: BaseModel](section: M, values: Mapping[str, Any]) -> M:
    """Return a section with {dotted path: value} applied where the user set nothing; errors as `changed`."""
    return changed(section, values, unset_only=True)


def replaced[M: BaseModel](section: M, **values: Any) -> M:
    """Return a validated copy with `values`; other unset fields stay unset."""
    known = {name: getattr(section, name) for name in section.model_fields_set}
    return type(section).model_validate({**known, **values})
