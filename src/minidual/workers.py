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
"""A worker that grows by more is replaced.

The library's limit is 300 MB; the first policy already imports as much.
"""


def processor_time_s() -> float:
    """Return the processor time of this process and of all that it has started [s].

    A process that has ended counts once somebody has waited for it.
    """
    import psutil  # takes 40 ms

    own = psutil.Process()
    total_s = 0.0
    for process in (own, *own.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            total_s += times.user + times.system + times.children_user + times.children_system
    return total_s


def in_workers[Item, Out](
    function: Callable[[Item], Out],
    items: Sequence[Item],
    workers: int,
) -> Iterator[Out]:
    """Yield function(item) in the order of the items; with one worker, in this process."""
    # With more numeric threads in a process they wait for each other on a busy machine.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    processes = min(workers, max(1, len(items)))
    parallel = _pool(processes)
    with _unsignalled_children():
        results = parallel(joblib.delayed(function)(item) for item in items)
    for result in results:
        emergency.check()
        yield result


def _pool(processes: int) -> joblib.Parallel:
    if processes == 1:
        return joblib.Parallel(n_jobs=1, return_as="generator", batch_size=1)
    return joblib.Parallel(
        n_jobs=processes,
        return_as="generator",
        batch_size=1,
        # Begins before the first item, which may take seconds to import what it needs.
        initializer=_begin,
        initargs=(os.getpid(),),
    )


@contextlib.contextmanager
def _unsignalled_children() -> Generator[None]:
    """Start processes that signals to their group do not reach: blocked signals are inherited."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
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
