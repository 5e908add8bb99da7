"""The experiment of a joint against a wall: random traces, and ten contacts of a press each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minidual.config.link import SimulatedNetwork
from minidual.config.seeds import stream
from minidual.robot.pair import Array
from scripts.bench.joint_wall import WALL_M, Arm, Course, Hands, run

DELAYS_S = (0.0, 0.05, 0.1, 0.2, 0.4, 0.7)
JITTERS_S = (0.0, 0.02, 0.04)
LOSSES = (0.0, 0.01, 0.1)
SPEEDS_M_S = (0.1, 0.3)
REORDERED = SimulatedNetwork(0.5, 0.1, 0.01, 0.01)
"""500 +- 100 ms, in which packets overtake one another."""

MOVE_S = 5.0
REST_S = 8.0
"""Of a trace: the hand means to move, then to be at rest."""
JUDGED_S = 4.0
"""Last part of a trace in which it must be calm."""
TO_AND_FRO_M = 2e-3
"""A leader that travels so much further than it gets is not calm: it oscillates."""
THROWN_M_S = 2.0
"""A hand that means 0.3 m/s and moves so fast is thrown."""

PRESS_S = 5.0
PERIOD_S = 8.5
CONTACTS_N = 10
_PAST_WALL_M = 0.08


@dataclass(frozen=True)
class Traces:
    """Random hands and what they mean to do: moves, some against the wall, then rest."""

    hands: Hands
    meant: Callable[[float], Array]


def networks_of(delay_s: float) -> list[SimulatedNetwork]:
    """Return all networks of a delay."""
    return [SimulatedNetwork(delay_s, jitter, loss) for jitter in JITTERS_S for loss in LOSSES]


def groups() -> dict[str, list[SimulatedNetwork]]:
    """Return the networks by the name of their delay."""
    named = {f"{1e3 * delay_s:.0f} ms": networks_of(delay_s) for delay_s in DELAYS_S}
    named["500 +- 100 ms, reordered"] = [REORDERED]
    return named


def random_traces(count: int, copies: int, seed: int) -> Traces:
    """Return `count` random traces, repeated `copies` times."""
    rng = stream(seed, "passivity/traces")
    hands = Hands(
        stiffness=np.tile(rng.uniform(50.0, 500.0, count), copies),
        damping=np.tile(rng.uniform(1.0, 15.0, count), copies),
        mass=np.tile(rng.uniform(0.4, 1.2, count), copies),
    )
    size_m = rng.uniform(-0.04, 0.04, (3, count))
    rate_rad_s = 2.0 * np.pi * rng.uniform(0.1, 0.8, (3, count))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, count))
    rest_m = rng.uniform(0.0, 0.12, count)

    def meant(time_s: float) -> Array:
        begun = smooth(time_s / 0.5)
        rested = smooth((time_s - MOVE_S) / 0.5)
        moving_m = 0.04 + np.sum(size_m * np.sin(rate_rad_s * time_s + phase), axis=0)
        return np.tile(begun * ((1.0 - rested) * moving_m + rested * rest_m), copies)

    return Traces(hands, meant)


def smooth(share: float) -> float:
    """Return a smooth step from 0 to 1."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def unstable(course: Course) -> Array:
    """Return whether each trace ends in an oscillation, or the hand was thrown (B,)."""
    judged = course.leader[-round(JUDGED_S / course.period_s) :]
    travelled = np.abs(np.diff(judged, axis=0)).sum(axis=0)
    net = np.abs(judged[-1] - judged[0])
    speed = np.abs(np.diff(course.leader, axis=0)).max(axis=0) / course.period_s
    return (travelled - net > TO_AND_FRO_M) | (speed > THROWN_M_S)


def run_traces(
    arms: Sequence[Arm],
    count: int,
    seed: int,
    names: Sequence[str] | None = None,
) -> Course:
    """Run random traces: `count` for each group of networks under each arm, arm by arm."""
    named = groups()
    chosen = list(named) if names is None else list(names)
    networks: list[SimulatedNetwork] = []
    for name in chosen:
        networks += [named[name][k % len(named[name])] for k in range(count)]
    traces = random_traces(count, len(arms) * len(chosen), seed)
    each_arm = [arm for arm in arms for _ in networks]
    duration_s = MOVE_S + REST_S
    return run(each_arm, traces.hands, networks * len(arms), traces.meant, duration_s, seed)


def contact_cases(names: Sequence[str]) -> tuple[list[SimulatedNetwork], Array]:
    """Return the networks of the contacts, each at both speeds, and the speeds [m/s]."""
    named = groups()
    networks = [network for name in names for network in named[name] for _ in SPEEDS_M_S]
    return networks, np.tile(SPEEDS_M_S, len(networks) // len(SPEEDS_M_S))


def run_contacts(
    arms: Sequence[Arm],
    seed: int,
    names: Sequence[str] | None = None,
    contacts_n: int | None = None,
) -> Course:
    """Press and release `contacts_n` times, over every network at both speeds, arm by arm."""
    networks, speeds = contact_cases(list(groups()) if names is None else names)
    each_arm = [arm for arm in arms for _ in networks]
    networks = networks * len(arms)
    speeds = np.tile(speeds, len(arms))
    count = len(networks)
    hands = Hands(np.full(count, 300.0), np.full(count, 10.0), np.full(count, 0.8))
    most_m = WALL_M + _PAST_WALL_M

    def meant(time_s: float) -> Array:
        time_s = time_s % PERIOD_S
        reached_s = most_m / speeds
        forth = np.minimum(time_s, reached_s)
        back = np.clip(time_s - reached_s - PRESS_S, 0.0, reached_s)
        return speeds * (forth - back)

    repeats_n = CONTACTS_N if contacts_n is None else contacts_n
    return run(each_arm, hands, networks, meant, repeats_n * PERIOD_S, seed)


@dataclass(frozen=True)
class Contacts:
    """Of each case (B,), the worst of its contacts.

    Attributes:
        bounces: How often the follower left the wall and came back, most.
        settled: Whether it stayed at the wall in the last second of every press.
        press_n: Mean force in those seconds [N].
        drift_m: Between leader and reference at the end of the last release.
    """

    bounces: Array
    settled: NDArray[np.bool_]
    press_n: Array
    drift_m: Array


def judge_contacts(course: Course, speeds: Array) -> Contacts:
    """Judge what `run_contacts` gave."""
    per_contact = round(PERIOD_S / course.period_s)
    contacts_n = len(course.contact) // per_contact
    touching = course.contact[: contacts_n * per_contact] > 0.0
    shaped = touching.reshape(contacts_n, per_contact, -1)
    begins = (shaped[:, 1:] & ~shaped[:, :-1]).sum(axis=1)
    settled = np.ones(len(speeds), dtype=bool)
    press_n = np.zeros(len(speeds))
    forces = course.contact[: contacts_n * per_contact].reshape(contacts_n, per_contact, -1)
    for k, speed in enumerate(speeds):
        end = round(((WALL_M + _PAST_WALL_M) / speed + PRESS_S) / course.period_s)
        last = slice(end - round(1.0 / course.period_s), end)
        settled[k] = bool(shaped[:, last, k].all())
        press_n[k] = float(forces[:, last, k].mean())
    return Contacts(
        bounces=np.maximum(begins.max(axis=0) - 1, 0),
        settled=settled,
        press_n=press_n,
        drift_m=np.abs(course.reference[-1] - course.leader[-1]),
    )
