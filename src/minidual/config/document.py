"""Strict YAML with the line of every value.

Scalars follow YAML 1.2, unlike PyYAML's: `1e-3` is a number; `on`, `yes`, `010` and `1:30` are
text.
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
_HALF_SURROGATE = re.compile("[\ud800-\udfff]")
_WORDS = {
    "": None,
    "~": None,
    **dict.fromkeys(("null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_BYTES_MAX = 256 * 1024
_DEPTH_MAX = 32
_NODES_MAX = 20_000  # parsed within 1 s
_MAGNITUDE_MIN = 1e-15
_MAGNITUDE_MAX = 2.0**63
"""Of numbers other than 0; no quantity here is smaller or larger in its unit."""
_SHOWN_LENGTH_MAX = 40


class _Loader(yaml.SafeLoader):
    """Leaves types to `_scalar`.

    Bounds depth and nodes, and refuses aliases, which could multiply them.
    """

    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML's own way to declare it
    depth = 0
    nodes_n = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node and what it contains."""
        self.depth = self.depth + 1
        self.nodes_n = self.nodes_n + 1
        event = cast(Any, self.peek_event())  # pyright: ignore[reportUnknownMemberType]
        problem = self._problem(event)
        if problem is not None:
            raise ComposerError(None, None, problem, event.start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def _problem(self, event: Any) -> str | None:
        if type(event) is yaml.AliasEvent:
            return "aliases are not read here; write the value out"
        if _HALF_SURROGATE.search(getattr(event, "value", None) or ""):
            return "half of a surrogate pair is no character"
        if self.depth > _DEPTH_MAX:
            return f"nested more than {_DEPTH_MAX} levels deep"
        if self.nodes_n > _NODES_MAX:
            return f"more than {_NODES_MAX} values"
        return None


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
    if node is None:
        return ""
    return _build(node, path, Document(source, {}))


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
    """Return the plain value of a node and record where it stands."""
    where = _place(document, node)
    document.origins.setdefault(path, where)
    if isinstance(node, yaml.SequenceNode):
        return [_build(item, f"{path}.{i}", document) for i, item in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        return _build_mapping(node, path, document)
    return _scalar(node, path, where)


def _build_mapping(node: yaml.MappingNode, path: str, document: Document) -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    for key_node, value_node in node.value:
        where = _place(document, key_node)
        if not isinstance(key_node, yaml.ScalarNode):
            raise ConfigError(f"{where}: {path or 'the file'}: a key must be a word")
        key = str(key_node.value)
        inner = f"{path}.{key}" if path else key
        if key in mapping:
            first = document.origins[inner]
            raise ConfigError(
                f"{where}: {inner}: stands twice (first at {first}); "
                "a second value would silently win",
            )
        document.origins[inner] = where
        mapping[key] = _build(value_node, inner, document)
    return mapping


def _place(document: Document, node: yaml.Node) -> str:
    return f"{document.source}:{node.start_mark.line + 1}"


def _scalar(node: yaml.Node, path: str, where: str) -> Any:
    """Return the value of a scalar: null, a bool, a number or text."""
    text = str(node.value)
    if node.tag != "tag:yaml.org,2002:str" and not node.tag.endswith(":null"):
        raise ConfigError(f"{where}: {path}: tags such as '{node.tag}' are not read here")
    quoted = getattr(node, "style", None) is not None
    if quoted:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if text.lower().lstrip("+-.") in ("nan", "inf"):
        raise _not_finite(text, path, where)
    if _NUMBER.fullmatch(text) is None:
        return text
    return _number(text, path, where)


def _number(text: str, path: str, where: str) -> int | float:
    number = float(text)
    if not math.isfinite(number):
        raise _not_finite(text, path, where)
    if number and not _MAGNITUDE_MIN <= abs(number) <= _MAGNITUDE_MAX:
        raise ConfigError(
            f"{where}: {path}: {text[:_SHOWN_LENGTH_MAX]} is out of range; a number is 0, "
            f"or from {_MAGNITUDE_MIN:g} to {_MAGNITUDE_MAX:.3g} in magnitude",
        )
    return int(text) if _INT.fullmatch(text) else number


def _not_finite(text: str, path: str, where: str) -> ConfigError:
    return ConfigError(f"{where}: {path}: {text[:_SHOWN_LENGTH_MAX]} is not a finite number")
