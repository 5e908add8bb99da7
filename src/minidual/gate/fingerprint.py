"""What a verdict depends on, and what differs now.

Code that a stage reaches: a digest per module, with the YAML table called like it, without comments and docstrings. It
follows imports outside TYPE_CHECKING and "module:attribute" texts, within minidual and the target's package.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.util
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from importlib.machinery import ModuleSpec, PathFinder
from itertools import accumulate
from pathlib import Path
from typing import Any, cast

import minidual
from minidual.errors import shortened
from minidual.gate.canonical import canonical
from minidual.registry import rows_beside

UNSEEN = "(absent)"
_FULL_HASH = re.compile(r"^([0-9a-f]{10})[0-9a-f]+")

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
        return sorted(name for name, _, _ in changes(self.modules, now.modules))


@dataclass(frozen=True)
class Fingerprint:
    """What a verdict depends on.

    A difference in the last five fields, the circumstances, only warns.

    Attributes:
        inputs: sha256 of input artefacts by "stage/path".
        upstream: sha256 of every upstream verdict; None if missing.
    """

    parameters: dict[str, Any]
    options: dict[str, Any]
    inputs: dict[str, str]
    upstream: dict[str, str | None]
    seed: int
    profile: str
    version: str
    commit: str | None
    machine: dict[str, Any]
    libraries: dict[str, str]
    code: Code = field(default_factory=Code)

    def choices(self, now: Fingerprint) -> list[str]:
        """Return differences of parameters, options, seed and profile."""
        typed = {"parameter": self.parameters, "option": self.options}
        current = {"parameter": canonical(now.parameters), "option": canonical(now.options)}
        reasons = [
            f"{n.replace('.', ' ', 1)} was {_short(a)}, is {_short(b)}"
            for n, a, b in changes(typed, current)
        ]
        both = (("seed", self.seed, now.seed), ("profile", self.profile, now.profile))
        return reasons + [f"the {name} was {a!r}, is {b!r}" for name, a, b in both if a != b]

    def differences(self, now: Fingerprint) -> list[str]:
        """Return why a verdict with this fingerprint is stale."""
        inputs = changes(self.inputs, now.inputs)
        told = [
            f"input {name} {'is new' if then == UNSEEN else 'changed or is gone'}"
            for name, then, _ in inputs
        ]
        reasons = [*self.choices(now), *told]
        for name, then, current in changes(self.upstream, now.upstream):
            if current is None:
                reasons.append(f"the verdict of upstream stage {name} is gone")
            else:
                reasons.append(
                    f"upstream stage {name} {'has run' if then is None else 'ran again'} since",
                )
        return reasons

    def circumstances(self, now: Fingerprint) -> list[str]:
        """Return a warning per changed circumstance."""
        warnings: list[str] = []
        if self.version != now.version:
            warnings.append(f"made by minidual {self.version}, this is {now.version}")
        if self.commit != now.commit:
            then, current = (
                _FULL_HASH.sub(r"\1", commit or "none") for commit in (self.commit, now.commit)
            )
            warnings.append(f"made at commit {then}, this is {current}")
        before = {"machine": self.machine, "library": self.libraries}
        after = {"machine": now.machine, "library": now.libraries}
        warnings += [
            f"{n.replace('.', ' ', 1)}: was {_short(a)}, is {_short(b)}"
            for n, a, b in changes(before, after)
        ]
        if changed := self.code.changes(now.code):
            warnings.append(f"made by other code: {shortened(changed, 3)} changed since")
        return warnings


def changes(
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    prefix: str = "",
) -> Iterable[tuple[str, Any, Any]]:
    """Yield (dotted name, before, after) for each differing leaf."""
    for key in [*before, *(key for key in after if key not in before)]:
        then = before.get(key, UNSEEN)
        current = after.get(key, UNSEEN)
        if isinstance(then, dict) and isinstance(current, dict):
            yield from changes(
                cast(dict[str, Any], then),
                cast(dict[str, Any], current),
                f"{prefix}{key}.",
            )
        elif then != current or isinstance(then, bool) is not isinstance(current, bool):
            yield f"{prefix}{key}", then, current


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


@cache
def circumstances_now(libraries: tuple[str, ...]) -> dict[str, Any]:
    """Return version, commit, machine and versions of distributions."""
    machine: Any = {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
    }
    machine |= {"cores": os.cpu_count(), "python": platform.python_version()}
    installed = {name: installed_version(name) or "not installed" for name in libraries}
    return {
        "version": minidual.__version__,
        "commit": _commit(),
        "machine": machine,
        "libraries": installed,
    }


def installed_version(name: str) -> str | None:
    """Return the version of a distribution, or None."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:

    def git(*words: str) -> str:
        command = ["git", "-C", str(Path(minidual.__file__).parent), *words]
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        ).stdout.strip()

    try:
        # An installed wheel may lie inside somebody else's repository: check that git tracks this file.
        git("ls-files", "--error-unmatch", "__init__.py")
        commit = git("rev-parse", "HEAD")
        return f"{commit}+changes" if git("status", "--porcelain", "--", ".") else commit
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    with contextlib.suppress(OSError):
        if named := re.search(
            "^model name.*?:(.*)",
            Path("/proc/cpuinfo").read_text(encoding="utf-8"),
            re.MULTILINE,
        ):
            return named[1].strip()
    return platform.processor()


