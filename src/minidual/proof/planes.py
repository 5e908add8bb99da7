"""Separating planes, compiled: is there a plane between two parts, at one state or all through a stretch of motion?

A part is a few convex solids: the hull of some vertices, made thicker by a ball (sphere, capsule) or by a disc
(cylinder). Two solids are apart by at least d if along some direction everything of one lies d beyond everything of the
other. To see that takes their farthest points along this one direction; how the direction was found does not matter, so
the search for it (from the last direction that worked, by the algorithm of Gilbert, Johnson and Keerthi) needs no trust.

All through a stretch of motion: take the straight line in joint space between its two ends. A vertex moves on a curve
there, p(x), 0 <= x <= 1, whose second derivative is bounded: turning joints i and j moves it by no more than its distance
from the axis of the outer one, for each product of their steps. So it stays within an eighth of that bound of the chord
between its places at the two ends. Where the motion leaves the straight line in joint space by e_j, it moves by at most
the reach r_j e_j more. A plane that separates two solids at both ends by more than what they may deviate together
therefore separates them in between. Two links of one arm are looked at from the inner one, so that only the joints
between them count.

A number that is none proves nothing: sums keep a NaN where comparisons would lose it, and it compares false with all.

All helpers live in this file because numba's cache watches no other for changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from minidual.robot.compiled import kernel
from minidual.robot.constants import Array

ARM_DOF = 7
DOF = 14

JOINT = np.dtype([("parent", "i8"), ("R", "f8", (3, 3)), ("p", "f8", 3)])
"""A joint: the frame before it (0 is the world, k + 1 that of joint k) and its placement there; it turns about its z."""
SOLID = np.dtype(
    [("first", "i8"), ("end", "i8"), ("ball", "f8"), ("disc", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8")]
)
"""A convex solid: its rows of vertices, the radii [m] that make it thicker, the axis of the disc."""
PART = np.dtype(
    [("first", "i8"), ("end", "i8"), ("frame", "i8"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("radius", "f8")]
)
"""A part: its rows of solids, the frame that carries it, a ball round it in this frame [m]."""
PAIR = np.dtype([(name, "i8") for name in ("a", "b", "frame", "row", "moves_a", "moves_b")])
"""Two parts that must not touch, the frame in which a plane between them stands still, the first row of its directions,
and where the deviations of the two stand in the flattened table of `_deviate`."""

Rows = np.ndarray
"""Records or whole numbers, (n,)."""
Geometry = tuple[Rows, Array, Rows, Rows, Rows]
"""Joints (14,), vertices (v, 3) [m] in the frames that carry them, solids, parts, pairs."""
Work = tuple[Array, Array, Array, Array, Array, Array]
"""Memory for one state: poses of the frames, centres of the parts, two ends of a pair, a simplex."""
Point = tuple[float, float, float, float]
"""A distance and a point."""

FREE, BLOCKED, UNDECIDED = 0, 1, 2

_TRIES = 40
"""Directions tried for one plane."""
_EXACT_M = 1e-4


def _inner(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile what only kernels call, into their code.

    `_nrt=False`: numba counts the references of every array at every call otherwise, in atomic operations, which takes
    five times as long as the calls do. Without it a function may not allocate anything; none of these does.
    """
    return njit(error_model="numpy", forceinline=True, _nrt=False)(function)


@_inner
def place(joints: Rows, parts: Rows, q: Array, n: int, R: Array, p: Array, C: Array) -> None:
    """Write into row n of R, p and C the pose of every frame at q (14,), (15, 3, 3) and (15, 3), and the centres."""
    for r in range(3):
        for c in range(3):
            R[n, 0, r, c] = 1.0 if r == c else 0.0
        p[n, 0, r] = 0.0
    for j in range(DOF):
        f = joints[j].parent
        own_R, own_p = joints[j].R, joints[j].p
        c, s = math.cos(q[j]), math.sin(q[j])
        for r in range(3):
            x, y, z = R[n, f, r, 0], R[n, f, r, 1], R[n, f, r, 2]
            m0 = x * own_R[0, 0] + y * own_R[1, 0] + z * own_R[2, 0]
            m1 = x * own_R[0, 1] + y * own_R[1, 1] + z * own_R[2, 1]
            R[n, j + 1, r, 0] = c * m0 + s * m1
            R[n, j + 1, r, 1] = c * m1 - s * m0
            R[n, j + 1, r, 2] = x * own_R[0, 2] + y * own_R[1, 2] + z * own_R[2, 2]
            p[n, j + 1, r] = p[n, f, r] + x * own_p[0] + y * own_p[1] + z * own_p[2]
    for k in range(len(parts)):
        f = parts[k].frame
        x, y, z = parts[k].x, parts[k].y, parts[k].z
        for r in range(3):
            C[n, k, r] = R[n, f, r, 0] * x + R[n, f, r, 1] * y + R[n, f, r, 2] * z + p[n, f, r]


