"""The two ports of a link: their energy flows, and the controllers that keep them passive.

Sources: Hannaford and Ryu, "Time-domain passivity control of haptic interfaces" (2002); the
two-port form of Ryu, Artigas and Preusche (2010); drift as in arXiv 1909.01603. Arrays are
(..., G, n): G groups of n coordinates, each group with an energy of its own. docs/link.md explains.
"""

from dataclasses import dataclass

import numpy as np

from minidual.robot.pair import Array

_TINY = 1e-12


@dataclass(frozen=True)
class Bounds:
    """Properties of both ends of a link, and bounds of the controllers' corrections.

    Units are those of a group: N and m, or Nm and rad.

    Attributes:
        inertia: Least of a leader [kg or kg m^2]: a force moves it within a step.
        damping: Most force per speed that repays a deficit.
        speed: Of the motion that repays a deficit.
        yielding: Most speed per force of the same.
        drift_speed: Of the motion that takes back drift.
        drift_lag_s: Time constant of taking back drift.
        slack_j: Energy that may flow out in advance, so that motion can begin.
    """

    inertia: Array | float
    damping: Array | float
    speed: Array | float
    yielding: Array | float
    drift_speed: Array | float
    drift_lag_s: float = 0.2
    slack_j: float = 0.004


def power(force: Array, motion: Array) -> Array:
    """Return the work (..., G) of forces along motions (..., G, n)."""
    return np.einsum("...i,...i->...", force, motion)


def _along(values: Array, other: Array) -> tuple[Array, Array]:
    """Return the size (..., G) of values (..., G, n), and their direction; without one, the other's."""
    size = np.sqrt(power(values, values))
    other_size = np.sqrt(power(other, other))
    has_direction = (size > _TINY)[..., None]
    unit = np.where(
        has_direction,
        values / np.maximum(size, _TINY)[..., None],
        other / np.maximum(other_size, _TINY)[..., None],
    )
    return size, unit


class PortEnergy:
    """Energies (..., G) [J] that went through a port.

    Attributes:
        into: What flowed into the link here; never falls.
        out: What flowed out of it here; never falls.
        dissipated: What the controller took away here; never falls.
        received: The most that the other port has told to have taken in; never falls.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.into = np.zeros(shape)
        self.out = np.zeros(shape)
        self.dissipated = np.zeros(shape)
        self.received = np.zeros(shape)

    def flow(self, work: Array, corrected: Array) -> None:
        """Count the energy that a step put into the link (..., G); negative: took out.

        Args:
            work: By what the other port asked for.
            corrected: What the controller changed of it; beyond the work it is dissipated, and not
                told to the other port.
        """
        net = work + corrected
        inward = np.maximum(net, 0.0)
        carried = np.minimum(inward, np.maximum(work, 0.0))
        self.into += carried
        self.dissipated += inward - carried
        self.out += np.maximum(-net, 0.0)

    def receive(self, energy: Array) -> None:
        """Take the energy that the other port reports to have taken in; packets may come in any order."""
        self.received = np.maximum(self.received, energy)

    @property
    def observed(self) -> Array:
        """Energy that may still flow out here; below zero the link has generated energy."""
        return self.received - self.out + self.dissipated


class Port:
    """Base of both ports: an energy, and a controller that keeps the port passive.

    Args:
        shape: (..., G, n).
        dt_s: Period of a step.
        bounds: Of what the controller adds.
        passive: False only observes; one value, or (..., G).

    Attributes:
        energy: That went through the port.
        correction: What the controller adds in the coming step (..., G, n).
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        dt_s: float,
        bounds: Bounds,
        *,
        passive: Array | bool = True,
    ) -> None:
        self.energy = PortEnergy(shape[:-1])
        self.correction: Array = np.zeros(shape)
        self._dt_s = dt_s
        self._bounds = bounds
        self._passive = np.broadcast_to(passive, shape[:-1])
        self._force = np.zeros(shape)


