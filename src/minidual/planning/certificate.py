"""The continuous proof: from few samples, that a trajectory touches nothing at any time, by two engines.

Two parts that are d_a apart at one time and d_b at a later one cannot touch in between if they can approach by less
than d_a + d_b in all. How far each joint travels in between is bounded exactly (the trajectory is a cubic between
its milliseconds), what that moves is bounded by `minidual.planning.motion_bound`, and distances are measured up to
`CLEARANCE_MAX_M`. A stretch that this does not settle is divided, by how much is missing, until everything is
settled or a stretch is too short to go on.

MuJoCo chooses the samples. coal then gets the same samples with the distance that the proof needs of each pair,
and must find every pair farther apart than that by its own geometry; where it does not, its own exact distances
decide, and the stretch is divided again. So each engine alone proves the whole motion.

Every comparison is written so that a distance that is no number refuses the motion: NaN compares false with all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.motion_bound import MotionBound
from minidual.planning.mujoco_engine import SURE, ContactsFullError, MujocoEngine
from minidual.planning.trajectory import Trajectory
from minidual.robot.constants import ARMS, GROUPS, Array

_MARGIN_M = 0.05
"""Contacts are asked for up to here."""
CLEARANCE_MAX_M = SURE * _MARGIN_M
"""Pairs farther apart than this count as this far apart."""
_SLACK_M = 2e-5
"""Taken off every distance: what the engines' iterations may leave open (they stop at 1e-6)."""
_FIRST_M = 0.4
"""Length of the first stretches, by the reach of the arms."""
_PARTS_MAX = 16
_ROUNDS_MAX = 12
_SHORTEST = 1.0 / 64.0
_HEADROOM = 1.15
_EXACT_BELOW = 0.35


