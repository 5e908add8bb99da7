"""Compile a numeric loop once, when its module is imported, and keep the machine code on disk.

Neither reassociation nor fused products are allowed (no fastmath): a loop computes what its lines say, in their order,
and a NaN that goes in comes out. numba's cache watches only the file of the compiled function, so the helpers that a
loop calls stand in the same file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot.constants import Array

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


def floats(x: Array) -> Array:
    """Return x as compiled code takes it: plain floats in one piece, which may be written (it does not)."""
    x = np.ascontiguousarray(x, dtype=float)
    return x if x.flags.writeable else x.copy()
