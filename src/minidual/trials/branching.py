"""Runs that branch: one run comes to a point, and any number of copies go on from there.

A copy is a fork of the process that made the run, so it begins with the whole state: simulation,
controllers, sensors, random streams. Nothing has to be saved or put back.

    forge -- a process that has made ready what all runs need; it starts
      trunk -- a run; where it comes to its branch point it waits, and makes
        copies, one at a time; each goes on, exchanges messages with whoever asked, and ends
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import socket
import traceback
import weakref
from collections.abc import Callable
from multiprocessing import reduction
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, NoReturn, Protocol

from minidual.errors import MinidualError

_ENDS_S = 5.0
"""Time after which a forge without requests ends."""


class BranchError(MinidualError):
    """A run, or a copy of it, broke."""


class Lost(NamedTuple):
    """A run ended before it came to its branch point."""

    reason: str


class _Ready(NamedTuple):
    """A run waits at its branch point."""


class _Broken(NamedTuple):
    trace: str


class Runs(Protocol):
    """The work of a forge; made in the forge's process from a picklable function."""

    def prepare(self, request: Any) -> None:
        """Prepare in the forge the parts that this run and later ones share."""
        ...

    def run(self, request: Any, branches: BranchPoint) -> str:
        """Run: call `branches.here()` at the branch point, then exchange messages as a copy.

        Returns:
            Why the run ended. It is told only where the run never came to its branch point.
        """
        ...


class BranchPoint:
    """Where a run branches, as the run sees it."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def here(self) -> None:
        """Wait as the trunk; return in each copy that is asked for."""
        self._pipe.send(_Ready())
        while True:
            try:
                self._pipe.recv()
            except EOFError:
                os._exit(0)
            copy = os.fork()
            if copy == 0:
                return
            code = os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])
            if code:
                self._pipe.send(_Broken(f"a copy ended with {code}"))

    def exchange(self, message: Any) -> Any:
        """Send a message, and return the answer; end the copy if the client is gone."""
        self.tell(message)
        try:
            return self._pipe.recv()
        except EOFError:
            os._exit(0)

    def tell(self, message: Any) -> None:
        """Send a message; end the copy if the client is gone."""
        try:
            self._pipe.send(message)
        except BrokenPipeError:
            os._exit(0)

    def end(self, message: Any) -> NoReturn:
        """Send the last message of a copy, and end it."""
        self.tell(message)
        os._exit(0)


class Trunk:
    """A run, as its clients see it."""

    def __init__(self, pipe: Connection) -> None:
        self.pipe = pipe
        self._ready = False
        self._lost: Lost | None = None

    def wait(self) -> Lost | None:
        """Wait until the run is at its branch point; return why it never came there.

        Raises:
            BranchError: It broke.
        """
        if self._ready:
            return self._lost
        message = self.receive()
        if isinstance(message, Lost):
            self._lost = message
        self._ready = True
        return self._lost

    def branch(self) -> None:
        """Ask for a copy; the last one must have ended."""
        self.send(None)

    def send(self, message: Any) -> None:
        """Answer the copy.

        Raises:
            BranchError: It is gone.
        """
        try:
            self.pipe.send(message)
        except OSError as error:
            raise BranchError("a run that is asked for a copy has ended") from error

    def receive(self) -> Any:
        """Return the next message of the run or of its copy.

        Raises:
            BranchError: It broke.
        """
        try:
            message = self.pipe.recv()
        except (EOFError, OSError) as error:
            raise BranchError("a run ended without a word: was its process killed?") from error
        if isinstance(message, _Broken):
            raise BranchError(f"a run broke:\n{message.trace}")
        return message

    def close(self) -> None:
        """End the run and its copy."""
        self.pipe.close()


class Forge:
    """Starts runs, all from one process that has made them ready.

    The process is a fresh one: it has none of the threads and libraries of the one that asks.

    Args:
        make: Module-level function that returns the runs; called in the forge.
        args: Picklable arguments of `make`.
    """

    def __init__(self, make: Callable[..., Runs], *args: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = _pair()
        process = context.Process(target=_forge, args=(theirs, make, args), daemon=True)
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        process.start()
        theirs.close()
        self._process = process
        self._finalizer = weakref.finalize(self, _end, self._pipe, process)

    def start(self, request: Any) -> Trunk:
        """Start a run; return at once.

        Raises:
            BranchError: The forge broke.
        """
        ours, theirs = _pair()
        pid = self._process.pid
        if pid is None:
            raise BranchError("the process that starts runs does not exist")
        try:
            self._pipe.send(request)
            reduction.send_handle(self._pipe, theirs.fileno(), pid)
        except OSError as error:
            raise BranchError("the process that starts runs has ended") from error
        finally:
            theirs.close()
        return Trunk(ours)

    def close(self) -> None:
        """End the process; runs end when their trunks are closed."""
        self._finalizer()


class Trunks:
    """Trunks by request: those that were given back are kept, and used again.

    Args:
        forge: Starts what is not kept.
    """

    def __init__(self, forge: Forge) -> None:
        self._forge = forge
        self._kept: dict[Any, Trunk] = {}

    def start(self, request: Any) -> Trunk:
        """Return the trunk of a hashable request."""
        if request in self._kept:
            return self._kept.pop(request)
        return self._forge.start(request)

    def keep(self, request: Any, trunk: Trunk) -> None:
        """Take back a trunk whose latest copy has ended, or which did not reach its branch point."""
        self._kept[request] = trunk


def _pair() -> tuple[Connection, Connection]:
    """Return both ends of a connection that a process can be sent over another one."""
    ours, theirs = socket.socketpair()
    return Connection(ours.detach()), Connection(theirs.detach())


def _end(pipe: Connection, process: Any) -> None:
    pipe.close()
    process.join(_ENDS_S)
    if process.is_alive():
        process.terminate()
        process.join()


def _forge(pipe: Connection, make: Callable[..., Runs], args: tuple[Any, ...]) -> None:
    """Start runs until no more are requested."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asks ends it
    signal.signal(signal.SIGCHLD, _wait_for_ended)
    runs = make(*args)
    while True:
        try:
            request = pipe.recv()
            handle = reduction.recv_handle(pipe)
        except EOFError:
            return
        own = Connection(handle)
        try:
            runs.prepare(request)
        except Exception:
            own.send(_Broken(traceback.format_exc()))
            own.close()
            continue
        if os.fork() == 0:
            pipe.close()
            _grow(runs, request, own)
        own.close()


def _wait_for_ended(_number: int, _frame: Any) -> None:
    """Wait for the runs that have ended: they leave no zombies, and their processor time counts."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass


def _grow(runs: Runs, request: Any, pipe: Connection) -> NoReturn:
    """Run as a trunk, and as each of its copies."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    message: Lost | _Broken
    try:
        message = Lost(runs.run(request, BranchPoint(pipe)))
    except BaseException:
        message = _Broken(traceback.format_exc())
    with contextlib.suppress(OSError):
        pipe.send(message)
    os._exit(0)