@_inner
def _seen_from(R: Array, p: Array, n: int, f: int, a: int, seen_R: Array, seen_p: Array, to: int) -> None:
    """Write the pose of frame a as seen from frame f, at state n, into row `to`."""
    if f == 0:
        for r in range(3):
            for c in range(3):
                seen_R[to, r, c] = R[n, a, r, c]
            seen_p[to, r] = p[n, a, r]
        return
    x, y, z = p[n, a, 0] - p[n, f, 0], p[n, a, 1] - p[n, f, 1], p[n, a, 2] - p[n, f, 2]
    for r in range(3):
        u, v, w = R[n, f, 0, r], R[n, f, 1, r], R[n, f, 2, r]
        for c in range(3):
            seen_R[to, r, c] = u * R[n, a, 0, c] + v * R[n, a, 1, c] + w * R[n, a, 2, c]
        seen_p[to, r] = u * x + v * y + w * z


@_inner
def _farthest(vertices: Array, solids: Rows, k: int, R: Array, p: Array, n: int, x: float, y: float, z: float) -> Point:
    """Return how far solid k in pose n goes along (x, y, z), without its ball, and the point that goes there."""
    mx = R[n, 0, 0] * x + R[n, 1, 0] * y + R[n, 2, 0] * z
    my = R[n, 0, 1] * x + R[n, 1, 1] * y + R[n, 2, 1] * z
    mz = R[n, 0, 2] * x + R[n, 1, 2] * y + R[n, 2, 2] * z
    at = solids[k].first
    far, all_of_them = -np.inf, 0.0
    for i in range(at, solids[k].end):
        d = vertices[i, 0] * mx + vertices[i, 1] * my + vertices[i, 2] * mz
        all_of_them += d
        if d > far:
            far = d
            at = i
    if not abs(all_of_them) < np.inf:
        far = np.nan  # the comparison loses a NaN, the sum does not
    u, v, w = vertices[at, 0], vertices[at, 1], vertices[at, 2]
    disc = solids[k].disc
    if disc > 0.0:
        ax, ay, az = solids[k].x, solids[k].y, solids[k].z
        along = mx * ax + my * ay + mz * az
        sx, sy, sz = mx - along * ax, my - along * ay, mz - along * az
        across = math.sqrt(sx * sx + sy * sy + sz * sz)
        far += disc * across
        if across > 0.0:
            u += disc / across * sx
            v += disc / across * sy
            w += disc / across * sz
    far += x * p[n, 0] + y * p[n, 1] + z * p[n, 2]
    return (
        far,
        R[n, 0, 0] * u + R[n, 0, 1] * v + R[n, 0, 2] * w + p[n, 0],
        R[n, 1, 0] * u + R[n, 1, 1] * v + R[n, 1, 2] * w + p[n, 1],
        R[n, 2, 0] * u + R[n, 2, 1] * v + R[n, 2, 2] * w + p[n, 2],
    )


@_inner
def _difference(
    vertices: Array, solids: Rows, a: int, b: int, R: Array, p: Array, ends: int, x: float, y: float, z: float
) -> Point:
    """Return how far solid a lies beyond solid b along (x, y, z), least over the ends, and the vector from b to a there.

    Rows 0 and 1 of R and p are the poses of a and b at the first end, rows 2 and 3 those at the second.
    """
    gap = np.inf
    sx, sy, sz = 0.0, 0.0, 0.0
    for end in range(ends):
        back, ax, ay, az = _farthest(vertices, solids, a, R, p, 2 * end, -x, -y, -z)
        front, bx, by, bz = _farthest(vertices, solids, b, R, p, 2 * end + 1, x, y, z)
        here = -back - front
        if here != here:
            return np.nan, ax - bx, ay - by, az - bz
        if not here >= gap:
            gap = here
            sx, sy, sz = ax - bx, ay - by, az - bz
    return gap, sx, sy, sz


