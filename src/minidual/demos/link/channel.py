"""One direction of a simulated network."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from minidual.config.link import SimulatedNetwork
from minidual.robot.pair import Array

_HELD_BACK_S = 0.02
"""A reordered packet takes twice its way and so much longer."""
_SPARE_STEPS = 2
_DRAWN_STEPS = 256
"""Steps drawn at once: a call of the generator costs more than its numbers."""


class Channel:
    """Carries a packet a step; the newest that has arrived counts.

    Packets that arrive after a newer one are dropped and counted. Many channels run side by side,
    each with a network of its own.

    Args:
        networks: One a channel (B).
        dt_s: Period of a step.
        rng: Draws delays and losses.
        first: Packet (B, F) that counts until one has arrived.

    Attributes:
        lost_n: Packets lost (B,).
        late_n: Packets dropped (B,), because a newer one had arrived.
    """

    def __init__(
        self,
        networks: Sequence[SimulatedNetwork],
        dt_s: float,
        rng: np.random.Generator,
        first: Array,
    ) -> None:
        self._rng = rng
        self._each = np.arange(len(networks))
        self._way_steps = np.array([0.5 * network.delay / dt_s for network in networks])
        self._jitter_steps = np.array([0.5 * network.jitter / dt_s for network in networks])
        self._loss = np.array([network.loss for network in networks])
        self._reorder = np.array([network.reorder for network in networks])
        self._held_steps = self._way_steps + _HELD_BACK_S / dt_s * (self._reorder > 0.0)
        longest = np.max(self._way_steps + self._jitter_steps + self._held_steps)
        self._slots = int(longest) + _SPARE_STEPS
        self._sent = np.zeros((self._slots, *first.shape))
        self._arriving = np.full((self._slots, len(networks)), -1)
        """Number of the newest packet that arrives in a step, by step and channel; -1 for none."""
        self._newest = np.full(len(networks), -1)
        self._received = np.array(first, dtype=float)
        self._k = 0
        self.lost_n = np.zeros(len(networks), dtype=int)
        self.late_n = np.zeros(len(networks), dtype=int)

    def exchange(self, packets: Array) -> Array:
        """Send packets (B, F); return those (B, F) that count at the other end in this step."""
        k = self._k
        slot = k % self._slots
        self._sent[slot] = packets
        steps, is_lost = self._drawn()
        arrival = (k + steps) % self._slots
        sequence = np.where(is_lost, -1, k)
        # The newest of those that arrive together counts: it was sent last.
        overtaken = (self._arriving[arrival, self._each] >= 0) & ~is_lost
        self._arriving[arrival, self._each] = np.maximum(
            self._arriving[arrival, self._each],
            sequence,
        )
        arrived = self._arriving[slot].copy()
        self._arriving[slot] = -1
        is_new = arrived > self._newest
        self.lost_n += is_lost
        self.late_n += overtaken | ((arrived >= 0) & ~is_new)
        self._newest = np.where(is_new, arrived, self._newest)
        fresh = self._each[is_new]
        self._received[fresh] = self._sent[arrived[fresh] % self._slots, fresh]
        self._k += 1
        return self._received

    def _drawn(self) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        """Return how many steps the packets of a step take (B,), and whether they are lost (B,)."""
        turn = self._k % _DRAWN_STEPS
        if turn == 0:
            self._steps, self._is_lost = self._draw()
        return self._steps[turn], self._is_lost[turn]

    def _draw(self) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        shape = (_DRAWN_STEPS, len(self._each))
        change = self._jitter_steps * self._rng.uniform(-1.0, 1.0, shape)
        held = self._held_steps * (self._rng.random(shape) < self._reorder)
        steps = np.rint(np.maximum(self._way_steps + change, 0.0) + held).astype(int)
        return np.minimum(steps, self._slots - 1), self._rng.random(shape) < self._loss
