"""Forks of the test's process that run one function."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from typing import Any


def fork_child(body: Callable[..., object], *args: Any) -> int:
    """Run body(*args) in a fork of this process, and return its process number.

    The fork exits with 0 if the function returns, with 1 and a traceback if it raises: it never
    comes back into pytest, of which it is a copy and would run the remaining tests a second time.
    """
    child = os.fork()
    if child:
        return child
    try:
        body(*args)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)
