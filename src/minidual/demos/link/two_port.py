"""A link as a two-port: leader, network, arms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.config.link import SimulatedNetwork
from minidual.demos.link.channel import Channel
from minidual.demos.link.ports import AdmittancePort, Bounds, ImpedancePort
from minidual.demos.link.spaces import Space
from minidual.robot.pair import Array

_SMOOTHING_S = 0.01
"""Time constant with which the arms follow the received place, so that jitter is no jerk."""


@dataclass(frozen=True)
class LinkSettings:
    """Settings of a link.

    Attributes:
        dt_s: Period of a step.
        bounds: Of both controllers.
        passive: Whether the controllers act; the energies are observed in any case. One value, or
            one a channel and group (B, G), as the next one.
        compensates: Whether drift is taken back.
    """

    dt_s: float
    bounds: Bounds
    passive: Array | bool = True
    compensates: Array | bool = True


class Link:
    """Links leaders to arms, over channels side by side (B).

    Each packet carries what its port measured, and the energy that has flowed in there.

    Args:
        networks: One a channel (B).
        space: What is carried.
        settings: Of both ports.
        rngs: Draw delays and losses: to the arms, and back.
        start: Place (B, P) of leader and arms.

    Attributes:
        leader_port: Where the leader moves.
        arms_port: Where the arms are driven.
        to_arms: The network to the arms.
        to_leader: The network back.
        reference: Place (B, P) to which the arms are driven.
    """

    def __init__(
        self,
        networks: Sequence[SimulatedNetwork],
        space: Space,
        settings: LinkSettings,
        rngs: tuple[np.random.Generator, np.random.Generator],
        start: Array,
    ) -> None:
        self._space = space
        still = space.between(start, start)
        shape = still.shape
        dt_s = settings.dt_s
        self.leader_port = ImpedancePort(shape, dt_s, settings.bounds, passive=settings.passive)
        self.arms_port = AdmittancePort(
            shape,
            dt_s,
            settings.bounds,
            passive=settings.passive,
            compensates=settings.compensates,
        )
        no_energy = np.zeros(shape[:-1])
        places_n = start.shape[-1]
        forces_n = shape[-2] * shape[-1]
        self._cut_to_arms = places_n
        self._cut_to_leader = forces_n
        self._shape = shape
        first_to_arms = np.concatenate([start, no_energy], axis=-1)
        first_to_leader = np.concatenate([_flat(still), no_energy], axis=-1)
        self.to_arms = Channel(networks, dt_s, rngs[0], first_to_arms)
        self.to_leader = Channel(networks, dt_s, rngs[1], first_to_leader)
        self._follow_share = min(1.0, dt_s / _SMOOTHING_S)
        self._leader = np.array(start, dtype=float)
        self._seen = np.array(start, dtype=float)
        self._sent_back = first_to_leader
        self.reference = np.array(start, dtype=float)

    def step(self, leader: Array, force: Array) -> Array:
        """Advance a step; the arms are to go to `reference`.

        Args:
            leader: Place (B, P) of the leader.
            force: (B, G, n) with which the arms were driven towards the reference in the last step.

        Returns:
            The force (B, G, n) against the leader in the coming step.
        """
        against = self._leader_side(leader)
        self._arms_side(force)
        return against

    @property
    def drift(self) -> Array:
        """Difference (B, G, n) from the reference to the leader as it was last received."""
        return self._space.between(self.reference, self._seen)

    def _leader_side(self, leader: Array) -> Array:
        moved = self._space.between(self._leader, leader)
        self._leader = np.array(leader, dtype=float)
        received = self.to_leader.exchange(self._sent_back)
        force = received[:, : self._cut_to_leader].reshape(self._shape)
        return self.leader_port.step(moved, force, received[:, self._cut_to_leader :])

    def _arms_side(self, force: Array) -> None:
        sent = np.concatenate([self._leader, self.leader_port.energy.into], axis=-1)
        received = self.to_arms.exchange(sent)
        far_energy = received[:, self._cut_to_arms :]
        place = received[:, : self._cut_to_arms]
        drift = self.drift
        wanted = self._follow_share * self._space.between(self._seen, place)
        self._seen = self._space.moved(self._seen, wanted)
        motion = self.arms_port.step(wanted, drift, force, far_energy)
        self.reference = self._space.moved(self.reference, motion)
        self._sent_back = np.concatenate([_flat(force), self.arms_port.energy.into], axis=-1)


def _flat(values: Array) -> Array:
    return values.reshape(values.shape[0], -1)
