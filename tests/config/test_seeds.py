"""Random streams: named, disjoint, and made in one place."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from minidual.config.seeds import stored_stream, stream, subseed

ROOT = Path(__file__).resolve().parents[2]
SEEDS = ROOT / "src" / "minidual" / "config" / "seeds.py"
WITHOUT_MINIDUAL = ROOT / "scripts" / "gym_aloha"
"""Scripts of an environment in which minidual is not installed."""
QUERIES = ROOT / "src" / "minidual" / "trials" / "planning" / "queries.py"
MAKERS = {"default_rng", "SeedSequence", "RandomState", "PCG64"}


def draw(*key: object) -> tuple[float, ...]:
    return tuple(stream(*key).random(4))  # type: ignore[arg-type]


def test_streams_differ_by_seed_purpose_and_every_index_and_repeat() -> None:
    keys = [(1, "a"), (2, "a"), (1, "b"), (1, "a", 1), (1, "b", 1), (1, "a", 0, 1), (1, "a", 1, 1)]
    assert len({draw(*key) for key in keys}) == len(keys)
    assert draw(1, "a") == draw(1, "a", 0) == draw(1, "a")
    assert len({subseed(*key) for key in keys}) == len(keys)  # type: ignore[arg-type]
    assert subseed(1, "a") == int(stream(1, "a").integers(2**31))


def bypasses(text: str) -> list[str]:
    """Return the places where a source makes random numbers by itself.

    These are generators, the global one, and arithmetic with seeds.
    """
    found: list[ast.AST] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            if MAKERS & set(names) or "random" in names:
                found.append(node)
        elif (
            _last(node) in MAKERS
            or (
                isinstance(node, ast.Attribute)
                and _of_numpy(node.value)
                and node.attr != "Generator"
            )
            or (
                isinstance(node, ast.BinOp)
                and any(_last(n).endswith("seed") for n in (node.left, node.right))
            )
        ):
            found.append(node)
    return [ast.unparse(node) for node in found]


def _of_numpy(node: ast.AST) -> bool:
    return _last(node) == "random" and ast.unparse(node) == "np.random"


def _last(node: ast.AST) -> str:
    return (
        node.attr
        if isinstance(node, ast.Attribute)
        else node.id
        if isinstance(node, ast.Name)
        else ""
    )


@pytest.mark.parametrize("folder", ["src", "scripts"])
def test_no_module_makes_a_generator_or_counts_with_seeds(folder: str) -> None:
    found = {
        p.relative_to(ROOT): bypasses(p.read_text())
        for p in (ROOT / folder).rglob("*.py")
        if p != SEEDS and p.parent != WITHOUT_MINIDUAL
    }
    assert {path: lines for path, lines in found.items() if lines} == {}
    users = [
        p for p in (ROOT / folder).rglob("*.py") if p != SEEDS and "stored_stream" in p.read_text()
    ]
    assert users == ([QUERIES] if folder == "src" else []), (
        "nameless keys are for the stored query sets alone"
    )
    assert stored_stream(1, 2).random() != stored_stream(1, 3).random()


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("rng = np.random.default_rng([seed, 1])", "np.random.default_rng"),
        ("key = np.random.SeedSequence([seed, 2])", "np.random.SeedSequence"),
        ("np.random.shuffle(x)", "np.random.shuffle"),
        ("planner.plan(q, seed=query.seed + 1)", "query.seed + 1"),
        ("planner.plan(q, seed=1000 + self._seed)", "1000 + self._seed"),
        ("import random", "import random"),
        ("from random import shuffle", "from random import shuffle"),
        ("from numpy.random import default_rng", "from numpy.random import default_rng"),
    ],
)
def test_the_search_finds_a_bypass(source: str, found: str) -> None:
    assert found in bypasses(source)


def test_the_search_lets_types_and_names_pass() -> None:
    assert (
        bypasses(
            'def draw(rng: np.random.Generator, seed: int) -> str: return f"{seed}" + "--seed"',
        )
        == []
    )
