"""Rooms that the cameras see, one after the other."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from types import TracebackType


class RoomTour(AbstractContextManager["RoomTour"]):
    """Shows the cameras one room after the other.

    Args:
        show: Returns the context of a turn's room.
        ticks_each: Ticks after which the room changes; 0: never.
    """

    def __init__(
        self,
        show: Callable[[int], AbstractContextManager[None]],
        ticks_each: int,
    ) -> None:
        self._show = show
        self._ticks_each = ticks_each
        self._ticks = 0
        self._shown = ExitStack()

    def __enter__(self) -> "RoomTour":
        self._shown.enter_context(self._show(0))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._shown.__exit__(kind, error, traceback)

    def tick(self) -> None:
        """Count a tick; change the room if it is due."""
        self._ticks += 1
        if self._ticks_each and self._ticks % self._ticks_each == 0:
            self._shown.close()
            self._shown.enter_context(self._show(self._ticks // self._ticks_each))