def code_of(targets: Iterable[str], known: Code | None = None) -> Code:
    """Return the code that the targets ("module:attribute") reach; `known` if its files are unchanged."""
    if known is not None and known.modules and _sources(known.modules) == known.sources:
        return known
    modules = dict(sorted(item for target in targets for item in _reach(target).items()))
    return Code(modules, _sources(modules))


def _sources(modules: Iterable[str]) -> str:
    digests = [
        hashlib.sha256(path.read_bytes()).digest() for name in modules for path in _files(name)
    ]
    return hashlib.sha256(b"".join(digests)).hexdigest()


@cache
def _reach(target: str) -> dict[str, str]:
    first = target.partition(":")[0]
    roots = {_PACKAGE, first.split(".")[0]}
    found: dict[str, str] = {}
    wanted = [first]
    while wanted:
        name = wanted.pop()
        if name not in found and name.split(".")[0] in roots and (module := _module(name)):
            found[name], reached = module
            wanted += [*reached, *accumulate(name.split("."), "{}.{}".format)]
    return found


@cache
def _module(name: str) -> tuple[str, tuple[str, ...]] | None:
    if not (files := _files(name)):
        return None
    tree = _Strip().visit(ast.parse(files[0].read_bytes()))
    table = repr(rows_beside(str(files[0]))) if files[1:] else ""
    reached = {*_reached(tree), *_TARGET.findall(table)}
    return hashlib.sha256((ast.dump(tree) + table).encode()).hexdigest()[:16], tuple(
        sorted(reached),
    )


@cache
def _spec(name: str) -> ModuleSpec | None:
    if not (parent := name.rpartition(".")[0]):
        return importlib.util.find_spec(name)
    above = _spec(parent)
    folders = above.submodule_search_locations if above else None
    return PathFinder.find_spec(name, folders) if folders else None


@cache
def _files(name: str) -> list[Path]:
    """Return a module's source and its YAML table."""
    source = Path(getattr(_spec(name), "origin", None) or "")
    return (
        [path for path in (source, source.with_suffix(".yaml")) if path.exists()]
        if source.suffix == ".py"
        else []
    )


class _Strip(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return (
            None
            if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
            else node
        )

    def visit_If(self, node: ast.If) -> ast.AST | None:
        silent = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return None if silent else self.generic_visit(node)


def _reached(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and (hit := _TARGET.fullmatch(node.value))
        ):
            yield hit[1]
