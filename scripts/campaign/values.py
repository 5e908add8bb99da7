"""Values in trees of mappings and lists: where they are, and how they are replaced."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

Where = tuple[Any, ...]
"""Keys and indices from the root to a value."""


def places(tree: Any, where: Where = ()) -> Iterator[Where]:
    """Yield the place of every value, mappings and lists included, but not the root's."""
    if where:
        yield where
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from places(value, (*where, key))
    elif isinstance(tree, list):
        for index, value in enumerate(tree):
            yield from places(value, (*where, index))


def dotted(where: Where) -> str:
    """Return a place as text."""
    return ".".join(map(str, where))


def replace(tree: Any, where: Where, value: Any) -> None:
    """Replace the value at a place, in place."""
    parent = parent_of(tree, where)
    parent[where[-1]] = value


def parent_of(tree: Any, where: Where) -> Any:
    """Return the mapping or list that holds the value at a place."""
    parent = tree
    for key in where[:-1]:
        parent = parent[key]
    return parent


def numbers(tree: Any) -> Iterator[float]:
    """Yield every number in a tree."""
    if isinstance(tree, float | int):
        yield tree
    elif isinstance(tree, dict):
        for value in tree.values():
            yield from numbers(value)
    elif isinstance(tree, Sequence) and not isinstance(tree, str):
        for value in tree:
            yield from numbers(value)
