"""A leader at the other end of a late and lossy network."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from minidual.config.leading import LinkConfig
from minidual.config.link import SimulatedNetwork
from minidual.config.seeds import stream
from minidual.control.tick_check import Violation
from minidual.demos.leader import LEADERS, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.link.channel import Channel
from minidual.demos.link.forces import Forces, HandForces, JointForces
from minidual.demos.link.ports import power
from minidual.demos.link.two_port import Link, LinkSettings
from minidual.demos.station import Button
from minidual.robot.pair import Array, Robot
from minidual.tasks.task import Trial


@dataclass(frozen=True)
class LinkTick:
    """Log of a link in a tick; arrays have a value a group (G,).

    Attributes:
        leader_j, arms_j: Observed energies of the ports.
        leader_acts, arms_act: Whether the controllers corrected anything.
        drift: By how much the arms' reference lacks of where the leader was seen [rad or m].
    """

    time_s: float
    leader_j: Array
    arms_j: Array
    leader_acts: Array
    arms_act: Array
    drift: Array


class LinkedLeader(Leader):
    """Puts a link between a leader and the arms.

    Targets travel to the arms and forces travel back; both ports are kept passive. Buttons arrive
    late, and none is lost: a real link sends them until they are acknowledged.

    Args:
        leader: Who leads.
        setup: Of the recording; `teleop.link` describes network and link.

    While time stands still, before the start and in a pause, the leader moves and the arms meet
    nothing: such readings cost no energy and are no ticks.

    Attributes:
        ticks: What the link did in this episode.
    """

    def __init__(self, leader: Leader, setup: LeaderSetup) -> None:
        self.leader = leader
        self.features = leader.features  # type: ignore[misc]
        self.usage = leader.usage  # type: ignore[misc]
        self._robot = setup.robot
        self._config = setup.config.link
        self._network = SimulatedNetwork.parse(self._config.network)
        self._seed = setup.seed
        self._dt_s = 1.0 / setup.config.rate_hz
        self._forces = _forces_of(leader, setup.robot)
        self.ticks: list[LinkTick] = []
        self._openings = np.ones(2)
        self._begin(0, setup.robot.home)

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Return `teleop.leader`, connected to its device, behind a link."""
        return cls(LEADERS[setup.config.leader].connect(setup), setup)

    @property
    def hint(self) -> str:
        """The leader's hint, and whether the link holds back."""
        shown = [self.leader.hint] if self.leader.hint else []
        if self.ticks and self.ticks[-1].arms_act.any():
            shown.append("the late link holds the arms back")
        return "; ".join(shown)

    @property
    def violation(self) -> Violation | None:
        """That the observed energy of a group has been under its bound for too long, or None."""
        patience = max(1, round(self._config.short_max_s / self._dt_s))
        if len(self.ticks) < patience:
            return None
        observed = np.array([np.minimum(t.leader_j, t.arms_j) for t in self.ticks[-patience:]])
        best = observed.max(axis=0)
        worst = int(np.argmin(best))
        if best[worst] >= self._config.energy_min_j:
            return None
        where = f"{self._forces.space.groups[worst]} for {self._config.short_max_s:g} s"
        return Violation("passivity", "", where, float(best[worst]), self._config.energy_min_j)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Begin a link with a new network for the trial."""
        self.leader.align(trial, q_follower)
        self._openings = np.ones(2)
        self._begin(trial.index, q_follower)

    def resume(self, q_follower: Array) -> None:
        """Lead on over the same network from arms at (n,) [rad]; hands keep their openings."""
        self.leader.resume(q_follower)
        ticks = self.ticks
        self._begin(self._index, q_follower)
        self.ticks = ticks

    @property
    def facts(self) -> Mapping[str, object]:
        """See `Leader`."""
        return self.leader.facts

    def read(self, now_s: float) -> LeaderSample | None:
        """Return the leader's reading that has arrived; None while it gives none."""
        sample = self.leader.read(now_s)
        if sample is None:
            return None
        place = self._forces.place_of(sample)
        if not np.isfinite(place).all():
            return sample  # is refused and named
        if self._waits:
            self._force = np.zeros_like(self._force)
        self._waits = True
        against = self._link.step(self._led(place, sample.clutch), self._force)
        self._against = against
        self._openings = self._grips.exchange(sample.openings[None])[0].copy()
        self._latest = self._tick(now_s)
        pressed = self._arrived(sample.pressed)
        sample = replace(sample, openings=self._openings.copy(), pressed=pressed)
        return self._forces.sample_at(self._link.reference, sample)

    def feedback(self, feedback: Feedback) -> None:
        """Keep the arms' force for the link; render the force that has come back over it."""
        self._waits = False
        if self._latest is not None:
            self.ticks.append(self._latest)
            self._latest = None
        self._force = self._forces.towards_reference(feedback)
        external_nm = self._forces.torques(self._against, feedback.q)
        self.leader.feedback(feedback._replace(external_nm=-external_nm))

    def close(self) -> None:
        """See `Leader`."""
        self.leader.close()

    def _begin(self, index: int, q_follower: Array) -> None:
        config = self._config
        self._index = index
        place = self._forces.place_at(q_follower)
        settings = LinkSettings(
            self._dt_s,
            self._forces.bounds,
            config.passive,
            config.takes_back_drift,
        )
        rngs = (
            stream(self._seed, "link/to arms", index),
            stream(self._seed, "link/to leader", index),
        )
        networks = [self._network]
        self._link = Link(networks, self._forces.space, settings, rngs, place)
        grips_rng = stream(self._seed, "link/grips", index)
        self._grips = Channel(networks, self._dt_s, grips_rng, self._openings[None].copy())
        self._force = np.zeros_like(self._link.drift)
        self._against = np.zeros_like(self._link.drift)
        self._place = place
        """The leader's position, with its motion while the clutch was held."""
        self._sent = place
        """The same without."""
        self._coming: deque[tuple[int, Button]] = deque()
        self._k = 0
        self._waits = True
        """Whether time has stood still since the last reading: no measurement of the arms has come."""
        self._latest: LinkTick | None = None
        self.ticks = []

    def _led(self, place: Array, clutch: bool) -> Array:
        """Return the place that is sent: it stands still while the clutch is held."""
        space = self._forces.space
        if not clutch:
            self._sent = space.moved(self._sent, space.between(self._place, place))
        self._place = place
        return self._sent

    def _arrived(self, pressed: tuple[Button, ...]) -> tuple[Button, ...]:
        way_s = 0.5 * (self._network.delay + self._network.jitter)
        due = self._k + int(np.ceil(way_s / self._dt_s - 1e-9))
        self._coming.extend((due, button) for button in pressed)
        arrived: list[Button] = []
        while self._coming and self._coming[0][0] <= self._k:
            arrived.append(self._coming.popleft()[1])
        self._k += 1
        return tuple(arrived)

    def _tick(self, now_s: float) -> LinkTick:
        link = self._link
        drift = link.drift[0]
        return LinkTick(
            time_s=now_s,
            leader_j=link.leader_port.energy.observed[0].copy(),
            arms_j=link.arms_port.energy.observed[0].copy(),
            leader_acts=link.leader_port.correction[0].any(axis=-1),
            arms_act=link.arms_port.correction[0].any(axis=-1),
            drift=np.sqrt(power(drift, drift)),
        )

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of `LinkTick`."""
        return self._forces.space.groups

    def measures(self) -> dict[str, float]:
        """Return {name: number} of the episode."""
        if not self.ticks:
            return {}
        energies = [min(t.leader_j.min(), t.arms_j.min()) for t in self.ticks]
        acts = [bool(t.leader_acts.any() or t.arms_act.any()) for t in self.ticks]
        return {
            "link_energy_min_j": float(min(energies)),
            "link_active_share": float(np.mean(acts)),
            "link_drift_max": float(max(t.drift.max() for t in self.ticks)),
            "link_drift_end": float(self.ticks[-1].drift.max()),
        }

    def rows(self) -> list[dict[str, float]]:
        """Return a row a tick, for a table."""
        rows: list[dict[str, float]] = []
        for tick in self.ticks:
            row = {"time_s": round(tick.time_s, 4)}
            for g, group in enumerate(self.groups):
                row[f"{group} leader_j"] = round(float(tick.leader_j[g]), 6)
                row[f"{group} arms_j"] = round(float(tick.arms_j[g]), 6)
                row[f"{group} leader_acts"] = float(tick.leader_acts[g])
                row[f"{group} arms_act"] = float(tick.arms_act[g])
                row[f"{group} drift"] = round(float(tick.drift[g]), 6)
            rows.append(row)
        return rows


def _forces_of(leader: Leader, robot: Robot) -> Forces:
    if leader.features.targets == "poses":
        return HandForces(robot)
    return JointForces(robot)


def linked(leader: Leader, setup: LeaderSetup) -> Leader:
    """Return the leader, behind a link if a network is configured."""
    config: LinkConfig = setup.config.link
    return LinkedLeader(leader, setup) if config.network else leader
