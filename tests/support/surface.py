"""The public surface as text: each name with its parameters, fields and types, as the sources write them.

`python -m tests.support.surface > tests/api/surface.txt` announces a change.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from types import ModuleType
from typing import Any


def surface(module: ModuleType) -> str:
    """Return a description of every name in `module.__all__`."""
    lines: list[str] = []
    for name in sorted(module.__all__):
        lines += described(name, getattr(module, name))
    return "\n".join(lines) + "\n"


def described(name: str, thing: Any) -> list[str]:
    """Return the lines of a function or class."""
    if inspect.isclass(thing):
        return [f"class {name}", *(f"    {line}" for line in _members(thing))]
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(thing))).body
    assert isinstance(node, ast.FunctionDef)
    return [_signature(node, name)]


def _members(thing: type) -> list[str]:
    """Return fields, properties and methods of a class and of its bases in minidual, bases first."""
    members: dict[str, str] = {}
    for base in reversed(thing.__mro__):
        if base.__module__.startswith(("minidual", "tests")):
            members |= dict(_own_members(base))
    return list(members.values())


def _own_members(thing: type) -> Iterator[tuple[str, str]]:
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(thing))).body
    assert isinstance(node, ast.ClassDef)
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and not ast.unparse(item.target).startswith("_"):
            default = "" if item.value is None else f" = {ast.unparse(item.value)}"
            target = ast.unparse(item.target)
            yield target, f"{target}: {ast.unparse(item.annotation)}{default}"
        if isinstance(item, ast.FunctionDef) and _is_public(item.name):
            yield item.name, _signature(item, item.name)


def _is_public(name: str) -> bool:
    return name == "__init__" or not name.startswith("_")


def _signature(node: ast.FunctionDef, name: str) -> str:
    marks = [ast.unparse(mark) for mark in node.decorator_list]
    kind = "".join(f"@{mark} " for mark in marks if "property" in mark or "method" in mark)
    returned = "" if node.returns is None else f" -> {ast.unparse(node.returns)}"
    return f"{kind}{name}({ast.unparse(node.args)}){returned}"


if __name__ == "__main__":
    import minidual

    print(surface(minidual), end="")
