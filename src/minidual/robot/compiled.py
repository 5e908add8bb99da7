"""Compile numeric loops with numba, cached on disk if possible.

Without fastmath, operations keep their order and NaN propagates. Helpers share the kernel's file,
because numba's cache watches no other; after a change here or in `vectors.py` delete the
`__pycache__` folders.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numba import njit
from numba.core import types
from numba.core.options import DefaultOptions

from minidual.robot.kernel_cache import choose_folder
from minidual.robot.pair import Array

if "scipy.linalg" not in sys.modules:
    # numba's array functions import scipy.linalg (0.4 s) only to see whether it is installed, which
    # it is. Hide it during their import.
    cast(dict[str, Any], sys.modules)["scipy.linalg"] = None
    from numba.np import arraymath

    del sys.modules["scipy.linalg"]
    arraymath._HAVE_BLAS = True

choose_folder(Path(__file__).parent)

VECTOR = types.float64[::1]
VIEW = types.Array(types.float64, 1, "A", readonly=True)
ROWS = types.float64[:, ::1]
BLOCKS = types.float64[:, :, ::1]
UNCOUNTED: dict[str, bool] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}
"""Private numba flag: no reference counting.

It halves the time of a short call, and that of an inlined one is a fifth.
"""


def kernel(signature: Any = None, *, heap: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles for a signature at import, or at the first call.

    Args:
        signature: numba signature; None compiles at the first call.
        heap: Whether the function makes arrays, whose references must be counted.
    """
    counts_references = heap or signature is None
    options: dict[str, bool] = {} if counts_references else UNCOUNTED

    compiler = cast(Any, njit)  # its types do not know the private flag

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return compiler(signature, cache=True, error_model="numpy", **options)(function)
        except RuntimeError as failure:  # numba has no specific class for it
            if "cannot cache" not in str(failure):
                raise
            return compiler(signature, error_model="numpy", **options)(function)

    return compiled


def bound[T](function: Callable[..., T], *arguments: Any) -> Callable[[], T]:
    """Return a kernel's call with the same arguments each time.

    numba checks their types here, once; that check is half the time of a call.
    """
    function(*arguments)
    overloads = cast(Any, function).overloads.values()
    (compiled, *_) = overloads
    return partial(compiled.entry_point, *arguments)


def inlined(function: Callable[..., Any]) -> Any:
    """Return a function to inline into kernels; it must not allocate."""
    compiler = cast(Any, njit)
    return compiler(error_model="numpy", forceinline=True, **UNCOUNTED)(function)


def floats(x: Array) -> Array:
    """Return x as contiguous, writable floats."""
    x = np.ascontiguousarray(x, dtype=float)
    return x if x.flags.writeable else x.copy()
