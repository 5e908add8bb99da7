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
    about = inspect.cleandoc(type(model).__doc__ or "")
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
    cells = [f"`{path}`", _shown(value), _kind(field), meaning]
    return f"| {' | '.join(_cell(cell) for cell in cells)} |"


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
        return f"list of {type_in_words(items[0])}"
    return f"list of {len(items)} ({type_in_words(items[0])})"


_BOUNDS: dict[type, tuple[str, str]] = {
    bounds.Ge: ("ge", ">="),
    bounds.Gt: ("gt", ">"),
    bounds.Le: ("le", "<="),
    bounds.Lt: ("lt", "<"),
}


def bounds_in_words(metadata: Any) -> list[str]:
    """Return the bounds of a field, such as ">= 0"."""
    words: list[str] = []
    for item in metadata:
        if isinstance(item, FieldInfo):
            words += bounds_in_words(item.metadata)
        elif type(item) in _BOUNDS:
            name, sign = _BOUNDS[type(item)]
            limit = getattr(item, name)
            words.append(
                f"{sign} {limit:g}" if limit < 2**53 else f"{sign} 2^{limit.bit_length() - 1}"
            )
    return words


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
