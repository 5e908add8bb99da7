"""One joint that a hand leads over a late network against a wall of 90 kN/m, many at a time.

Distances are those of the joint's tip. A passive hand (a spring and a damper on the way to where it
means to be) holds the leader. The follower is driven by a spring and a damper towards the link's
reference; the force at its port is what it meets, filtered as by the observer of contacts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from minidual.config.link import SimulatedNetwork
from minidual.config.seeds import stream
from minidual.demos.link.ports import Bounds
from minidual.demos.link.spaces import Coordinates
from minidual.demos.link.two_port import Link, LinkSettings
from minidual.robot.pair import Array

DT_S = 1e-3
WALL_N_PER_M = 90e3
WALL_M = 0.05
"""Where the wall stands; leader and follower begin at 0."""
FOLLOWER_KG = 2.0
FOLLOWER_DAMPING = 2.0
DRIVE_N_PER_M = 2000.0
DRIVE_N_S_PER_M = 120.0
FELT_LAG_S = 0.012
"""Time constant of the estimate of the force met: `control.observer.FILTER_S`."""
FELT_LEAST_N = 0.3
"""Forces below this are noise of the estimate."""
FORCE_MAX_N = 60.0
"""Of the follower's drive."""
LEADER_DAMPING = 1.0
BOUNDS = Bounds(inertia=0.4, damping=100.0, speed=0.2, yielding=0.01, drift_speed=0.2)
_ESCAPED_M = 1.0
"""A leader this far away has run away: it is held there."""


@dataclass(frozen=True)
class Arm:
    """One of the ways to answer a late network.

    Attributes:
        damping: Added to every leader [N s/m].
        passive: Whether the link's controllers act.
        compensates: Whether drift is taken back.
    """

    name: str
    damping: float = 0.0
    passive: bool = False
    compensates: bool = False


@dataclass(frozen=True)
class Hands:
    """Passive hands (B) that hold the leaders.

    Attributes:
        stiffness: [N/m] towards where they mean to be.
        damping: [N s/m].
        mass: Of hand and leader [kg].
    """

    stiffness: Array
    damping: Array
    mass: Array


@dataclass(frozen=True)
class Course:
    """What happened, sample by sample (K, B).

    Attributes:
        leader, follower, reference: Places [m].
        contact: Force on the wall [N].
        observed: Least observed energy (2, B) [J] of the leader's and the arms' port.
        active: Share of steps (2, B) in which each controller acted.
        period_s: Between two samples.
    """

    leader: Array
    follower: Array
    reference: Array
    contact: Array
    observed: Array
    active: Array
    period_s: float


def run(
    arms: Sequence[Arm],
    hands: Hands,
    networks: Sequence[SimulatedNetwork],
    meant: Callable[[float], Array],
    duration_s: float,
    seed: int,
    *,
    every: int = 5,
) -> Course:
    """Simulate joints side by side.

    Args:
        arms: How each joint's network is answered.
        hands: Of all joints.
        networks: One a joint.
        meant: Returns where the hands mean to be (B,) [m] at a time [s].
        duration_s: Of the simulation.
        seed: Of the networks.
        every: Steps from one sample to the next.
    """
    count = len(networks)
    passive = np.array([[arm.passive] for arm in arms])
    compensates = np.array([[arm.compensates] for arm in arms])
    damping = np.array([arm.damping for arm in arms])
    settings = LinkSettings(DT_S, BOUNDS, passive, compensates)
    rngs = stream(seed, "link/to arms"), stream(seed, "link/to leader")
    link = Link(networks, Coordinates(("joint",), 1), settings, rngs, np.zeros((count, 1)))
    x = np.zeros(count)
    v = np.zeros(count)
    y = np.zeros(count)
    w = np.zeros(count)
    felt = np.zeros(count)
    last = np.zeros(count)
    intent = meant(0.0)
    observed = np.full((2, count), np.inf)
    active = np.zeros((2, count))
    samples: list[tuple[Array, Array, Array, Array]] = []
    steps_n = round(duration_s / DT_S)
    for k in range(steps_n):
        told = np.sign(felt) * np.maximum(np.abs(felt) - FELT_LEAST_N, 0.0)
        against = link.step(x[:, None], told[:, None, None])[:, 0, 0]
        reference = link.reference[:, 0]
        drive = DRIVE_N_PER_M * (reference - y) + DRIVE_N_S_PER_M * ((reference - last) / DT_S - w)
        drive = np.clip(drive, -FORCE_MAX_N, FORCE_MAX_N)
        last = reference.copy()
        wall = -WALL_N_PER_M * np.maximum(y - WALL_M, 0.0)
        w += DT_S / FOLLOWER_KG * (drive + wall - FOLLOWER_DAMPING * w)
        y += DT_S * w
        felt += DT_S / FELT_LAG_S * (-wall - felt)
        goal = meant((k + 1) * DT_S)
        hand = hands.stiffness * (goal - x) + hands.damping * ((goal - intent) / DT_S - v)
        intent = goal
        push = hand - against - LEADER_DAMPING * v
        v = (v + DT_S / hands.mass * push) / (1.0 + DT_S / hands.mass * damping)
        x += DT_S * v
        away = np.abs(x) > _ESCAPED_M
        x = np.where(away, np.sign(x) * _ESCAPED_M, x)
        v = np.where(away, 0.0, v)
        for port, side in enumerate((link.leader_port, link.arms_port)):
            observed[port] = np.minimum(observed[port], side.energy.observed[:, 0])
            active[port] += side.correction[:, 0, 0] != 0.0
        if k % every == 0:
            samples.append((x.copy(), y.copy(), reference.copy(), -wall))
    leader, follower, reference, contact = (np.array(part) for part in zip(*samples, strict=True))
    return Course(
        leader=leader,
        follower=follower,
        reference=reference,
        contact=contact,
        observed=observed,
        active=active / steps_n,
        period_s=every * DT_S,
    )
