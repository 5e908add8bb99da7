"""The continuous proof: from few samples, that a trajectory touches nothing at any time, by two engines.

Two parts that are d_a apart at one time and d_b at a later one cannot touch in between if they can approach by less
than d_a + d_b in all. How far each joint travels in between is bounded exactly (the trajectory is a cubic between
its milliseconds), what that moves is bounded by `minidual.planning.motion_bound`, and distances are measured up to
`_MARGIN_M`. A stretch that this does not settle is divided, by how much is missing, until everything is settled or a
stretch is too short to go on.

MuJoCo chooses the samples. coal then gets the same samples with the distance that the proof needs of each pair,
and must find every pair farther apart than that by its own geometry; where it does not, its own exact distances
decide, and the stretch is divided again. So each engine alone proves the whole motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.motion_bound import MotionBound
from minidual.planning.mujoco_engine import MujocoEngine
from minidual.planning.trajectory import Trajectory
from minidual.robot.constants import Array

_MARGIN_M = 0.06
"""Distances are measured up to here: farther pairs count as this far apart."""
_SLACK_M = 2e-5
"""Taken off every distance: what the engines' iterations may leave open (they stop at 1e-6)."""
_FIRST_M = 0.4
"""Length of the first stretches, by the reach of the arms."""
_PARTS_MAX = 16
_ROUNDS_MAX = 12
_SHORTEST = 1.0 / 64.0
_HEADROOM = 1.15


@dataclass(frozen=True)
class Certificate:
    """What was proven.

    ok: Both engines prove every moment free.
    reason: Empty if ok, else what failed first.
    samples_n: States at which distances were measured.
    unproven_n: Stretches that stay open.
    disagreements_n: States that one engine sees colliding and the other free.
    clearance_m: Smallest distance measured, at most `_MARGIN_M`.
    """

    ok: bool
    reason: str
    samples_n: int
    unproven_n: int
    disagreements_n: int
    clearance_m: float


