"""Strict YAML with the line of every value.

Unlike PyYAML, scalars follow YAML 1.2: `on`, `yes`, `no`, `010` and `1:30` are text. The models later refuse text where
a number is expected.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import yaml

from minidual.errors import ConfigError

_INT = re.compile(r"[-+]?(0|[1-9][0-9_]*)")
_FLOAT = re.compile(r"[-+]?([0-9][0-9_]*\.[0-9_]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF|nan|NaN|NAN)")
_LOOKS_NUMERIC = re.compile(r"[-+]?(inf|nan|infinity|[0-9.][0-9_.]*([eE][-+]?[0-9]+)?)", re.IGNORECASE)


class _Loader(yaml.SafeLoader):
    """Composes nodes without resolving types; `_scalar` does that."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML's own way to declare it


# The type stubs of yaml.compose leave its result open.
_compose = cast(Callable[..., yaml.Node | None], yaml.compose)  # pyright: ignore[reportUnknownMemberType]


@dataclass
class Document:
    """A tree of plain values; origins map dotted paths to "file.yaml:12"."""

    source: str
    tree: dict[str, Any]
    origins: dict[str, str] = field(default_factory=dict[str, str])


def read_document(path: Path) -> Document:
    """Read a YAML file; ConfigError names file and line of an error."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    return parse_document(text, path.name)


def parse_document(text: str, source: str) -> Document:
    """Parse YAML text; messages call it `source`."""
    try:
        node = _compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{source}:{line}: not YAML: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{source}: not YAML: {error}") from error
    document = Document(source, {})
    if node is None:
        return document
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError(f"{source}:1: a profile is a mapping of sections, not {_kind(node)}")
    document.tree = _build(node, "", document, ())
    return document


def parse_value(text: str, source: str) -> Any:
    """Parse a command-line value: Python numbers (1e-3 too), else YAML."""
    if _LOOKS_NUMERIC.fullmatch(text.strip()):
        try:
            return _finite(float(text), source) if not _INT.fullmatch(text.strip()) else int(text)
        except ValueError:
            return text
    return parse_document(f"value: {text}" if text.strip() else "value: ''", source).tree["value"]


def looks_numeric(text: str) -> bool:
    """Return whether `text` looks like a number."""
    return _LOOKS_NUMERIC.fullmatch(text.strip()) is not None


def _finite(value: float, source: str) -> float:
    if not math.isfinite(value):
        raise ConfigError(f"{source}: {value} is not a finite number")
    return value


def _build(node: yaml.Node, path: str, document: Document, above: tuple[int, ...]) -> Any:
    where = f"{document.source}:{node.start_mark.line + 1}"
    document.origins.setdefault(path, where)
    if id(node) in above:
        raise ConfigError(f"{where}: {path}: an alias that contains itself")
    above = (*above, id(node))
    if isinstance(node, yaml.MappingNode):
        mapping: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise ConfigError(f"{document.source}:{line}: {path or 'the file'}: a key must be a word")
            key = str(key_node.value)
            inner = f"{path}.{key}" if path else key
            if key in mapping:
                raise ConfigError(
                    f"{document.source}:{line}: {inner}: stands twice (first at "
                    f"{document.origins[inner]}); a second value would silently win"
                )
            document.origins[inner] = f"{document.source}:{line}"
            mapping[key] = _build(value_node, inner, document, above)
        return mapping
    if isinstance(node, yaml.SequenceNode):
        return [_build(item, f"{path}.{i}", document, above) for i, item in enumerate(node.value)]
    return _scalar(node, path, where)


def _scalar(node: yaml.Node, path: str, where: str) -> Any:
    text = str(node.value)
    if node.tag != "tag:yaml.org,2002:str" and not node.tag.endswith(":null"):
        raise ConfigError(f"{where}: {path}: tags such as '{node.tag}' are not read here")
    if getattr(node, "style", None) is not None:
        return text
    if text in ("", "~", "null", "Null", "NULL"):
        return None
    if text in ("true", "True", "TRUE"):
        return True
    if text in ("false", "False", "FALSE"):
        return False
    if _NOT_FINITE.fullmatch(text) or text.lower() in ("nan", "inf", "-inf", "+inf"):
        raise ConfigError(f"{where}: {path}: {text} is not a finite number")
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return _finite(float(text), f"{where}: {path}")
    return text


def _kind(node: yaml.Node) -> str:
    return "a list" if isinstance(node, yaml.SequenceNode) else "a single value"
