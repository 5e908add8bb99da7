"""Compile numeric loops with numba, cached on disk if possible.

Without fastmath, operations keep their order and NaN propagates. Helpers share the kernel's file, because numba's cache
watches no other; after a change here or in `vectors.py` delete the `__pycache__` folders.
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
from numba import njit
from numba.core import types
from numba.core.options import DefaultOptions

from minidual.robot.pair import Array

if "scipy.linalg" not in sys.modules:
    # numba's array functions import scipy.linalg (0.4 s) only to see whether it is there, which it is. Hide it meanwhile.
    cast(dict[str, Any], sys.modules)["scipy.linalg"] = None
    from numba.np import arraymath

    del sys.modules["scipy.linalg"]
    arraymath._HAVE_BLAS = True

VECTOR = types.float64[::1]
VIEW = types.Array(types.float64, 1, "A", readonly=True)
ROWS = types.float64[:, ::1]
BLOCKS = types.float64[:, :, ::1]
UNCOUNTED: dict[str, bool] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}
"""Private numba flag: no reference counting, half of a short call's time and five times that of an inlined one."""


def kernel(signature: Any = None, *, heap: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Compile for a signature at import, or lazily. `heap`: it makes arrays, whose references must be counted."""
    options: dict[str, Any] = {
        "error_model": "numpy",
        **({} if heap or signature is None else UNCOUNTED),
    }

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return njit(signature, cache=True, **options)(function)
        except RuntimeError as failure:  # numba has no specific class for it
            if "cannot cache" not in str(failure):
                raise
            return njit(signature, **options)(function)

    return compiled


def bound[T](function: Callable[..., T], *arguments: Any) -> Callable[[], T]:
    """Return a kernel's call with the same arguments each time; numba's check of their types, half of it, is made now."""
    function(*arguments)
    compiled = cast(Any, function).overloads.values()
    return partial(next(iter(compiled)).entry_point, *arguments)


def inlined(function: Callable[..., Any]) -> Any:
    """Inline into kernels; must not allocate."""
    options: dict[str, Any] = {"error_model": "numpy", "forceinline": True, **UNCOUNTED}
    return njit(**options)(function)


def floats(x: Array) -> Array:
    """Return x as contiguous, writable floats."""
    x = np.ascontiguousarray(x, dtype=float)
    return x if x.flags.writeable else x.copy()
