"""The link makes no energy, whatever is at its ends and in its network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.config.link import SimulatedNetwork
from minidual.config.seeds import stream
from minidual.demos.link.ports import Bounds, PortEnergy
from minidual.demos.link.spaces import Coordinates, HandPoses
from minidual.demos.link.two_port import Link, LinkSettings
from minidual.robot.pair import Array

DT_S = 0.001
BOUNDS = Bounds(inertia=0.4, damping=100.0, speed=0.2, yielding=0.01, drift_speed=0.2)
ENERGY_MIN_J = -0.01
_STEPS_N = 1000

networks = st.builds(
    SimulatedNetwork,
    delay=st.floats(0.0, 0.7),
    jitter=st.floats(0.0, 0.04),
    loss=st.floats(0.0, 0.1),
    reorder=st.floats(0.0, 0.05),
)


def made_link(
    network: SimulatedNetwork, *, passive: bool = True, seed: int = 0, n: int = 1
) -> Link:
    """Return a link of one group of n coordinates."""
    settings_of_link = LinkSettings(DT_S, BOUNDS, passive, compensates=passive)
    rngs = stream(seed, "to arms"), stream(seed, "to leader")
    space = Coordinates(("all",), n)
    return Link([network], space, settings_of_link, rngs, np.zeros((1, n)))


def driven(
    link: Link,
    stiffness_n_m: float,
    wall_m: float,
    reach_m: float,
    after_step: Callable[[Link], None] = lambda link: None,
) -> float:
    """Let a passive hand push a mass into a spring beyond a wall; return the least observed energy.

    The hand is a spring and a damper whose end moves, the arms are a mass behind another spring.
    """
    x = v = y = w = felt = 0.0
    least = 0.0
    for k in range(_STEPS_N):
        against = link.step(np.array([[x]]), np.array([[[felt]]]))[0, 0, 0]
        reference = link.reference[0, 0]
        met = stiffness_n_m * max(y - wall_m, 0.0)
        w += DT_S / 2.0 * (2000.0 * (reference - y) - 120.0 * w - met)
        y += DT_S * w
        felt += DT_S / 0.012 * (met - felt)
        meant = reach_m * np.sin(2.0 * np.pi * k * DT_S)
        v += DT_S / 0.6 * (200.0 * (meant - x) - 8.0 * v - against)
        x += DT_S * v
        energies = [link.leader_port.energy.observed.min(), link.arms_port.energy.observed.min()]
        least = min(least, *map(float, energies))
        after_step(link)
    return least


@settings(max_examples=8)
@given(
    network=networks,
    stiffness_n_m=st.floats(100.0, 90e3),
    wall_m=st.floats(0.0, 0.03),
    reach_m=st.floats(0.01, 0.08),
    seed=st.integers(0, 1000),
)
def test_observed_energy_stays_above_its_bound(
    network: SimulatedNetwork,
    stiffness_n_m: float,
    wall_m: float,
    reach_m: float,
    seed: int,
) -> None:
    link = made_link(network, seed=seed)
    assert driven(link, stiffness_n_m, wall_m, reach_m) >= ENERGY_MIN_J


def test_without_controllers_the_link_makes_energy() -> None:
    link = made_link(SimulatedNetwork(delay=0.2), passive=False)
    assert driven(link, 20e3, 0.01, 0.05) < -1.0


@settings(max_examples=3)
@given(network=networks, seed=st.integers(0, 1000))
def test_sums_of_energy_never_fall(network: SimulatedNetwork, seed: int) -> None:
    """Under loss and reordering too, `received` included."""
    sums = [np.zeros(8)]

    def note(link: Link) -> None:
        now: list[float] = []
        for port in (link.leader_port, link.arms_port):
            energy = port.energy
            now += [
                float(values.max())
                for values in (energy.into, energy.out, energy.dissipated, energy.received)
            ]
        assert np.all(np.array(now) >= sums[0])
        sums[0] = np.array(now)

    driven(made_link(network, seed=seed), 20e3, 0.01, 0.05, note)
    assert sums[0].max() > 0.0


def test_an_old_packet_takes_no_energy_back() -> None:
    energy = PortEnergy((1,))
    energy.receive(np.array([2.0]))
    energy.receive(np.array([1.0]))
    assert energy.received[0] == 2.0


def test_dissipated_energy_is_credited_here_and_not_told_to_the_other_port() -> None:
    energy = PortEnergy((1,))
    energy.flow(np.array([1.0]), np.array([0.5]))
    assert (energy.into[0], energy.out[0], energy.dissipated[0]) == (1.0, 0.0, 0.5)
    energy.flow(np.array([-1.0]), np.array([0.25]))
    assert (energy.into[0], energy.out[0], energy.dissipated[0]) == (1.0, 0.75, 0.5)


def test_free_motion_is_not_held_up_and_drifts_nowhere() -> None:
    link = made_link(SimulatedNetwork(delay=0.1), n=3)
    place = np.zeros((1, 3))
    for k in range(2000):
        place = np.full((1, 3), 0.1 * np.sin(min(k, 1500) * DT_S))
        link.step(place, np.zeros((1, 1, 3)))
    assert np.abs(link.reference - place).max() < 1e-6
    assert not link.arms_port.correction.any()


def test_drift_is_taken_back_where_that_costs_nothing() -> None:
    """A wall stops the reference for lack of energy; away from it, leader and arms agree again."""
    link = made_link(SimulatedNetwork(delay=0.2))
    drifts: list[float] = []
    for k in range(4000):
        x = 0.05 * np.sin(np.pi * min(k / 3000.0, 1.0))
        felt = 20e3 * max(float(link.reference[0, 0]) - 0.01, 0.0)
        link.step(np.array([[x]]), np.array([[[felt]]]))
        drifts.append(abs(float(link.drift[0, 0, 0])))
    assert max(drifts) > 0.02
    assert drifts[-1] < 1e-4


def test_damping_is_bounded_and_the_rest_of_a_deficit_is_carried_on() -> None:
    link = made_link(SimulatedNetwork())
    port = link.leader_port
    port.energy.out += 5.0
    moved = np.full((1, 1, 1), 1e-3)
    force = port.step(moved, np.zeros((1, 1, 1)), np.zeros((1, 1)))
    assert 0.0 < force[0, 0, 0] <= BOUNDS.damping * 1e-3 / DT_S + 1e-9
    port.step(moved, np.zeros((1, 1, 1)), np.zeros((1, 1)))
    assert port.energy.observed[0, 0] < -4.0
    assert port.energy.dissipated[0, 0] > 0.0


def test_translation_and_rotation_of_hands_have_energies_of_their_own() -> None:
    bounds = Bounds(
        inertia=np.array([0.5, 0.01, 0.5, 0.01]),
        damping=np.array([50.0, 1.0, 50.0, 1.0]),
        speed=np.array([0.2, 0.5, 0.2, 0.5]),
        yielding=np.array([0.01, 0.5, 0.01, 0.5]),
        drift_speed=np.array([0.2, 0.5, 0.2, 0.5]),
    )
    start = np.tile(np.eye(4), (2, 1, 1)).reshape(1, 32)
    rngs = stream(0, "to arms"), stream(0, "to leader")
    link = Link([SimulatedNetwork()], HandPoses(), LinkSettings(DT_S, bounds), rngs, start)
    forces = np.zeros((1, 4, 3))
    forces[0, 0, 0] = 5.0
    moving = HandPoses()
    motion = np.zeros((1, 4, 3))
    motion[0, 0, 0] = 1e-4
    motion[0, 1, 2] = 1e-4
    place = start
    for _ in range(500):
        place = moving.moved(place, motion)
        link.step(place, forces)
    into = link.leader_port.energy.into[0]
    assert into[0] > 0.1
    assert into[1:].tolist() == [0.0, 0.0, 0.0]
    rotated: Array = link.reference.reshape(2, 4, 4)
    assert np.abs(rotated - place.reshape(2, 4, 4))[0, :3, :3].max() < 1e-3
