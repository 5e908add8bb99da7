"""Worker processes with one numeric thread each.

They end with the process that started them, and leave Ctrl-C, SIGTERM and a closed terminal to it.
"""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing import resource_tracker

import joblib
from joblib.externals.loky import process_executor
from joblib.externals.loky.backend import resource_tracker as loky_tracker

from minidual import emergency

_LOOK_S = 0.2
_GROWTH_MAX_BYTES = 2_000_000_000
"""A worker that grows by more is replaced. By default 300 MB: so much is imported with the first policy."""


def in_workers[Item, Out](
    function: Callable[[Item], Out],
    items: Sequence[Item],
    workers: int,
) -> Iterator[Out]:
    """Yield function(item) in the order of the items; with one worker, in this process."""
    # More than one numeric thread per process: they wait for each other on a busy machine.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    processes = min(workers, max(1, len(items)))
    # Before the first item, which may take seconds to import what it needs.
    begin = {"initializer": _begin, "initargs": (os.getpid(),)} if processes > 1 else {}
    parallel = joblib.Parallel(n_jobs=processes, return_as="generator", batch_size=1, **begin)
    with _unsignalled_children():
        results = parallel(joblib.delayed(function)(item) for item in items)
    for result in results:
        emergency.check()
        yield result


@contextlib.contextmanager
def _unsignalled_children() -> Generator[None]:
    """Start processes that signals to their group do not reach: blocked signals are inherited."""
    signals = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        for tracker in (resource_tracker, loky_tracker):
            tracker.ensure_running()  # unblocks signals when it starts one
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(starter: int) -> None:
    os.environ.setdefault("LP_NUM_THREADS", "0")  # the software renderer uses the calling thread
    emergency.listen()
    process_executor._MAX_MEMORY_LEAK_SIZE = _GROWTH_MAX_BYTES  # pyright: ignore[reportPrivateUsage]

    def watch() -> None:
        while os.getppid() == starter:
            time.sleep(_LOOK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="end-with-starter").start()
