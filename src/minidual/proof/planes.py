"""Compiled search for planes that separate two parts, at a state or throughout a stretch.

A part is a union of convex solids: vertex hulls, thickened by a ball or disc (cylinders). Two solids are d apart if
along some direction all of one lies d beyond the other. Checking a direction is independent of its search (Gilbert,
Johnson, Keerthi).

A stretch is compared with the straight joint-space line between its ends. Along it a vertex's second derivative is at
most a sum over joint pairs: both steps times the distance from the outer axis. An eighth of this bounds its distance
from its chord. Leaving the line by e_j adds at most r_j e_j (r_j: reach). A plane clearing both ends by more than both
deviations separates the solids throughout. Links of one arm are seen from the inner one.

NaN counts as not proven: sums propagate it, comparisons drop it. Helpers share this file because numba's cache watches
no other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from minidual.robot.compiled import inlined, kernel
from minidual.robot.pair import Array

JOINT = np.dtype([("parent", "i8"), ("R", "f8", (3, 3)), ("p", "f8", 3)])
"""Parent frame (0: world, k + 1: joint k) and placement; the joint turns about z."""
SOLID = np.dtype([("first", "i8"), ("end", "i8")] + [(name, "f8") for name in ("ball", "disc", "x", "y", "z")])
"""Vertex rows, radii [m], disc axis."""
PART = np.dtype(
    [(name, "i8") for name in ("first", "end", "frame")] + [(name, "f8") for name in ("x", "y", "z", "radius")]
)
"""Solid rows, frame, bounding ball [m]."""
PAIR = np.dtype([(name, "i8") for name in ("a", "b", "frame", "row", "moves_a", "moves_b")])
"""Two parts, their planes' frame, first direction row, both parts' indices in `_deviate`'s flattened table."""

Rows = Any
"""Records or integers, (n,)."""
Geometry = tuple[Rows, Array, Rows, Rows, Rows, Array]
"""Joints (dof,), vertices (v, 3) [m] in their frames, solids, parts, pairs, reach (parts, dof / 2) [m]."""
Work = tuple[Array, Array, Array, Array, Array, Array, Array]
"""Plane directions; frame poses R, p and part centres C of n states; a pair's poses R, p at two ends; a simplex."""
Keep = tuple[float, Array, Array, float]
"""Padding [m], tight states (t, dof), their clearances (t,) [m], joint distance [rad] over which clearance grows to
padding."""
Point = tuple[float, float, float, float]
"""A distance and a point."""

_TRIES = 40
"""Most directions per plane."""
_EXACT_M = 1e-4


@inlined
def _place(geometry: Geometry, q: Array, n: int, work: Work) -> None:
    """Write poses and centres into row n."""
    joints, parts = geometry[0], geometry[3]
    R, p, C = work[1], work[2], work[3]
    for r in range(3):
        for c in range(3):
            R[n, 0, r, c] = 1.0 if r == c else 0.0
        p[n, 0, r] = 0.0
    for j in range(len(joints)):
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


@inlined
def _seen_from(work: Work, n: int, f: int, a: int, to: int) -> None:
    """Write frame a's pose, seen from f, into row `to`."""
    R, p, seen_R, seen_p = work[1], work[2], work[4], work[5]
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


@inlined
def _farthest(geometry: Geometry, k: int, R: Array, p: Array, n: int, x: float, y: float, z: float) -> Point:
    """Return solid k's extent along (x, y, z), without ball, and extreme point."""
    vertices, solids = geometry[1], geometry[2]
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
        far = np.nan  # the comparison drops NaN, the sum does not
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


@inlined
def _difference(geometry: Geometry, a: int, b: int, ends: int, x: float, y: float, z: float, work: Work) -> Point:
    """Return solid a's smallest distance beyond b along (x, y, z) over the ends, and the difference vector.

    Even pose rows hold a, odd rows b.
    """
    R, p = work[4], work[5]
    gap = np.inf
    sx, sy, sz = 0.0, 0.0, 0.0
    for end in range(ends):
        back, ax, ay, az = _farthest(geometry, a, R, p, 2 * end, -x, -y, -z)
        front, bx, by, bz = _farthest(geometry, b, R, p, 2 * end + 1, x, y, z)
        here = -back - front
        if here != here:
            return np.nan, ax - bx, ay - by, az - bz
        if not here >= gap:
            gap = here
            sx, sy, sz = ax - bx, ay - by, az - bz
    return gap, sx, sy, sz


