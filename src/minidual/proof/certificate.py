"""The continuous proof: from few samples, that a trajectory touches nothing at any time.

The motion is cut into stretches. On each, every pair of parts that moves must have a plane between them that both ends
keep clear of by more than the parts can deviate in between (`minidual.proof.planes`: the trajectory is a cubic between
its samples, so this is a bound, not a guess). A stretch that has none is halved; one from a sample to the next that has
none refuses the motion, so samples should be as dense as those of a plan, a millisecond apart. So what is proven is proven by geometry alone: no collision library has a say in it.

Both engines are then asked about every end of a stretch, and have to see it free as well. That ties the geometry and
kinematics of the proof to what each of them compiled; they are built from one description in three ways.

Every comparison is written so that a distance that is no number refuses the motion: NaN compares false with all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.collision.coal_engine import CoalEngine
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.proof import planes
from minidual.proof.solids import Solids
from minidual.robot.compiled import floats
from minidual.robot.constants import ARMS, GROUPS
from minidual.robot.trajectory import Trajectory

_SLACK_M = 2e-5
"""Distance that every plane must show beside: what rounding may take (the engines' vertices differ by 1e-7 m)."""
_FIRST_RAD = 0.5
"""Length of the first stretches, summed over the joints."""


@dataclass(frozen=True)
class Certificate:
    """What was proven.

    ok: Every moment is proven free, and both engines see every sample free.
    reason: Empty if ok, else what failed first.
    samples_n: States at which a stretch ends; both engines were asked about each if ok.
    unproven_n: 1 if a stretch stays open, else 0.
    disagreements_n: States that one engine, or the planes, see free and another does not.
    """

    ok: bool
    reason: str
    samples_n: int
    unproven_n: int
    disagreements_n: int


class Certifier:
    """Proves trajectories free in one scene.

    Args:
        primary: MuJoCo engine of the scene.
        second: coal engine of the same scene.
        solids: Solids of the same scene.
    """

    def __init__(self, primary: MujocoEngine, second: CoalEngine, solids: Solids) -> None:
        self._primary = primary
        self._second = second
        self._solids = solids

    def certify(self, trajectory: Trajectory) -> Certificate:
        """Return what can be proven about a trajectory; it never raises for a bad one."""
        solids = self._solids
        # Samples that stand still may be passed at speed.
        moved = ((trajectory.q != trajectory.q[0]) | (trajectory.v != 0.0)).any(axis=0)
        arms = [arm for arm in ARMS if moved[GROUPS[f"{arm}_arm"]].any()]
        directions = solids.directions()
        # What does not move is looked at once; from there on only what does.
        q, v = floats(trajectory.q), floats(trajectory.v)
        start = q[:1]
        none, nowhere = np.zeros((0, len(start[0]))), np.zeros(0)
        everything = np.arange(len(solids.pairs))
        _, verdict = planes.survey(
            solids.geometry, start, 0, everything, _SLACK_M, none, nowhere, 1.0, directions, solids.workspace()
        )
        if verdict != planes.FREE:
            return self._refusal(trajectory, np.zeros(1, dtype=int), int(everything[0]))
        asked, failed, pair = planes.prove(
            solids.geometry,
            solids.reach,
            solids.first_joint,
            q,
            v,
            trajectory.dt_s,
            _FIRST_RAD,
            solids.of_arms(arms),
            _SLACK_M,
            directions,
        )
        if failed >= 0:
            return self._refusal(trajectory, np.array([failed, failed + 1]), pair)
        at = np.flatnonzero(asked)
        return self._opinions(trajectory, at, arms)

    def _opinions(self, trajectory: Trajectory, at: np.ndarray, arms: list[str]) -> Certificate:
        """Ask both engines about the samples `at` of a trajectory that the planes prove free."""
        Q = trajectory.q[at]
        with self._primary.moving(arms):
            first = self._primary.collisions(Q)
        first[0] |= self._primary.in_collision(Q[0])
        second = self._second.collisions(Q)
        seen = first | second
        if not seen.any():
            return Certificate(True, "", len(at), 0, 0)
        k = int(np.argmax(seen))
        who = " and ".join(name for name, hits in (("MuJoCo", first), ("coal", second)) if hits[k])
        reason = f"{who} sees a collision at {trajectory.times[at[k]]:.3f} s where the planes prove none"
        return Certificate(False, reason, len(at), 0, int(seen.sum()))

    def _refusal(self, trajectory: Trajectory, at: np.ndarray, pair: int) -> Certificate:
        """Say why a motion is refused whose samples `at` the planes do not separate for a pair."""
        Q = trajectory.q[at]
        a, b = sorted(self._solids.pairs[pair])
        first, second = self._primary.collisions(Q), self._second.collisions(Q)
        seen = first | second
        if not seen.any():
            reason = f"{a} and {b} could not be proven apart after {trajectory.times[at[0]]:.3f} s"
            return Certificate(False, reason, len(at), 1, 0)
        k = int(np.argmax(seen))
        when = f"at {trajectory.times[at[k]]:.3f} s"
        contacts = self._primary.closest(Q[k], 0.0)
        reason = f"collision {when}: {contacts[0]}" if contacts else f"collision {when}: coal sees one, MuJoCo none"
        return Certificate(False, reason, len(at), 0, int(np.sum(first != second)))
