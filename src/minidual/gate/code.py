"""Code that a stage reaches: a digest per module, blind to comments and docstrings.

It follows imports outside TYPE_CHECKING and "module:attribute" texts, within minidual and the
target's package. A YAML table called like a module belongs to it. Nothing is imported to find out.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import NamedTuple

from minidual.registry import rows_beside

_TARGET = re.compile(r"(\w+(?:\.\w+)*):\w+")
_PACKAGE = __name__.split(".")[0]


@dataclass(frozen=True)
class Code:
    """Code of a stage.

    Attributes:
        modules: {module: digest of its syntax tree}.
        sources: sha256 of the files. If it matches, no tree is built (5 ms instead of 1 s a stage).
    """

    modules: dict[str, str] = field(default_factory=dict[str, str])
    sources: str = ""

    def changes(self, now: Code) -> list[str]:
        """Return the modules that differ."""
        names = {*self.modules, *now.modules}
        return sorted(name for name in names if self.modules.get(name) != now.modules.get(name))


def code_of(targets: Iterable[str], recorded: Code | None = None) -> Code:
    """Return the code that the targets ("module:attribute") reach.

    `recorded` is returned if its files are unchanged.
    """
    if recorded is not None and recorded.modules and _sources(recorded.modules) == recorded.sources:
        return recorded
    modules: dict[str, str] = {}
    for target in targets:
        modules |= _reach(target)
    modules = dict(sorted(modules.items()))
    return Code(modules, _sources(modules))


def _sources(modules: Iterable[str]) -> str:
    digests: list[bytes] = []
    for name in modules:
        for path in _files(name):
            digests.append(hashlib.sha256(path.read_bytes()).digest())
    return hashlib.sha256(b"".join(digests)).hexdigest()


@cache
def _reach(target: str) -> dict[str, str]:
    """Return {module: digest} of all that a target reaches."""
    first = target.partition(":")[0]
    packages = {_PACKAGE, first.split(".")[0]}
    digests: dict[str, str] = {}
    queue = [first]
    while queue:
        name = queue.pop()
        if name in digests or name.split(".")[0] not in packages:
            continue
        module = _module(name)
        if module is None:
            continue
        digests[name] = module.digest
        queue += [*module.reached, *_with_parents(name)]
    return digests


def _with_parents(name: str) -> list[str]:
    """Return "a", "a.b" and "a.b.c" for "a.b.c"."""
    parts = name.split(".")
    return [".".join(parts[: length + 1]) for length in range(len(parts))]


class _Module(NamedTuple):
    digest: str
    reached: tuple[str, ...]
    """Names that may be modules."""


@cache
def _module(name: str) -> _Module | None:
    files = _files(name)
    if not files:
        return None
    source, *tables = files
    tree = _Stripper().visit(ast.parse(source.read_bytes()))
    table = repr(rows_beside(str(source))) if tables else ""
    reached = {*_reached(tree), *_TARGET.findall(table)}
    digest = hashlib.sha256((ast.dump(tree) + table).encode()).hexdigest()[:16]
    return _Module(digest, tuple(sorted(reached)))


@cache
def _spec(name: str) -> ModuleSpec | None:
    parent = name.rpartition(".")[0]
    if not parent:
        return importlib.util.find_spec(name)
    parent_spec = _spec(parent)
    folders = None if parent_spec is None else parent_spec.submodule_search_locations
    return PathFinder.find_spec(name, folders) if folders else None


@cache
def _files(name: str) -> list[Path]:
    """Return a module's source and its YAML table."""
    source = Path(getattr(_spec(name), "origin", None) or "")
    if source.suffix != ".py":
        return []
    return [path for path in (source, source.with_suffix(".yaml")) if path.exists()]


class _Stripper(ast.NodeTransformer):
    """Removes docstrings and code for the type checker."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return None
        return node

    def visit_If(self, node: ast.If) -> ast.AST | None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return None
        return self.generic_visit(node)


def _reached(tree: ast.Module) -> Iterator[str]:
    """Yield the names that a tree imports or names as a target; some are attributes of modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            match = _TARGET.fullmatch(node.value)
            if match is not None:
                yield match[1]