@_inner
def _on_triangle(S: Array, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Return the weights of rows i, j and k of S (4, 3) in the point of their triangle nearest to the origin.

    Ericson, Real-Time Collision Detection, section 5.1.5: by the regions of corners, edges and inside.
    """
    ax, ay, az = S[i, 0], S[i, 1], S[i, 2]
    bx, by, bz = S[j, 0], S[j, 1], S[j, 2]
    cx, cy, cz = S[k, 0], S[k, 1], S[k, 2]
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    d1, d2 = -(ux * ax + uy * ay + uz * az), -(vx * ax + vy * ay + vz * az)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    d3, d4 = -(ux * bx + uy * by + uz * bz), -(vx * bx + vy * by + vz * bz)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    of_c = d1 * d4 - d3 * d2
    if of_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    d5, d6 = -(ux * cx + uy * cy + uz * cz), -(vx * cx + vy * cy + vz * cz)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    of_b = d5 * d2 - d1 * d6
    if of_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t
    of_a = d3 * d6 - d5 * d4
    if of_a <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - t, t
    whole = of_a + of_b + of_c
    return of_a / whole, of_b / whole, of_c / whole


@_inner
def _outside(S: Array, i: int, j: int, k: int, m: int) -> bool:
    """Return whether the origin does not lie on the same side of the triangle i, j, k as row m of S (4, 3)."""
    ux, uy, uz = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1], S[j, 2] - S[i, 2]
    vx, vy, vz = S[k, 0] - S[i, 0], S[k, 1] - S[i, 1], S[k, 2] - S[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    here = -(nx * S[i, 0] + ny * S[i, 1] + nz * S[i, 2])
    there = nx * (S[m, 0] - S[i, 0]) + ny * (S[m, 1] - S[i, 1]) + nz * (S[m, 2] - S[i, 2])
    return not here * there > 0.0


@_inner
def _nearest(S: Array, count: int) -> tuple[int, float, float, float]:
    """Return (count, x, y, z): the point nearest to the origin of the simplex in the first rows of S (4, 3).

    The rows that this point does not need are dropped. It is the origin itself if all four are needed.
    """
    weights = (1.0, 0.0, 0.0)
    i, j, k = 0, 1, 2
    if count == 2:
        ux, uy, uz = S[1, 0] - S[0, 0], S[1, 1] - S[0, 1], S[1, 2] - S[0, 2]
        square = ux * ux + uy * uy + uz * uz
        t = -(ux * S[0, 0] + uy * S[0, 1] + uz * S[0, 2])
        t = min(1.0, max(0.0, t / square)) if square > 0.0 else 0.0
        weights = (1.0 - t, t, 0.0)
    elif count == 3:
        weights = _on_triangle(S, 0, 1, 2)
    elif count == 4:
        least = np.inf
        for face in range(4):
            a, b, c = (1 if face == 0 else 0), (2 if face <= 1 else 1), (3 if face <= 2 else 2)
            if _outside(S, a, b, c, face):
                u, v, w = _on_triangle(S, a, b, c)
                x = u * S[a, 0] + v * S[b, 0] + w * S[c, 0]
                y = u * S[a, 1] + v * S[b, 1] + w * S[c, 1]
                z = u * S[a, 2] + v * S[b, 2] + w * S[c, 2]
                square = x * x + y * y + z * z
                if square < least:
                    least, weights, i, j, k = square, (u, v, w), a, b, c
        if least == np.inf:
            return 4, 0.0, 0.0, 0.0
    x, y, z = 0.0, 0.0, 0.0
    kept = 0
    for row, weight in ((i, weights[0]), (j, weights[1]), (k, weights[2])):
        if weight > 0.0:
            x += weight * S[row, 0]
            y += weight * S[row, 1]
            z += weight * S[row, 2]
            S[kept, 0], S[kept, 1], S[kept, 2] = S[row, 0], S[row, 1], S[row, 2]
            kept += 1
    return kept, x, y, z


@_inner
def _separate(
    vertices: Array,
    solids: Rows,
    a: int,
    b: int,
    R: Array,
    p: Array,
    ends: int,
    need: float,
    exact: bool,
    directions: Array,
    row: int,
    S: Array,
) -> tuple[float, float]:
    """Return (gap, bound): solids a and b are apart by at least `gap` at all ends, and by at most `bound`.

    The algorithm of Gilbert, Johnson and Keerthi, on the differences of points of a and b at any end. It stops as soon as
    a direction shows more than `need`, or no direction can; if `exact`, only when the two meet, up to `_EXACT_M`. The best
    direction stays in `directions`. S (4, 3) is memory.
    """
    thick = solids[a].ball + solids[b].ball
    x, y, z = directions[row, 0], directions[row, 1], directions[row, 2]
    size, count = np.inf, 0
    if x == 0.0 and y == 0.0 and z == 0.0:
        z = 1.0  # any direction will do to begin with
    best, bx, by, bz = -np.inf, x, y, z
    for _ in range(_TRIES):
        gap, sx, sy, sz = _difference(vertices, solids, a, b, R, p, ends, x, y, z)
        if gap - thick > best:
            best, bx, by, bz = gap - thick, x, y, z
        if best > need:
            break
        S[count, 0], S[count, 1], S[count, 2] = sx, sy, sz
        count, wx, wy, wz = _nearest(S, count + 1)
        length = math.sqrt(wx * wx + wy * wy + wz * wz)
        if not length < size:
            break  # nothing new: the search has come to its end
        size = length
        # No direction shows more than the length of the nearest difference.
        if count == 4 or not size - thick > (best + _EXACT_M if exact else need) or size == 0.0:
            break
        x, y, z = wx / size, wy / size, wz / size
    directions[row, 0], directions[row, 1], directions[row, 2] = bx, by, bz
    return best, size - thick


@_inner
def _between_balls(parts: Rows, pair: Any, R: Array, C: Array, i: int, j: int) -> float:
    """Return the least distance of the balls round two parts on the straight way between states i and j."""
    a, b, f = pair.a, pair.b, pair.frame
    x, y, z = C[i, a, 0] - C[i, b, 0], C[i, a, 1] - C[i, b, 1], C[i, a, 2] - C[i, b, 2]
    if i != j:
        u, v, w = C[j, a, 0] - C[j, b, 0], C[j, a, 1] - C[j, b, 1], C[j, a, 2] - C[j, b, 2]
        if f != 0:
            x, y, z = (
                R[i, f, 0, 0] * x + R[i, f, 1, 0] * y + R[i, f, 2, 0] * z,
                R[i, f, 0, 1] * x + R[i, f, 1, 1] * y + R[i, f, 2, 1] * z,
                R[i, f, 0, 2] * x + R[i, f, 1, 2] * y + R[i, f, 2, 2] * z,
            )
            u, v, w = (
                R[j, f, 0, 0] * u + R[j, f, 1, 0] * v + R[j, f, 2, 0] * w,
                R[j, f, 0, 1] * u + R[j, f, 1, 1] * v + R[j, f, 2, 1] * w,
                R[j, f, 0, 2] * u + R[j, f, 1, 2] * v + R[j, f, 2, 2] * w,
            )
        dx, dy, dz = u - x, v - y, w - z
        square = dx * dx + dy * dy + dz * dz
        if square > 0.0:
            t = min(1.0, max(0.0, -(x * dx + y * dy + z * dz) / square))
            x, y, z = x + t * dx, y + t * dy, z + t * dz
    return math.sqrt(x * x + y * y + z * z) - parts[a].radius - parts[b].radius


@_inner
def _beside(
    vertices: Array,
    solids: Rows,
    parts: Rows,
    pair: Any,
    R: Array,
    p: Array,
    C: Array,
    i: int,
    j: int,
    directions: Array,
) -> float:
    """Return by how much the ball round part a lies beyond part b along their last direction, at states i and j.

    Minus infinity where b is not one solid that stands still. It settles most pairs of a link and a box.
    """
    a, b = pair.a, pair.b
    x, y, z = directions[pair.row, 0], directions[pair.row, 1], directions[pair.row, 2]
    if parts[b].frame != 0 or parts[b].end - parts[b].first != 1 or (x == 0.0 and y == 0.0 and z == 0.0):
        return -np.inf
    front, _, _, _ = _farthest(vertices, solids, parts[b].first, R[i], p[i], 0, x, y, z)
    back = min(C[i, a, 0] * x + C[i, a, 1] * y + C[i, a, 2] * z, C[j, a, 0] * x + C[j, a, 1] * y + C[j, a, 2] * z)
    return back - parts[a].radius - front - solids[parts[b].first].ball


@_inner
def _apart(
    vertices: Array,
    solids: Rows,
    parts: Rows,
    pair: Any,
    R: Array,
    p: Array,
    i: int,
    j: int,
    need: float,
    directions: Array,
    seen_R: Array,
    seen_p: Array,
    S: Array,
) -> tuple[float, float]:
    """Return (gap, bound): the parts of a pair are apart by at least `gap` at states i and j, and by at most `bound`.

    It ends at the first two solids that are not seen farther apart than `need`; the bound is theirs, else infinite.
    """
    a, b = pair.a, pair.b
    ends = 1 if i == j else 2
    for end in range(ends):
        n = i if end == 0 else j
        _seen_from(R, p, n, pair.frame, parts[a].frame, seen_R, seen_p, 2 * end)
        _seen_from(R, p, n, pair.frame, parts[b].frame, seen_R, seen_p, 2 * end + 1)
    least = np.inf
    row = pair.row
    for s in range(parts[a].first, parts[a].end):
        for o in range(parts[b].first, parts[b].end):
            gap, bound = _separate(vertices, solids, s, o, seen_R, seen_p, ends, need, False, directions, row, S)
            row += 1
            if not gap > need:
                return gap, bound
            least = min(least, gap)
    return least, np.inf


@_inner
def _deviate(reach: Array, first_joint: Rows, step: Array, off: Array, table: Array) -> None:
    """Write into the table (m + 1, 8) [m] how far part m may leave its chords, as seen from what its joint i carries.

    reach: (m, 7) [m], of the parts that move, from each joint of their arm; 0 where it moves them not.
    first_joint: (m,), 0 or 7.
    step: (14,) [rad], between the ends of the stretch.
    off: (14,) [rad], by how much the motion leaves the straight line in joint space.
    """
    moving = len(first_joint)
    for i in range(ARM_DOF + 1):
        table[moving, i] = 0.0
    for m in range(moving):
        first = first_joint[m]
        for i in range(ARM_DOF):
            total, inside = 0.0, 0.0
            for j in range(i, ARM_DOF):
                turn = abs(step[first + j])
                total += reach[m, j] * (off[first + j] + 0.125 * turn * (turn + 2.0 * inside))
                inside += turn
            table[m, i] = total
        table[m, ARM_DOF] = 0.0


@_inner
def _off_chord(q: Array, bend: Array, i: int, j: int, step: Array, off: Array) -> None:
    """Write the joint step (14,) from sample i to j, and by how much (14,) the motion leaves the straight line.

    bend: (n - 1, 14) [rad], by how much it leaves the straight line between two neighbouring samples.
    """
    square, total = 0.0, 0.0
    for c in range(DOF):
        step[c] = q[j, c] - q[i, c]
        off[c] = 0.0
        square += step[c] * step[c]
    for k in range(i, j):
        x = 0.0
        if square > 0.0:
            for c in range(DOF):
                x += (q[k, c] - q[i, c]) * step[c]
            x = min(1.0, max(0.0, x / square))
        for c in range(DOF):
            # Between two samples the motion is off by no more than the worse of the two is, and its own bend.
            away = abs(q[k, c] - q[i, c] - x * step[c]) + max(bend[k, c], bend[max(k - 1, i), c])
            total += away
            off[c] = max(off[c], away)
    if not total < np.inf:  # `max` loses a NaN, the sum does not
        for c in range(DOF):
            off[c] = np.inf


@_inner
def _bends(q: Array, v: Array, dt: float, bend: Array) -> None:
    """Write by how much (n - 1, 14) [rad] the cubics between samples q and v (n, 14), dt [s] apart, leave their chords."""
    for k in range(len(q) - 1):
        for c in range(DOF):
            # A second derivative is largest at an end; a curve leaves its chord by an eighth of it.
            rise, before, after = q[k + 1, c] - q[k, c], v[k, c] * dt, v[k + 1, c] * dt
            first = 6.0 * rise - 4.0 * before - 2.0 * after
            last = -6.0 * rise + 2.0 * before + 4.0 * after
            bend[k, c] = 0.125 * max(abs(first), abs(last))


@_inner
def _first_stretches(q: Array, length: float, stack: Array) -> int:
    """Fill the stack with stretches of about `length` [rad], summed over the joints, the first on top; return how many."""
    last = len(q) - 1
    whole = 0.0
    for k in range(last):
        for c in range(DOF):
            whole += abs(q[k + 1, c] - q[k, c])
    count = max(1, min(len(stack) // 2, math.ceil(whole / length))) if whole < np.inf else 1
    begin, gone, done = 0, 0.0, 0
    for k in range(last):
        for c in range(DOF):
            gone += abs(q[k + 1, c] - q[k, c])
        if gone >= (done + 1) * whole / count or k + 1 == last:
            stack[done, 0], stack[done, 1] = begin, k + 1
            begin = k + 1
            done += 1
            if done == count:
                stack[done - 1, 1] = last
                break
    for k in range(done // 2):
        for end in range(2):
            stack[k, end], stack[done - 1 - k, end] = stack[done - 1 - k, end], stack[k, end]
    return done


@kernel()
def prove(
    geometry: Geometry,
    reach: Array,
    first_joint: Rows,
    q: Array,
    v: Array,
    dt: float,
    length: float,
    chosen: Rows,
    need: float,
    directions: Array,
) -> tuple[np.ndarray, int, int]:
    """Prove that pairs stay farther apart than `need` all through a motion: cubics between samples q, v (n, 14).

    Args:
        geometry: (joints, vertices, solids, parts, pairs), see `minidual.proof.solids`.
        reach: (m, 7) [m], see `_deviate`.
        first_joint: (m,), see `_deviate`.
        q: Samples [rad]; n >= 2.
        v: Their velocities [rad/s].
        dt: Step between them [s].
        length: Of the first stretches [rad], summed over the joints; each is halved until it is proven or lies between two
            neighbouring samples.
        chosen: (c,), rows of `pairs`.
        need: [m], also what is taken off every distance for rounding.
        directions: (r, 3), where the search for a plane begins, and then the last one found.

    Returns:
        asked: (n,) bool, the samples at which a stretch ends.
        failed: First sample of a stretch from one sample to the next that is not proven, or -1.
        pair: Its pair, or -1.
    """
    joints, vertices, solids, parts, pairs = geometry
    n = len(q)
    R, p, C = np.empty((n, DOF + 1, 3, 3)), np.empty((n, DOF + 1, 3)), np.empty((n, len(parts), 3))
    asked = np.zeros(n, dtype=np.bool_)
    bend, step, off = np.empty((n - 1, DOF)), np.empty(DOF), np.empty(DOF)
    table = np.empty((len(first_joint) + 1, ARM_DOF + 1))
    moved = table.reshape(-1)
    seen_R, seen_p, S = np.empty((4, 3, 3)), np.empty((4, 3)), np.empty((4, 3))
    order = chosen.copy()
    stack = np.empty((512, 2), dtype=np.int64)
    _bends(q, v, dt, bend)
    top = _first_stretches(q, length, stack)
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        for k in (i, j):
            if not asked[k]:
                place(joints, parts, q[k], k, R, p, C)
                asked[k] = True
        _off_chord(q, bend, i, j, step, off)
        _deviate(reach, first_joint, step, off, table)
        open_at = -1
        for at in range(len(order)):
            pair = pairs[order[at]]
            deviation = moved[pair.moves_a] + moved[pair.moves_b]
            if _between_balls(parts, pair, R, C, i, j) - deviation > need:
                continue
            if _beside(vertices, solids, parts, pair, R, p, C, i, j, directions) - deviation > need:
                continue
            gap, _ = _apart(vertices, solids, parts, pair, R, p, i, j, need + deviation, directions, seen_R, seen_p, S)
            if not gap - deviation > need:
                open_at = at
                break
        if open_at < 0:
            continue
        # What was not seen apart here is likely to fail in the halves too: it comes first there.
        row = _to_front(order, open_at)
        if j - i < 2:
            return asked, i, row
        middle = (i + j) // 2
        stack[top, 0], stack[top, 1] = middle, j
        stack[top + 1, 0], stack[top + 1, 1] = i, middle
        top += 2
    return asked, -1, -1


@_inner
def _to_front(order: Rows, at: int) -> int:
    """Move one element to the front, the others keep their order; return it."""
    row = order[at]
    for k in range(at, 0, -1):
        order[k] = order[k - 1]
    order[0] = row
    return row


@_inner
def _verdict(
    geometry: Geometry,
    q: Array,
    chosen: Rows,
    padding: float,
    tight: Array,
    clearances: Array,
    relax: float,
    directions: Array,
    work: Work,
) -> int:
    """Return the verdict on one state, see `survey`."""
    joints, vertices, solids, parts, pairs = geometry
    R, p, C, seen_R, seen_p, S = work
    need = padding
    for t in range(len(tight)):
        away = 0.0
        for c in range(DOF):
            away = max(away, abs(q[c] - tight[t, c]))
        need = min(need, clearances[t] + (padding - clearances[t]) * min(1.0, away / relax))
    place(joints, parts, q, 0, R, p, C)
    for at in range(len(chosen)):
        pair = pairs[chosen[at]]
        if _between_balls(parts, pair, R, C, 0, 0) > need:
            continue
        if _beside(vertices, solids, parts, pair, R, p, C, 0, 0, directions) > need:
            continue
        gap, bound = _apart(vertices, solids, parts, pair, R, p, 0, 0, need, directions, seen_R, seen_p, S)
        if not gap > need:
            _to_front(chosen, at)
            return BLOCKED if bound <= need else UNDECIDED
    return FREE


@kernel()
def survey(
    geometry: Geometry,
    Q: Array,
    begin: int,
    chosen: Rows,
    padding: float,
    tight: Array,
    clearances: Array,
    relax: float,
    directions: Array,
    work: Work,
) -> tuple[int, int]:
    """Return (k, verdict): the first row of Q (n, 14), from row `begin` on, that is not free; (n, FREE) if all are.

    FREE: all pairs are farther apart than `padding`, or near a state of `tight` (t, 14) farther than its clearance (t,)
    and a part of what lacks to the padding that grows to the whole at `relax` [rad]. BLOCKED: some pair is surely not.
    UNDECIDED: neither was seen. `chosen` (c,), rows of `pairs`, is put in the order in which they block; `work` and
    `directions` are memory.
    """
    for k in range(begin, len(Q)):
        verdict = _verdict(geometry, Q[k], chosen, padding, tight, clearances, relax, directions, work)
        if verdict != FREE:
            return k, verdict
    return len(Q), FREE


@kernel()
def sweep(
    geometry: Geometry,
    a: Array,
    b: Array,
    fractions: Array,
    begin: int,
    q: Array,
    chosen: Rows,
    padding: float,
    tight: Array,
    clearances: Array,
    relax: float,
    directions: Array,
    work: Work,
) -> tuple[int, int]:
    """Return (k, verdict) as `survey` does for the states a + fractions[k] (b - a), the last one written into q (14,)."""
    for k in range(begin, len(fractions)):
        for c in range(DOF):
            q[c] = a[c] + fractions[k] * (b[c] - a[c])
        verdict = _verdict(geometry, q, chosen, padding, tight, clearances, relax, directions, work)
        if verdict != FREE:
            return k, verdict
    return len(fractions), FREE


@kernel()
def clearance(geometry: Geometry, Q: Array, chosen: Rows, most: float, directions: Array, work: Work) -> float:
    """Return the smallest distance [m] of the pairs at the rows of Q (n, 14) that planes show, at most `most`.

    It is never more than the true one; where things touch it is negative, where nothing can be shown minus infinity.
    """
    joints, vertices, solids, parts, pairs = geometry
    R, p, C, seen_R, seen_p, S = work
    least = most
    for k in range(len(Q)):
        place(joints, parts, Q[k], 0, R, p, C)
        for at in range(len(chosen)):
            pair = pairs[chosen[at]]
            if _between_balls(parts, pair, R, C, 0, 0) > least:
                continue
            a, b = pair.a, pair.b
            _seen_from(R, p, 0, pair.frame, parts[a].frame, seen_R, seen_p, 0)
            _seen_from(R, p, 0, pair.frame, parts[b].frame, seen_R, seen_p, 1)
            row = pair.row
            for s in range(parts[a].first, parts[a].end):
                for o in range(parts[b].first, parts[b].end):
                    gap, _ = _separate(vertices, solids, s, o, seen_R, seen_p, 1, least, True, directions, row, S)
                    row += 1
                    if not gap > least:
                        least = gap
                        if least == -np.inf:
                            return least  # nothing was shown
    return least
