"""Worker processes with one numeric thread each. They end with the process that started them."""

from __future__ import annotations

import functools
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import joblib

_LOOK_S = 0.5


def in_workers[Item, Result](
    function: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Iterator[Result]:
    """Yield function(item) in the order of the items; with one worker, in this process."""
    # More than one numeric thread per process: they wait for each other on a busy machine.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    processes = min(workers, max(1, len(items)))
    yield from joblib.Parallel(n_jobs=processes, return_as="generator", batch_size=1)(
        joblib.delayed(_call)(os.getpid(), function, item) for item in items
    )


def _call[Item, Result](starter: int, function: Callable[[Item], Result], item: Item) -> Result:
    if os.getpid() != starter:
        _end_with(starter)
    return function(item)


@functools.cache
def _end_with(starter: int) -> None:
    """End this worker when its starter is gone: a killed starter cannot stop it."""

    def watch() -> None:
        while os.getppid() == starter:
            time.sleep(_LOOK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="end-with-starter").start()
