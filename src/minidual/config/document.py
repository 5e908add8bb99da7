"""Strict YAML with the line of every value.

Scalars follow YAML 1.2, unlike PyYAML's: `1e-3` is a number; `on`, `yes`, `010` and `1:30` are text.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import yaml
from yaml.composer import ComposerError

from minidual.durable import regular_file
from minidual.errors import ConfigError, DataError

_INT = re.compile(r"[-+]?(0|[1-9](_?[0-9])*)")
_NUMBER = re.compile(
    r"[-+]?((0|[1-9](_?[0-9])*)(\.([0-9](_?[0-9])*)?)?|\.[0-9]+)([eE][-+]?[0-9]+)?",
)
_HALF = re.compile("[\ud800-\udfff]")
_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}
_BYTES_MAX = 256 * 1024
_DEPTH_MAX = 32
_NODES_MAX = 20_000  # parsed within 1 s
_MAGNITUDE_MIN = 1e-15
_MAGNITUDE_MAX = 2.0**63
"""Of numbers other than 0; no quantity here is smaller or larger in its unit."""


class _Loader(yaml.SafeLoader):
    """Leaves types to `_scalar`. Bounds depth and nodes; refuses aliases, which could multiply them."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML's own way to declare it
    depth = nodes_n = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node and what it contains."""
        self.depth = self.depth + 1
        self.nodes_n = self.nodes_n + 1
        event = cast(Any, self.peek_event())  # pyright: ignore[reportUnknownMemberType]
        for problem, found in (
            ("aliases are not read here; write the value out", type(event) is yaml.AliasEvent),
            (
                "half of a surrogate pair is no character",
                bool(_HALF.search(getattr(event, "value", None) or "")),
            ),
            (f"nested more than {_DEPTH_MAX} levels deep", self.depth > _DEPTH_MAX),
            (f"more than {_NODES_MAX} values", self.nodes_n > _NODES_MAX),
        ):
            if found:
                raise ComposerError(None, None, problem, event.start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


# The type stubs of yaml.compose leave its result open.
_yaml_compose = cast(Callable[..., yaml.Node | None], yaml.compose)  # pyright: ignore[reportUnknownMemberType]


@dataclass
class Document:
    """Plain values; `origins` is {dotted path: "file.yaml:12"}."""

    source: str
    tree: dict[str, Any]
    origins: dict[str, str] = field(default_factory=dict[str, str])


def read_document(path: Path) -> Document:
    """Read a YAML file; ConfigError names file and line."""
    try:
        text = regular_file(path, _BYTES_MAX).read_text(encoding="utf-8")
    except (DataError, OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    return parse_document(text, path.name)


def parse_document(text: str, source: str) -> Document:
    """Parse YAML text; errors call it `source`."""
    document = Document(source, {})
    node = _compose(text, source)
    if isinstance(node, yaml.MappingNode):
        document.tree = _build(node, "", document)
    elif node is not None:
        kind = "a list" if isinstance(node, yaml.SequenceNode) else "a single value"
        raise ConfigError(f"{source}:1: it must be a mapping of sections, not {kind}")
    return document


def parse_value(text: str, source: str, path: str) -> Any:
    """Parse a value typed for `path`."""
    node = _compose(text, source)
    return "" if node is None else _build(node, path, Document(source, {}))


def _compose(text: str, source: str) -> yaml.Node | None:
    try:
        return _yaml_compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        kind = "" if isinstance(error, ComposerError) else "not YAML: "
        raise ConfigError(f"{source}:{line}: {kind}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{source}: not YAML: {error}") from error


def _build(node: yaml.Node, path: str, document: Document) -> Any:
    where = f"{document.source}:{node.start_mark.line + 1}"
    document.origins.setdefault(path, where)
    if isinstance(node, yaml.SequenceNode):
        return [_build(item, f"{path}.{i}", document) for i, item in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        return _scalar(node, path, where)
    mapping: dict[str, Any] = {}
    for key_node, value_node in node.value:
        where = f"{document.source}:{key_node.start_mark.line + 1}"
        if not isinstance(key_node, yaml.ScalarNode):
            raise ConfigError(f"{where}: {path or 'the file'}: a key must be a word")
        key = str(key_node.value)
        inner = f"{path}.{key}" if path else key
        if key in mapping:
            first = document.origins[inner]
            raise ConfigError(
                f"{where}: {inner}: stands twice (first at {first}); a second value would silently win",
            )
        document.origins[inner] = where
        mapping[key] = _build(value_node, inner, document)
    return mapping


def _scalar(node: yaml.Node, path: str, where: str) -> Any:
    text = str(node.value)
    if node.tag != "tag:yaml.org,2002:str" and not node.tag.endswith(":null"):
        raise ConfigError(f"{where}: {path}: tags such as '{node.tag}' are not read here")
    if getattr(node, "style", None) is not None:
        return text
    if text in _WORDS or text in ("Null", "NULL", "True", "TRUE", "False", "FALSE"):
        return _WORDS[text.lower()]
    is_number = _NUMBER.fullmatch(text) is not None
    number = float(text) if is_number else 0.0
    if not math.isfinite(number) or text.lower().lstrip("+-.") in ("nan", "inf"):
        raise ConfigError(f"{where}: {path}: {text[:40]} is not a finite number")
    if number and not _MAGNITUDE_MIN <= abs(number) <= _MAGNITUDE_MAX:
        bounds = f"a number is 0, or from {_MAGNITUDE_MIN:g} to {_MAGNITUDE_MAX:.3g} in magnitude"
        raise ConfigError(f"{where}: {path}: {text[:40]} is out of range; {bounds}")
    return int(text) if _INT.fullmatch(text) else number if is_number else text
