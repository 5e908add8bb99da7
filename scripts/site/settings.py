"""The reference of the configuration, from its models and the comments under their fields."""

import ast
import inspect
import re
import textwrap
import types
from typing import Any, Literal, TypeAliasType, Union, get_args, get_origin

import annotated_types as bounds
from pydantic.fields import FieldInfo

from minidual.config.base import StrictModel
from minidual.config.loader import load_config

_SHORT_MAX = 60
"""Characters of a value that a table shows in full."""


def settings_reference() -> str:
    """Return the page of all settings, with their values in the profile `standard`."""
    standard = load_config("standard").config
    about = (
        "Every setting, its value in the profile `standard`, its bounds and its meaning. Set one for"
        " a run with `--set PATH=VALUE`, or write [a profile](../configs/README.md). `minidual config"
        " show --profile NAME` prints the values of a profile."
    )
    note = (
        "A task may change a value that is left as it is here, such as the time limit of a trial."
    )
    lines = ["# Configuration", "", about, "", note]
    lines += _section(standard, "")
    return "\n".join(lines) + "\n"


def _section(model: StrictModel, path: str) -> list[str]:
    """Return the heading and table of a model, then the sections of the models in it."""
    lines = ["", f"## {path or 'Top level'}", ""]
    about = _linked(inspect.cleandoc(type(model).__doc__ or ""))
    lines += [about, ""] if about else []
    meanings = field_comments(type(model))
    rows: list[str] = []
    inner: list[str] = []
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        dotted = f"{path}.{name}" if path else name
        if isinstance(value, StrictModel):
            inner += _section(value, dotted)
        else:
            rows.append(_row(dotted, field, value, meanings.get(name, "")))
    if rows:
        lines += ["| setting | standard | type and bounds | meaning |", "|---|---|---|---|", *rows]
    return [*lines, *inner]


def _row(path: str, field: FieldInfo, value: Any, meaning: str) -> str:
    cells = [f"`{path}`", _shown(value), _kind(field), _cell(_linked(meaning))]
    return f"| {' | '.join(cells)} |"


def _linked(text: str) -> str:
    """Return a text in which the pages of the documentation are links."""
    return re.sub(r"\bdocs/([a-z0-9-]+)\.md", r"[\1](../docs/\1.md)", text)


def _shown(value: Any) -> str:
    """Return a value as `--set` takes it, shortened."""
    if isinstance(value, tuple):
        return _code("[" + ", ".join(_plain(item) for item in value) + "]")
    if isinstance(value, dict):
        return _code("{" + ", ".join(f"{key}: {_plain(item)}" for key, item in value.items()) + "}")
    return _code(_plain(value))


def _plain(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, StrictModel):
        return "{...}"
    return str(value)


def _code(text: str) -> str:
    shown = text if len(text) <= _SHORT_MAX else f"{text[: _SHORT_MAX - 4]} ..."
    return f"`{shown}`"


def _kind(field: FieldInfo) -> str:
    """Return the type of a field in words, with its bounds."""
    words = [type_in_words(field.annotation), *bounds_in_words(field.metadata)]
    marks = [item for item in field.metadata if item in ("at least", "at most")]
    if marks:
        words.append(f"acceptance asks for {marks[0]} the shipped value")
    return ", ".join(words)


def type_in_words(kind: Any) -> str:
    """Return a type as a reader of a YAML file calls it."""
    if isinstance(kind, TypeAliasType):
        return type_in_words(kind.__value__)
    simple = {str: "text", int: "integer", float: "number", bool: "true or false"}
    if kind in simple:
        return simple[kind]
    if kind is type(None):
        return "null"
    origin = get_origin(kind)
    arguments = get_args(kind)
    if origin is Literal:
        return " or ".join(f"`{argument}`" for argument in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(type_in_words(argument) for argument in arguments)
    if origin is tuple:
        return _list_in_words(arguments)
    if origin is dict:
        return f"mapping to {type_in_words(arguments[1])}"
    if hasattr(kind, "__metadata__"):
        return ", ".join([type_in_words(arguments[0]), *bounds_in_words(kind.__metadata__)])
    return "section"


def _list_in_words(items: tuple[Any, ...]) -> str:
    if items[-1] is Ellipsis:
        return f"list of {_several(type_in_words(items[0]))}"
    return f"list of {len(items)} {_several(type_in_words(items[0]))}"


def _several(kind: str) -> str:
    """Return the plural of a type's name."""
    return f"{kind}s" if kind in ("text", "number", "integer", "section") else kind


_SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def bounds_in_words(metadata: Any) -> list[str]:
    """Return the bounds of a field in words: "0 to 1", or ">= 0"."""
    limits = _limits(metadata)
    if {"ge", "le"} <= limits.keys():
        return [f"{_limit(limits['ge'])} to {_limit(limits['le'])}"]
    return [f"{_SIGNS[name]} {_limit(limit)}" for name, limit in limits.items()]


def _limits(metadata: Any) -> dict[str, float]:
    """Return {name in _SIGNS: limit}."""
    limits: dict[str, float] = {}
    for item in metadata:
        if isinstance(item, FieldInfo):
            limits |= _limits(item.metadata)
        if isinstance(item, bounds.Ge | bounds.Gt | bounds.Le | bounds.Lt):
            limits |= {name: getattr(item, name) for name in _SIGNS if hasattr(item, name)}
    return limits


def _limit(limit: float) -> str:
    if isinstance(limit, int) and limit >= 2**53:
        return f"2^{limit.bit_length() - 1}"
    return f"{limit:g}"


def field_comments(model: type) -> dict[str, str]:
    """Return {field: the text under it} of a model and of its bases."""
    comments: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if issubclass(base, StrictModel) and base is not StrictModel:
            comments |= _own_comments(base)
    return comments


def _own_comments(model: type) -> dict[str, str]:
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    assert isinstance(node, ast.ClassDef)
    comments: dict[str, str] = {}
    for field, after in zip(node.body, node.body[1:], strict=False):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            comments[field.target.id] = inspect.cleandoc(str(after.value.value))
    return comments


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", r"\|")
