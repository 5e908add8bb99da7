"""Records and arrays of the proof's kernels: geometry of a scene, padding, scratch memory, a motion."""

from typing import Any, NamedTuple

import numpy as np

from minidual.robot.pair import Array

JOINT = np.dtype([("parent", "i8"), ("R", "f8", (3, 3)), ("p", "f8", 3)])
"""Parent frame (0: world, k + 1: joint k) and placement in it; the joint turns about its z."""
CLUSTER = np.dtype([("centre", "f8", 3), ("radius", "f8"), ("vertices", "f8", (8, 3))])
"""Neighbouring vertices of a solid in its frame (the last may repeat), and their ball [m]."""
SOLID = np.dtype(
    [("first", "i8"), ("end", "i8"), ("ball", "f8"), ("disc", "f8"), ("axis", "f8", 3)],
)
"""Range of cluster rows, radii of the ball and of the disc that thicken them [m], disc axis."""
PART = np.dtype(
    [("first", "i8"), ("end", "i8"), ("frame", "i8"), ("centre", "f8", 3), ("radius", "f8")],
)
"""Range of solid rows, frame, bounding ball [m]."""
PAIR = np.dtype([(name, "i8") for name in ("a", "b", "frame", "row", "moves_a", "moves_b")])
"""Two part rows, the frame of their planes, the row of their first plane direction, and the index
of each part's deviation in the flattened table of `planes._deviate`."""

Rows = Any
"""Records or integers, (n,)."""


class Geometry(NamedTuple):
    """The convex solids of a scene and the pairs to keep apart.

    Attributes:
        joints: `JOINT` records (dof,).
        clusters: `CLUSTER` records.
        solids: `SOLID` records.
        parts: `PART` records.
        pairs: `PAIR` records.
        reach: Largest distance [m] of each part from each joint axis of its arm (parts, joints of the longer arm);
            0 for a joint that does not move it.
    """

    joints: Rows
    clusters: Rows
    solids: Rows
    parts: Rows
    pairs: Rows
    reach: Array


class Workspace(NamedTuple):
    """Scratch memory for n states.

    Attributes:
        directions: Last plane direction of each pair of solids (d, 3); zero: none yet.
        R: Frame orientations (n, dof + 1, 3, 3).
        p: Frame positions (n, dof + 1, 3) [m].
        centres: Centres of the parts' bounding balls (n, parts, 3) [m].
        seen_R: Orientations of a pair's frames, seen from the planes' frame (4, 3, 3): part a and b
            at the first end of a stretch, then at the last.
        seen_p: Their positions (4, 3) [m].
        simplex: Difference vectors of the running search (4, 3) [m].
    """

    directions: Array
    R: Array
    p: Array
    centres: Array
    seen_R: Array
    seen_p: Array
    simplex: Array


class Padding(NamedTuple):
    """The distance that a free state keeps.

    Attributes:
        padding_m: Usual distance [m].
        tight: States with less clearance (t, dof).
        clearances_m: What suffices at these (t,) [m].
        relax_rad: Joint distance [rad] from a tight state over which its clearance grows back to
            the padding.
    """

    padding_m: float
    tight: Array
    clearances_m: Array
    relax_rad: float


class Motion(NamedTuple):
    """Samples joined by cubics.

    Attributes:
        q: (n, dof) [rad], n >= 2.
        v: (n, dof) [rad/s].
        dt: Step [s].
    """

    q: Array
    v: Array
    dt: float


class MotionProof(NamedTuple):
    """Outcome of a proof.

    Attributes:
        ends: Whether each sample (n,) is an end of a stretch.
        sample: First sample of the step that is not proven, or -1.
        pair: Its pair, or -1.
    """

    ends: np.ndarray
    sample: int
    pair: int