@dataclass(frozen=True)
class Certificate:
    """What was proven.

    ok: Both engines prove every moment free.
    reason: Empty if ok, else what failed first.
    samples_n: States at which distances were measured.
    unproven_n: Stretches that stay open.
    disagreements_n: States that one engine sees colliding and the other free.
    clearance_m: Smallest distance that is sure, at most `CLEARANCE_MAX_M`: exact where the proof needed it, elsewhere
        possibly four fifths of the distance. 0 where nothing could be measured.
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
        self._rates = rates = trajectory.variation_rates()
        self.travelled = np.zeros_like(trajectory.q)
        np.cumsum(rates * trajectory.dt_s, axis=0, out=self.travelled[1:])

    def states(self, times: Array) -> Array:
        return self.trajectory.positions(times)

    def near(self, times: Array, widths: Array) -> Array:
        """Return (n, 14) [rad]: roughly how far each joint travels within a width [s] of each time."""
        cell = np.minimum((times / self.trajectory.dt_s).astype(int), len(self._rates) - 1)
        return self._rates[cell] * widths[:, None]

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
        try:
            return self._certify(trajectory)
        except ContactsFullError as error:
            return Certificate(False, f"not provable: {error}", 0, 1, 0, 0.0)

    def _certify(self, trajectory: Trajectory) -> Certificate:
        motion = _Motion(trajectory)
        arms = [arm for arm in ARMS if motion.travelled[-1, GROUPS[f"{arm}_arm"]].max() > 0.0]
        # What does not move is looked at once; from there on only what does.
        still = self._primary.measure(trajectory.q[:1], _MARGIN_M).distances[0] - _SLACK_M
        with self._primary.moving(arms):
            samples, unproven = self._settle(motion)
        samples.distances[0] = np.minimum(samples.distances[0], still)
        clearance = float(samples.distances.min(initial=CLEARANCE_MAX_M - _SLACK_M)) + _SLACK_M
        if not clearance > 0.0:
            return self._collision(samples, clearance)
        if unproven:
            reason = f"{unproven} stretches of the motion could not be proven free"
            return Certificate(False, reason, len(samples.times), unproven, 0, clearance)
        return self._second_opinion(motion, samples, clearance)

    def _measure(self, motion: _Motion, times: Array, widths: Array) -> _Samples:
        """Return samples; `widths` (n,) [s] is how far they are from their neighbours."""
        q = motion.states(times)
        travel = motion.travel(times)
        # Distances need to be exact only where they are of the size of the approach.
        enough = _EXACT_BELOW * (motion.near(times, widths) @ self._bound.matrix)
        measured = self._primary.measure(q, _MARGIN_M, enough)
        return _Samples(times, q, travel, measured.distances - _SLACK_M, measured.levers)

    def _settle(self, motion: _Motion) -> tuple[_Samples, int]:
        """Return samples on which every stretch is settled by MuJoCo's distances, and how many stretches are not."""
        times = self._first_times(motion)
        samples = self._measure(motion, times, _widths(times))
        shortest = _SHORTEST * motion.trajectory.dt_s
        for _ in range(_ROUNDS_MAX):
            if not samples.distances.min(initial=1.0) > -_SLACK_M:
                return samples, 0
            lack = self._lack(samples)
            open_ones = np.flatnonzero(_open(lack))
            if len(open_ones) == 0:
                return samples, 0
            widths = np.diff(samples.times)
            if np.isnan(lack).any() or (widths[open_ones] <= shortest).any():
                break
            new, between = _divided(samples.times, open_ones, lack)
            samples = samples.merged(self._measure(motion, new, between))
        return samples, int(np.sum(_open(self._lack(samples))))

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
        hits = ~(depths > -_SLACK_M)
        k = int(np.argmax(hits))
        a, b = sorted(self._primary.pairs[int(np.argmin(samples.distances[k]))])
        second = self._second.collisions(samples.q)
        if np.isnan(depths[k]):
            reason = f"at {samples.times[k]:.3f} s the distance of {a} and {b} is not a number"
        else:
            deep_mm = -(depths[k] + _SLACK_M) * 1e3
            reason = f"collision at {samples.times[k]:.3f} s: {a} and {b} penetrate by {deep_mm:.1f} mm"
        return Certificate(False, reason, len(samples.times), 0, int(np.sum(hits != second)), clearance)

    def _second_opinion(self, motion: _Motion, samples: _Samples, clearance: float) -> Certificate:
        approach = self._approach(samples)
        room = samples.distances[:-1] + samples.distances[1:]
        # Each end answers for the share of the approach that its distance has in the room; the ends of the path
        # have one neighbour, all others two. Where there is no room, what is settled does not approach either.
        share = np.divide(approach, room, out=np.zeros_like(approach), where=room > 0.0)
        needed = np.zeros_like(samples.distances)
        needed[:-1] = share * samples.distances[:-1]
        needed[1:] = np.maximum(needed[1:], share * samples.distances[1:])
        refused = self._refused(samples, needed)
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

    def _refused(self, samples: _Samples, needed: Array) -> np.ndarray:
        """Return (n,): at which samples coal does not see every pair farther apart than is needed of it there.

        One margin a pair serves a whole batch of coal, so it gets the largest need of any sample, but less than the
        least distance that MuJoCo saw; the few samples that need more of a pair are asked for its exact distance.
        """
        margins = np.minimum(needed.max(axis=0), 0.9 * samples.distances.min(axis=0))
        refused = self._second.nearer_than(samples.q, margins)
        more = ~(needed <= margins)
        for k in np.flatnonzero(more.any(axis=1)):
            pairs = np.flatnonzero(more[k])
            exact = np.array(self._second.pair_distances(samples.q[k], pairs.tolist()))
            refused[k] |= not (exact > needed[k, pairs]).all()
        return refused

    def _by_second(self, motion: _Motion, begin: float, end: float) -> tuple[bool, int, int]:
        """Settle one stretch by coal's exact distances and the reaches: (proven, touching states, states asked)."""
        times = np.array([begin, end])
        asked = 2
        distances = self._second.distances(motion.states(times)) - _SLACK_M
        shortest = _SHORTEST * motion.trajectory.dt_s
        while True:
            if np.isnan(distances).any():
                return False, 0, asked
            touching = int(np.sum(distances.min(axis=1, initial=np.inf) <= -_SLACK_M))
            if touching:
                return False, touching, asked
            room = distances[:-1] + distances[1:]
            approach = self._bound.approach(np.diff(motion.travel(times), axis=0))
            lack = (approach / np.maximum(room, 1e-12)).max(axis=1, initial=0.0)
            open_ones = np.flatnonzero(_open(lack))
            if len(open_ones) == 0:
                return True, 0, asked
            short = (np.diff(times)[open_ones] <= shortest).any()
            if np.isnan(lack).any() or short or asked > 2000:
                return False, 0, asked
            new, _ = _divided(times, open_ones, lack)
            asked += len(new)
            order = np.argsort(np.concatenate([times, new]), kind="stable")
            measured = self._second.distances(motion.states(new)) - _SLACK_M
            times = np.concatenate([times, new])[order]
            distances = np.concatenate([distances, measured])[order]


def _open(lack: Array) -> np.ndarray:
    """Return (n,): which stretches are not settled; a lack that is no number settles nothing."""
    return ~(lack < 1.0)


def _widths(times: Array) -> Array:
    """Return the distance (n,) of each time to its farther neighbour."""
    gaps = np.diff(times, prepend=times[0], append=times[-1])
    return np.maximum(gaps[:-1], gaps[1:])


def _divided(times: Array, stretches: Array, lack: Array) -> tuple[Array, Array]:
    """Return the new times that divide each of the stretches into as many parts as it lacks room, and their gaps."""
    parts = np.clip(np.ceil(_HEADROOM * lack[stretches]), 2, _PARTS_MAX).astype(int)
    new = [np.linspace(times[k], times[k + 1], n + 1)[1:-1] for k, n in zip(stretches, parts, strict=True)]
    gaps = (times[stretches + 1] - times[stretches]) / parts
    return np.concatenate(new), np.repeat(gaps, parts - 1)