class ImpedancePort(Port):
    """The leader's port: it moves, and the link gives it a force.

    The controller takes away the share of the force that would do more work on the leader than the
    arms have sent, and damps to repay a deficit. What it adds is a force.
    """

    def step(self, moved: Array, force: Array, far_energy: Array) -> Array:
        """Return the force (..., G, n) against the leader in the coming step.

        Args:
            moved: What the leader moved in the last step; the last force belongs to it.
            force: That the other port sent.
            far_energy: (..., G) that the other port tells to have taken in.
        """
        self.energy.receive(far_energy)
        self.energy.flow(power(self._force, moved), power(self.correction, moved))
        self._force = np.array(force)
        self.correction = self._corrected(force, moved)
        return force + self.correction

    def _corrected(self, force: Array, moved: Array) -> Array:
        if not self._passive.any():
            return np.zeros_like(force)
        distance, unit = _along(moved, force)
        onward = -power(force, unit)
        across = force + onward[..., None] * unit
        # x onward moves the leader on by give x within the step: x distance + give x^2 flows out.
        give = self._dt_s**2 / self._bounds.inertia
        energy = self.energy.observed + self._bounds.slack_j - give * power(across, across)
        root = np.sqrt(np.maximum(distance**2 + 4.0 * give * energy, 0.0))
        least = (-distance - root) / (2.0 * give)
        most = (-distance + root) / (2.0 * give)
        # The deficit that damping beyond its bound would repay is carried on.
        most = np.maximum(most, -self._bounds.damping * distance / self._dt_s)
        bounded = np.clip(onward, np.minimum(least, most), most)
        return np.where(self._passive, onward - bounded, 0.0)[..., None] * unit


class AdmittancePort(Port):
    """The arms' port: the link moves their reference, and they answer with a force.

    The controller takes away the share of the motion that would do more work on the arms than the
    leader has sent, and moves along the force to repay a deficit. What the reference lost by this is
    taken back while there is energy for it. What the controller adds is a motion.

    Args:
        shape: (..., G, n).
        dt_s: Period of a step.
        bounds: Of what the controller adds.
        passive: False only observes; one value, or (..., G).
        compensates: Whether drift is taken back; one value, or (..., G).
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        dt_s: float,
        bounds: Bounds,
        *,
        passive: Array | bool = True,
        compensates: Array | bool = True,
    ) -> None:
        super().__init__(shape, dt_s, bounds, passive=passive)
        self._compensates = np.broadcast_to(compensates, shape[:-1]) & self._passive
        self._motion = np.zeros(shape)

    def step(self, wanted: Array, drift: Array, force: Array, far_energy: Array) -> Array:
        """Return how the reference moves (..., G, n) in the coming step.

        Args:
            wanted: The motion that the leader asks for.
            drift: What the reference lacks of where it should be.
            force: With which the arms were driven in the last step, towards the reference; the last
                motion belongs to it.
            far_energy: (..., G) that the other port tells to have taken in.
        """
        self.energy.receive(far_energy)
        self.energy.flow(-power(force, self._motion), -power(force, self.correction))
        expected = 2.0 * force - self._force
        self._force = np.array(force)
        correction = self._corrected(wanted, expected)
        added = self._added(wanted + correction, drift, expected)
        self._motion = wanted + added
        self.correction = correction
        return self._motion + correction

    def _corrected(self, wanted: Array, force: Array) -> Array:
        if not self._passive.any():
            return np.zeros_like(wanted)
        size = np.sqrt(power(force, force))
        has_force = size > _TINY
        divisor = np.maximum(size, _TINY)
        unit = force / divisor[..., None]
        onward = power(wanted, unit)
        energy = self.energy.observed + self._bounds.slack_j
        speed = np.minimum(self._bounds.speed, self._bounds.yielding * size)
        # The deficit that a faster motion would repay is carried on.
        most = np.maximum(energy / divisor, -speed * self._dt_s)
        change = np.minimum(most - onward, 0.0)
        return np.where(has_force & self._passive, change, 0.0)[..., None] * unit

    def _added(self, motion: Array, drift: Array, force: Array) -> Array:
        """Return the motion that takes back drift, as far as there is energy beyond the motion's.

        Motion against the drift takes it back by standing still, which costs nothing.
        """
        if not self._compensates.any():
            return np.zeros_like(motion)
        size = np.sqrt(power(drift, drift))
        unit = drift / np.maximum(size, _TINY)[..., None]
        returning = np.clip(-power(motion, unit), 0.0, size)
        size = size - returning
        share = np.minimum(size / self._bounds.drift_lag_s, self._bounds.drift_speed) * self._dt_s
        kept = motion + returning[..., None] * unit
        surplus = self.energy.observed - np.maximum(power(force, kept), 0.0)
        cost = share * power(force, unit)
        affordable = np.clip(surplus / np.maximum(cost, _TINY), 0.0, 1.0)
        onward = share * np.where(cost > _TINY, affordable, 1.0)
        return np.where(self._compensates, returning + onward, 0.0)[..., None] * unit
