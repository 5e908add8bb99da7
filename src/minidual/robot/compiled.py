"""Functions compiled by numba, kept on disk where some directory can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call with each set of types; with numpy's rules of division, so nothing raises."""
    return compile_as(None)(function)


def compile_as(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles at once for one signature (None: at the first call)."""

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return njit(signature, cache=True, error_model="numpy")(function)
        except RuntimeError as failure:  # numba has no class of its own for it
            if "cannot cache" not in str(failure):
                raise
            return njit(signature, error_model="numpy")(function)

    return decorate