class _Motion:
    """States of a trajectory at any time, and how far each joint has travelled up to then."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        rates = trajectory.variation_rates()
        self.travelled = np.zeros_like(trajectory.q)
        np.cumsum(rates * trajectory.dt_s, axis=0, out=self.travelled[1:])

    def states(self, times: Array) -> Array:
        return self.trajectory.sample_many(times)[0]

    def travel(self, times: Array) -> Array:
        """Return (n, 14) [rad]: the difference of two rows bounds the travel between the two times."""
        at = np.clip(times / self.trajectory.dt_s, 0.0, len(self.travelled) - 1)
        cell = np.minimum(at.astype(int), len(self.travelled) - 2)
        share = (at - cell)[:, None]
        return self.travelled[cell] * (1.0 - share) + self.travelled[cell + 1] * share


@dataclass(eq=False)
class _Samples:
    """Times (n,) in order, and what MuJoCo measured there."""

    times: Array
    q: Array
    travel: Array
    distances: Array
    levers: Array

    def merged(self, other: _Samples) -> _Samples:
        order = np.argsort(np.concatenate([self.times, other.times]), kind="stable")
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Samples(*(np.concatenate(both)[order] for both in pairs))


class Certifier:
    """Proves trajectories free in one scene.

    Args:
        primary: MuJoCo engine of the scene.
        second: coal engine of the same scene.
        bound: Motion bound of the same scene.
    """

    def __init__(self, primary: MujocoEngine, second: CoalEngine, bound: MotionBound) -> None:
        self._primary = primary
        self._second = second
        self._bound = bound
        self._steepest = bound.matrix.max(axis=1, initial=0.0)

    def certify(self, trajectory: Trajectory) -> Certificate:
        """Return what can be proven about a trajectory; it never raises for a bad one."""
        motion = _Motion(trajectory)
        samples, unproven = self._settle(motion)
        clearance = float(samples.distances.min(initial=_MARGIN_M)) + _SLACK_M
        if clearance <= 0.0:
            return self._collision(samples, clearance)
        if unproven:
            reason = f"{unproven} stretches of the motion could not be proven free"
            return Certificate(False, reason, len(samples.times), unproven, 0, clearance)
        return self._second_opinion(motion, samples, clearance)

    def _measure(self, motion: _Motion, times: Array) -> _Samples:
        q = motion.states(times)
        measured = self._primary.measure(q, _MARGIN_M)
        return _Samples(times, q, motion.travel(times), measured.distances - _SLACK_M, measured.levers)

    def _settle(self, motion: _Motion) -> tuple[_Samples, int]:
        """Return samples on which every stretch is settled by MuJoCo's distances, and how many stretches are not."""
        samples = self._measure(motion, self._first_times(motion))
        shortest = _SHORTEST * motion.trajectory.dt_s
        for _ in range(_ROUNDS_MAX):
            if samples.distances.min(initial=1.0) <= -_SLACK_M:
                return samples, 0
            lack = self._lack(samples)
            open_ones = np.flatnonzero(lack >= 1.0)
            if len(open_ones) == 0:
                return samples, 0
            widths = np.diff(samples.times)
            if (widths[open_ones] <= shortest).any():
                break
            samples = samples.merged(self._measure(motion, _divided(samples.times, open_ones, lack)))
        return samples, int(np.sum(self._lack(samples) >= 1.0))

    def _first_times(self, motion: _Motion) -> Array:
        """Return times between which the arms go about equally far."""
        gone = motion.travelled @ self._steepest
        count = max(1, int(np.ceil(gone[-1] / _FIRST_M)))
        marks = np.linspace(0.0, gone[-1], count + 1)
        times = np.interp(marks, gone, motion.trajectory.times)
        times[[0, -1]] = 0.0, motion.trajectory.duration_s
        return np.unique(times)

    def _approach(self, samples: _Samples) -> Array:
        return self._bound.approach(np.diff(samples.travel, axis=0), samples.levers[:-1], samples.levers[1:])

    def _lack(self, samples: _Samples) -> Array:
        """Return (n - 1,): the approach over the room for it, of the worst pair; below 1 a stretch is settled."""
        room = samples.distances[:-1] + samples.distances[1:]
        return (self._approach(samples) / np.maximum(room, 1e-12)).max(axis=1, initial=0.0)

    def _collision(self, samples: _Samples, clearance: float) -> Certificate:
        depths = samples.distances.min(axis=1)
        hits = depths <= -_SLACK_M
        k = int(np.argmax(hits))
        a, b = sorted(self._primary.pairs[int(np.argmin(samples.distances[k]))])
        second = self._second.collisions(samples.q)
        reason = (
            f"collision at {samples.times[k]:.3f} s: {a} and {b} penetrate by "
            f"{-(depths[k] + _SLACK_M) * 1e3:.1f} mm"
        )
        return Certificate(False, reason, len(samples.times), 0, int(np.sum(hits != second)), clearance)

    def _second_opinion(self, motion: _Motion, samples: _Samples, clearance: float) -> Certificate:
        approach = self._approach(samples)
        room = samples.distances[:-1] + samples.distances[1:]
        # Each end answers for the share of the approach that its distance has in the room; the ends of the path
        # have one neighbour, all others two.
        share = approach / room
        needed = np.zeros_like(samples.distances)
        needed[:-1] = share * samples.distances[:-1]
        needed[1:] = np.maximum(needed[1:], share * samples.distances[1:])
        refused = np.zeros(len(samples.times), dtype=bool)
        for group in _groups(needed, samples.distances):
            refused[group] = self._second.nearer_than(samples.q[group], needed[group].max(axis=0))
        touching, unproven = 0, 0
        times_n = len(samples.times)
        if refused.any():
            first: float | None = None
            for k in np.flatnonzero(refused[:-1] | refused[1:]):
                proven, touches, asked = self._by_second(motion, samples.times[k], samples.times[k + 1])
                unproven += not proven
                touching += touches > 0
                times_n += asked
                if touches and first is None:
                    first = float(samples.times[k])
            if first is not None:
                reason = f"coal sees a collision after {first:.3f} s where MuJoCo proves none"
                return Certificate(False, reason, times_n, unproven, touching, clearance)
        reason = f"coal leaves {unproven} stretches of the motion unproven" if unproven else ""
        return Certificate(not unproven, reason, times_n, unproven, 0, clearance)

    def _by_second(self, motion: _Motion, begin: float, end: float) -> tuple[bool, int, int]:
        """Settle one stretch by coal's exact distances and the reaches: (proven, touching states, states asked)."""
        times = np.array([begin, end])
        asked = 2
        distances = self._second.distances(motion.states(times)) - _SLACK_M
        shortest = _SHORTEST * motion.trajectory.dt_s
        while True:
            touching = int(np.sum(distances.min(axis=1, initial=np.inf) <= -_SLACK_M))
            if touching:
                return False, touching, asked
            room = distances[:-1] + distances[1:]
            approach = self._bound.approach(np.diff(motion.travel(times), axis=0))
            lack = (approach / np.maximum(room, 1e-12)).max(axis=1, initial=0.0)
            open_ones = np.flatnonzero(lack >= 1.0)
            if len(open_ones) == 0:
                return True, 0, asked
            if (np.diff(times)[open_ones] <= shortest).any() or asked > 2000:
                return False, 0, asked
            new = _divided(times, open_ones, lack)
            asked += len(new)
            order = np.argsort(np.concatenate([times, new]), kind="stable")
            measured = self._second.distances(motion.states(new)) - _SLACK_M
            times = np.concatenate([times, new])[order]
            distances = np.concatenate([distances, measured])[order]


def _divided(times: Array, stretches: Array, lack: Array) -> Array:
    """Return the new times that divide each of the stretches into as many parts as it lacks room."""
    parts = np.clip(np.ceil(_HEADROOM * lack[stretches]), 2, _PARTS_MAX).astype(int)
    return np.concatenate([
        np.linspace(times[k], times[k + 1], n + 1)[1:-1] for k, n in zip(stretches, parts, strict=True)
    ])  # fmt: skip


def _groups(needed: Array, distances: Array) -> list[slice]:
    """Return runs of neighbouring samples of which the largest need of every pair is less than its least distance.

    coal takes one margin a pair for a whole batch, and setting it costs as much as four states.
    """
    groups: list[slice] = []
    start = 0
    need, room = needed[0], distances[0]
    for k in range(1, len(needed)):
        need_k, room_k = np.maximum(need, needed[k]), np.minimum(room, distances[k])
        if (need_k >= room_k).any():
            groups.append(slice(start, k))
            start, need, room = k, needed[k], distances[k]
        else:
            need, room = need_k, room_k
    groups.append(slice(start, len(needed)))
    return groups
