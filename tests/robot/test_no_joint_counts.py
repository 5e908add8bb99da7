"""No module but the table of arms knows how many joints an arm has, or what one is called."""

from __future__ import annotations

import ast
from pathlib import Path

import minidual

SRC = Path(minidual.__file__).parent
COUNTS = (7, 14)
SHAPING = {
    "range",
    "zeros",
    "empty",
    "ones",
    "full",
    "eye",
    "reshape",
    "tile",
    "split",
    "repeat",
    "resize",
}
EXCUSED = {
    "environments/worlds.py": 1,  # position and quaternion of an object
    "plant/bodies.py": 1,  # position and quaternion of an object
    "show/view/scene.py": 1,  # position and quaternion of a body
}
"""Files with such a number that is no count of joints, and how many."""


def suspects(source: str) -> list[int]:
    """Return the lines on which 7 or 14 indexes, shapes or divides an array."""
    found = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Subscript():
                inside = [node.slice]
            case ast.BinOp(op=ast.FloorDiv() | ast.Mod()):
                inside = [node.right]
            case ast.Compare():
                inside = node.comparators
            case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name)) if name in SHAPING:
                inside = node.args
            case _:
                continue
        for part in inside:
            found += [
                part.lineno
                for constant in ast.walk(part)
                if isinstance(constant, ast.Constant)
                and type(constant.value) is int
                and constant.value in COUNTS
            ]
    return found


def test_no_array_is_shaped_or_cut_by_a_number_of_joints():
    found = {}
    for path in sorted(SRC.rglob("*.py")):
        name = path.relative_to(SRC).as_posix()
        lines = suspects(path.read_text(encoding="utf-8"))
        if len(lines) != EXCUSED.get(name, 0):
            found[name] = lines
    assert found == {}


def test_no_link_or_joint_of_an_arm_is_named():
    for path in sorted(SRC.rglob("*.py")):
        if path.relative_to(SRC).as_posix() == "robot/models.py":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        prose = {
            id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)
        }  # docstrings may show a name
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and id(node) not in prose
            ):
                assert "panda_" not in node.value, (path.name, node.value)


def test_the_search_finds_what_it_looks_for():
    for bad in (
        "q[:7]",
        "q[7:14]",
        "np.zeros(14)",
        "np.empty((n, 14))",
        "i // 7",
        "len(q) == 14",
        "range(7)",
        "q[i + 7]",
    ):
        assert suspects(bad), bad
    assert not suspects("x = 7\ny = 3.14 * 7\nprint(14)")
