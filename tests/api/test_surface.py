"""The public surface: announced, lazy, documented."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import minidual
from tests.support.surface import described, surface

ROOT = Path(__file__).resolve().parents[2]
ANNOUNCED = Path(__file__).with_name("surface.txt")
HEAVY = ("numpy", "mujoco", "pinocchio", "pydantic", "scipy", "torch", "typer")


def test_the_surface_is_the_announced_one() -> None:
    remedy = "announce a change: python -m tests.support.surface > tests/api/surface.txt, CHANGELOG"
    assert surface(minidual) == ANNOUNCED.read_text(encoding="utf-8"), remedy


def greet(name: str, *, loud: bool = False) -> str:
    return name.upper() if loud else name


class Greeter:
    greeting: str = "hello"

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def shout(self) -> str:
        return self.name.upper()

    def _hidden(self) -> None: ...


def test_parameters_fields_and_types_belong_to_the_surface() -> None:
    assert described("greet", greet) == ["greet(name: str, *, loud: bool=False) -> str"]
    assert described("Greeter", Greeter) == [
        "class Greeter",
        "    greeting: str = 'hello'",
        "    __init__(self, name: str) -> None",
        "    @property shout(self) -> str",
    ]


def imports_for_type_checkers() -> dict[str, tuple[str | None, str]]:
    """Return {name: "module:attribute"} of the imports that only type checkers see."""
    tree = ast.parse((ROOT / "src" / "minidual" / "__init__.py").read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def test_type_checkers_see_what_is_imported() -> None:
    assert imports_for_type_checkers() == minidual._TARGETS
    assert sorted(minidual._TARGETS) == minidual.__all__


def test_the_surface_is_listed_and_an_unknown_name_is_refused() -> None:
    assert set(minidual.__all__) < set(dir(minidual))
    with pytest.raises(AttributeError, match="no attribute 'Plannner'"):
        _ = minidual.Plannner


def test_a_name_is_imported_at_its_first_use() -> None:
    code = (
        "import sys, minidual;"
        f"print([name for name in {HEAVY} if name in sys.modules]);"
        "minidual.UsageError;"
        "print('minidual.errors' in sys.modules, 'minidual.api' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout.splitlines() == ["[]", "True False"]


@pytest.mark.parametrize("name", minidual.__all__)
def test_every_name_has_a_docstring_and_its_place_in_the_guide(name: str) -> None:
    assert getattr(minidual, name).__doc__
    guide = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert f"`{name}`" in guide or f"`{name}(" in guide