@inlined
def _on_triangle(S: Array, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Return weights of the triangle's nearest point to the origin (Ericson, Real-Time Collision Detection, 5.1.5)."""
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


@inlined
def _outside(S: Array, i: int, j: int, k: int, m: int) -> bool:
    """Return whether the triangle does not have origin and row m on one side."""
    ux, uy, uz = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1], S[j, 2] - S[i, 2]
    vx, vy, vz = S[k, 0] - S[i, 0], S[k, 1] - S[i, 1], S[k, 2] - S[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    here = -(nx * S[i, 0] + ny * S[i, 1] + nz * S[i, 2])
    there = nx * (S[m, 0] - S[i, 0]) + ny * (S[m, 1] - S[i, 1]) + nz * (S[m, 2] - S[i, 2])
    return not here * there > 0.0


@inlined
def _nearest(S: Array, count: int) -> tuple[int, float, float, float]:
    """Return (count, x, y, z), the simplex's nearest point to the origin, and drop unneeded rows."""
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


@inlined
def _separate(geometry: Geometry, a: int, b: int, ends: int, need: float, exact: bool, row: int, work: Work) -> float:
    """Return a lower bound on the solids' distance at all ends.

    Stops when the bound exceeds `need` or cannot; if `exact`, within `_EXACT_M` of convergence.
    """
    solids, directions, S = geometry[2], work[0], work[6]
    thick = solids[a].ball + solids[b].ball
    x, y, z = directions[row, 0], directions[row, 1], directions[row, 2]
    size, count = np.inf, 0
    if x == 0.0 and y == 0.0 and z == 0.0:
        z = 1.0  # arbitrary first direction
    best, bx, by, bz = -np.inf, x, y, z
    for _ in range(_TRIES):
        gap, sx, sy, sz = _difference(geometry, a, b, ends, x, y, z, work)
        if gap - thick > best:
            best, bx, by, bz = gap - thick, x, y, z
        if best > need:
            break
        S[count, 0], S[count, 1], S[count, 2] = sx, sy, sz
        count, wx, wy, wz = _nearest(S, count + 1)
        length = math.sqrt(wx * wx + wy * wy + wz * wz)
        if not length < size:
            break  # converged
        size = length
        # The length of the nearest difference is an upper bound for every direction.
        if count == 4 or not size - thick > (best + _EXACT_M if exact else need) or size == 0.0:
            break
        x, y, z = wx / size, wy / size, wz / size
    directions[row, 0], directions[row, 1], directions[row, 2] = bx, by, bz
    return best


@inlined
def _between_balls(geometry: Geometry, pair: Any, i: int, j: int, work: Work) -> float:
    """Return the bounding balls' smallest distance between states i and j."""
    parts, R, C = geometry[3], work[1], work[3]
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


@inlined
def _beside(geometry: Geometry, pair: Any, i: int, j: int, work: Work) -> float:
    """Return how far a's ball lies beyond b along their last direction; -inf unless b is one fixed solid."""
    solids, parts = geometry[2], geometry[3]
    directions, R, p, C = work[0], work[1], work[2], work[3]
    a, b = pair.a, pair.b
    x, y, z = directions[pair.row, 0], directions[pair.row, 1], directions[pair.row, 2]
    if parts[b].frame != 0 or parts[b].end - parts[b].first != 1 or (x == 0.0 and y == 0.0 and z == 0.0):
        return -np.inf
    front, _, _, _ = _farthest(geometry, parts[b].first, R[i], p[i], 0, x, y, z)
    back = min(C[i, a, 0] * x + C[i, a, 1] * y + C[i, a, 2] * z, C[j, a, 0] * x + C[j, a, 1] * y + C[j, a, 2] * z)
    return back - parts[a].radius - front - solids[parts[b].first].ball


@inlined
def _apart(geometry: Geometry, pair: Any, i: int, j: int, need: float, exact: bool, work: Work) -> float:
    """Return a lower bound on the parts' distance at states i and j.

    Stops at the first solids within `need`, unless `exact`.
    """
    parts = geometry[3]
    a, b = pair.a, pair.b
    ends = 1 if i == j else 2
    for end in range(ends):
        n = i if end == 0 else j
        _seen_from(work, n, pair.frame, parts[a].frame, 2 * end)
        _seen_from(work, n, pair.frame, parts[b].frame, 2 * end + 1)
    least = np.inf
    row = pair.row
    for s in range(parts[a].first, parts[a].end):
        for o in range(parts[b].first, parts[b].end):
            gap = _separate(geometry, s, o, ends, need, exact, row, work)
            row += 1
            if not gap > need:
                if not exact or gap == -np.inf or gap != gap:
                    return gap
                need = gap
            least = min(least, gap)
    return least


@inlined
def _deviate(geometry: Geometry, step: Array, off: Array, table: Array) -> None:
    """Tabulate each part's largest deviation from its chords [m], seen from the link that joint i moves.

    The last row is for fixed parts. `off` [rad]: departure from the straight line.
    """
    parts, reach = geometry[3], geometry[5]
    n = reach.shape[1]
    table[:] = 0.0
    for m in range(len(parts)):
        if parts[m].frame == 0:
            continue
        first = n if parts[m].frame > n else 0
        for i in range(n):
            total, inside = 0.0, 0.0
            for j in range(i, n):
                turn = abs(step[first + j])
                total += reach[m, j] * (off[first + j] + 0.125 * turn * (turn + 2.0 * inside))
                inside += turn
            table[m, i] = total


@inlined
def _off_chord(q: Array, bend: Array, i: int, j: int, step: Array, off: Array) -> None:
    """Write the step from sample i to j and the largest departure from the straight line.

    `bend` (n - 1, dof): departures between neighbouring samples.
    """
    square, total = 0.0, 0.0
    for c in range(q.shape[1]):
        step[c] = q[j, c] - q[i, c]
        off[c] = 0.0
        square += step[c] * step[c]
    for k in range(i, j):
        x = 0.0
        if square > 0.0:
            for c in range(q.shape[1]):
                x += (q[k, c] - q[i, c]) * step[c]
            x = min(1.0, max(0.0, x / square))
        for c in range(q.shape[1]):
            # Between two samples the departure is at most the larger of theirs plus the cubic's own bend.
            away = abs(q[k, c] - q[i, c] - x * step[c]) + max(bend[k, c], bend[max(k - 1, i), c])
            total += away
            off[c] = max(off[c], away)
    if not total < np.inf:  # `max` drops NaN, the sum does not
        for c in range(q.shape[1]):
            off[c] = np.inf


@inlined
def _bends(q: Array, v: Array, dt: float, bend: Array) -> None:
    """Write the cubics' departures (n - 1, dof) [rad] from their chords."""
    for k in range(len(q) - 1):
        for c in range(q.shape[1]):
            # A cubic's second derivative is largest at an end; an eighth of it bounds the departure.
            rise, before, after = q[k + 1, c] - q[k, c], v[k, c] * dt, v[k + 1, c] * dt
            first = 6.0 * rise - 4.0 * before - 2.0 * after
            last = -6.0 * rise + 2.0 * before + 4.0 * after
            bend[k, c] = 0.125 * max(abs(first), abs(last))


@inlined
def _first_stretches(q: Array, length: float, stack: Array) -> int:
    """Stack stretches of about `length`, first on top; return their number."""
    last = len(q) - 1
    whole = 0.0
    for k in range(last):
        for c in range(q.shape[1]):
            whole += abs(q[k + 1, c] - q[k, c])
    count = max(1, min(len(stack) // 2, math.ceil(whole / length))) if whole < np.inf else 1
    begin, gone, done = 0, 0.0, 0
    for k in range(last):
        for c in range(q.shape[1]):
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
    geometry: Geometry, q: Array, v: Array, dt: float, length: float, chosen: Rows, need: float, directions: Array
) -> tuple[np.ndarray, int, int]:
    """Prove that pairs stay farther apart than `need` throughout a motion.

    Args:
        geometry: From `Solids`.
        q: Samples (n, dof) [rad], n >= 2, joined by cubics.
        v: Velocities [rad/s].
        dt: Step [s].
        length: First stretches' [rad], summed over joints.
        chosen: (c,) rows of `pairs`.
        need: [m], including rounding.
        directions: (r, 3), updated.

    Returns:
        Ends of stretches (n,) bool; the unproven step's first sample and pair, or -1, -1.
    """
    parts, pairs = geometry[3], geometry[4]
    n, dof = q.shape
    R, p, C = np.empty((n, dof + 1, 3, 3)), np.empty((n, dof + 1, 3)), np.empty((n, len(parts), 3))
    work = (directions, R, p, C, np.empty((4, 3, 3)), np.empty((4, 3)), np.empty((4, 3)))
    asked = np.zeros(n, dtype=np.bool_)
    bend, step, off = np.empty((n - 1, dof)), np.empty(dof), np.empty(dof)
    table = np.empty((len(parts) + 1, geometry[5].shape[1] + 1))
    moved = table.reshape(-1)
    order = chosen.copy()
    stack = np.empty((512, 2), dtype=np.int64)
    _bends(q, v, dt, bend)
    top = _first_stretches(q, length, stack)
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        for k in (i, j):
            if not asked[k]:
                _place(geometry, q[k], k, work)
                asked[k] = True
        _off_chord(q, bend, i, j, step, off)
        _deviate(geometry, step, off, table)
        open_at = -1
        for at in range(len(order)):
            pair = pairs[order[at]]
            deviation = moved[pair.moves_a] + moved[pair.moves_b]
            if _between_balls(geometry, pair, i, j, work) - deviation > need:
                continue
            if _beside(geometry, pair, i, j, work) - deviation > need:
                continue
            if not _apart(geometry, pair, i, j, need + deviation, False, work) - deviation > need:
                open_at = at
                break
        if open_at < 0:
            continue
        # The pair that failed is likely to fail in the halves too: check it first.
        row = _to_front(order, open_at)
        if j - i < 2:
            return asked, i, row
        middle = (i + j) // 2
        stack[top, 0], stack[top, 1] = middle, j
        stack[top + 1, 0], stack[top + 1, 1] = i, middle
        top += 2
    return asked, -1, -1


@inlined
def _to_front(order: Rows, at: int) -> int:
    """Move one element to the front and return it."""
    row = order[at]
    for k in range(at, 0, -1):
        order[k] = order[k - 1]
    order[0] = row
    return row


@inlined
def _free(geometry: Geometry, q: Array, chosen: Rows, keep: Keep, work: Work) -> bool:
    """Check one state for `survey`."""
    padding, tight, clearances, relax = keep
    pairs = geometry[4]
    need = padding
    for t in range(len(tight)):
        away = 0.0
        for c in range(len(q)):
            away = max(away, abs(q[c] - tight[t, c]))
        need = min(need, clearances[t] + (padding - clearances[t]) * min(1.0, away / relax))
    _place(geometry, q, 0, work)
    for at in range(len(chosen)):
        pair = pairs[chosen[at]]
        if _between_balls(geometry, pair, 0, 0, work) > need or _beside(geometry, pair, 0, 0, work) > need:
            continue
        if not _apart(geometry, pair, 0, 0, need, False, work) > need:
            _to_front(chosen, at)
            return False
    return True


@kernel()
def survey(geometry: Geometry, Q: Array, chosen: Rows, keep: Keep, work: Work) -> int:
    """Return the first row of Q (n, dof) that is not free, or n.

    Free: all pairs are proven farther apart than the padding. At a tight state its clearance suffices, growing linearly
    to the padding within `relax`. `chosen` is reordered, blocking pairs first.
    """
    for k in range(len(Q)):
        if not _free(geometry, Q[k], chosen, keep, work):
            return k
    return len(Q)


@kernel()
def sweep(
    geometry: Geometry, a: Array, b: Array, fractions: Array, q: Array, chosen: Rows, keep: Keep, work: Work
) -> int:
    """Run `survey` on a + fractions[k] (b - a)."""
    for k in range(len(fractions)):
        for c in range(len(q)):
            q[c] = a[c] + fractions[k] * (b[c] - a[c])
        if not _free(geometry, q, chosen, keep, work):
            return k
    return len(fractions)


@kernel()
def clearance(geometry: Geometry, Q: Array, chosen: Rows, most: float, work: Work) -> float:
    """Return a lower bound [m] on the smallest distance over Q (n, dof), at most `most`.

    Negative in contact; -inf if nothing is proven.
    """
    pairs = geometry[4]
    least = most
    for k in range(len(Q)):
        _place(geometry, Q[k], 0, work)
        for at in range(len(chosen)):
            pair = pairs[chosen[at]]
            if _between_balls(geometry, pair, 0, 0, work) > least:
                continue
            gap = _apart(geometry, pair, 0, 0, least, True, work)
            if not gap > least:
                least = gap
                if not least > -np.inf:
                    return -np.inf  # nothing was proven
    return least
