"""One long run from which many tests branch off: each disturbs a copy of it at one of its instants.

The copies are forks of a process that has come that far. A test body runs in its own copy, so it may
change anything there: nothing is put back.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, Pipe
from typing import Any

from tests.support.children import fork_child


class Branches[State, Point]:
    """A run and its copies; a context manager.

    Args:
        start: Makes the run.
        step: Advances it.
        reached: Whether a run that has come to its next step has reached a point.
        points: Where tests branch off; each must be reached.
    """

    def __init__(
        self,
        start: Callable[[], State],
        step: Callable[[State], None],
        reached: Callable[[State, Point], bool],
        points: Sequence[Point],
    ) -> None:
        pipes = {point: Pipe() for point in points}
        self._ours = {point: ours for point, (ours, _) in pipes.items()}

        def grow() -> None:
            for ours, _ in pipes.values():
                ours.close()
            _grow(start(), step, reached, {point: theirs for point, (_, theirs) in pipes.items()})

        self._trunk = fork_child(grow)
        for _, theirs in pipes.values():
            theirs.close()

    def run(self, point: Point, body: Callable[..., None], *args: Any) -> None:
        """Run body(state, *args) in a copy of the run at a point; what it asserts is asserted here.

        Body and arguments are pickled: module-level functions and plain values.
        """
        pipe = self._ours[point]
        pipe.send((body, args))
        failure = pipe.recv()
        assert failure is None, failure

    def __enter__(self) -> Branches[State, Point]:
        return self

    def __exit__(self, *_: object) -> None:
        for pipe in self._ours.values():
            pipe.close()
        os.waitpid(self._trunk, 0)


def _grow[State, Point](
    state: State,
    step: Callable[[State], None],
    reached: Callable[[State, Point], bool],
    pipes: dict[Point, Connection],
) -> None:
    """Run once past all points and leave a copy that waits at each."""
    while pipes:
        for point in [point for point in pipes if reached(state, point)]:
            pipe = pipes.pop(point)
            if os.fork() == 0:
                for other in pipes.values():
                    other.close()
                _wait(state, pipe)
            pipe.close()
        step(state)


def _wait(state: Any, pipe: Connection) -> None:
    """Run each body that comes in a copy of this copy, until nobody asks any more."""
    while True:
        try:
            body, args = pipe.recv()
        except EOFError:
            os._exit(0)
        child = os.fork()
        if child == 0:
            try:
                body(state, *args)
                pipe.send(None)
            except BaseException:
                pipe.send(traceback.format_exc())
            os._exit(0)
        if code := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
            pipe.send(f"the copy ended with {code}")
