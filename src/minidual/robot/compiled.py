"""Compile a numeric loop with numba once, and keep the machine code on disk where some directory can be written.

Neither reassociation nor fused products are allowed (no fastmath): a loop computes what its lines say, in their order,
and a NaN that goes in comes out. numba's cache watches only the file of the compiled function, so the helpers that a
loop calls stand in the same file. Importing this costs the import of numba: do it where it is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.core import types
from numba.core.options import DefaultOptions

from minidual.robot.pair import Array

VECTOR = types.float64[::1]
ROWS = types.float64[:, ::1]
BLOCKS = types.float64[:, :, ::1]
UNCOUNTED: dict[str, bool] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}
"""A private flag of numba: no counting of references to every array at every call, atomic operations that take five times
as long as the calls do. A numba without the flag compiles slower code that computes the same."""


def kernel(signature: Any = None) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles for one signature at import, or for each set of types at its first call."""

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return njit(signature, cache=True, error_model="numpy")(function)
        except RuntimeError as failure:  # numba has no class of its own for it
            if "cannot cache" not in str(failure):
                raise
            return njit(signature, error_model="numpy")(function)

    return compiled


def inlined(function: Callable[..., Any]) -> Any:
    """Compile what only kernels call, into their code; it must not allocate anything."""
    options: dict[str, Any] = {"error_model": "numpy", "forceinline": True, **UNCOUNTED}
    return njit(**options)(function)


def floats(x: Array) -> Array:
    """Return x as compiled code takes it: plain floats in one piece, which may be written (it does not)."""
    x = np.ascontiguousarray(x, dtype=float)
    return x if x.flags.writeable else x.copy()
