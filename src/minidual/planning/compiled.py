"""Compile a numeric loop once, when its module is imported, and keep the machine code on disk.

Neither reassociation nor fused products are allowed (no fastmath): a loop computes what its lines say, in their order,
and a NaN that goes in comes out. numba's cache watches only the file of the compiled function, so the helpers that a
loop calls stand in the same file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core import types

VECTOR = types.float64[::1]
ROWS = types.float64[:, ::1]
BLOCKS = types.float64[:, :, ::1]


def kernel(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile for one signature; where no directory can be written, compile anew each time."""

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return njit(signature, cache=True, error_model="numpy")(function)
        except RuntimeError as failure:  # numba has no class of its own for it
            if "cannot cache" not in str(failure):
                raise
            return njit(signature, error_model="numpy")(function)

    return compiled
