"""Plays chunks of actions one after the other: blended, and as late as their answers come."""

import numpy as np

from minidual.robot.pair import Array


class ChunkQueue:
    """The chunk that is played, and one that is on its way.

    A chunk belongs to the moment of the look that it answers. If the answer takes some ticks, the
    chunk before is played on meanwhile (its last action is held when it ends), and the first actions
    of the new one are skipped: their time is over.

    Args:
        steps: Actions of a chunk after which the next look is due.
        blend_ticks: Ticks over which a new chunk replaces the old one.
    """

    def __init__(self, steps: int, blend_ticks: int) -> None:
        self._steps = steps
        self._blend_ticks = blend_ticks
        self.reset()

    def reset(self) -> None:
        """Drop all chunks."""
        self._chunk: Array | None = None
        self._old: Array | None = None
        self._cursor = 0
        self._played = 0
        self._coming: Array | None = None
        self._delay = 0
        self._waited = 0

    @property
    def is_due(self) -> bool:
        """Whether the policy should look now."""
        if self._coming is not None:
            return False
        return self._chunk is None or self._cursor >= self._steps

    def add(self, chunk: Array, delay_ticks: int) -> None:
        """Take the answer (chunk_size, dim) to the look of now, which comes some ticks later."""
        self._coming = chunk
        self._delay = delay_ticks
        self._waited = 0

    def next(self, hold: Array) -> Array:
        """Return this tick's action (dim,); `hold` as long as there is no chunk."""
        coming = self._coming
        if coming is not None and self._waited >= self._delay:
            self._old = self._remainder()
            self._chunk = coming
            self._cursor = self._delay
            self._played = 0
            self._coming = None
        self._waited += 1
        if self._chunk is None:
            return hold
        action = self._blended(self._chunk[min(self._cursor, len(self._chunk) - 1)])
        self._cursor += 1
        self._played += 1
        return action

    def _remainder(self) -> Array | None:
        """Return the actions of the present chunk that are blended with the next one."""
        if self._chunk is None:
            return self._old
        left = self._chunk[self._cursor :]
        if len(left):
            return left
        # Without overlap the last action is held while the new chunk is blended in.
        return np.repeat(self._chunk[-1:], self._blend_ticks, axis=0)

    def _blended(self, action: Array) -> Array:
        """Return the action mixed with that of the old chunk, in the first ticks of a new one."""
        if self._old is None or self._played >= min(self._blend_ticks, len(self._old)):
            return action
        share = (self._played + 1) / (self._blend_ticks + 1)
        return share * action + (1 - share) * self._old[self._played]
