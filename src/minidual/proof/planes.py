"""Compiled search for planes that separate two parts, at a state or throughout a stretch.

A part is a union of convex solids: vertex hulls, thickened by a ball or (cylinders) a disc. Two
solids are d apart if along some direction all of one lies d beyond the other. Checking a direction
does not depend on its search (Gilbert, Johnson, Keerthi).

A plane clearing both ends of a stretch by more than both parts deviate separates them throughout.
Bounds on the deviations: docs/proof.md. Links of one arm are seen from the inner one.

NaN counts as not proven: sums propagate it, comparisons drop it.

The helpers are in one file with the kernels, because numba's cache watches the kernel's file alone.
The kernels take plain tuples: numba identifies their types in half the time that named ones take.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from minidual.proof.layout import Geometry, Motion, MotionProof, Padding, Rows, Workspace
from minidual.robot import vectors
from minidual.robot.compiled import inlined, kernel
from minidual.robot.pair import Array

Vector = tuple[float, float, float]

_cross: Any = inlined(vectors.cross)
_dot: Any = inlined(vectors.inner)
_plus: Any = inlined(vectors.plus)
_minus: Any = inlined(vectors.minus)
_times: Any = inlined(vectors.times)

_TRIES = 40
"""Most directions per plane."""
_EXACT_M = 1e-4


class _Stretch(NamedTuple):
    """First and last state; equal for a single state."""

    first: int
    last: int


class _Facing(NamedTuple):
    """Two solids, the row of their plane's direction, and how many states it must separate."""

    a: int
    b: int
    row: int
    ends: int


@inlined
def _vector(a: Array) -> Vector:
    return a[0], a[1], a[2]


@inlined
def _store(a: Array, x: Vector) -> None:
    a[0], a[1], a[2] = x


@inlined
def _turned(R: Array, a: Any) -> Vector:
    return _dot(R[0], a), _dot(R[1], a), _dot(R[2], a)


@inlined
def _turned_back(R: Array, a: Any) -> Vector:
    return _dot(R[:, 0], a), _dot(R[:, 1], a), _dot(R[:, 2], a)


@inlined
def _place(geometry: Geometry, q: Array, n: int, work: Workspace) -> None:
    """Write the poses and centres at q (dof,) into row n."""
    joints = geometry.joints
    parts = geometry.parts
    R = work.R[n]
    p = work.p[n]
    centres = work.centres[n]
    p[0] = 0.0
    R[0] = 0.0
    R[0, 0, 0] = R[0, 1, 1] = R[0, 2, 2] = 1.0
    for j in range(len(joints)):
        f = joints[j].parent
        shift = joints[j].p
        cosine = math.cos(q[j])
        sine = math.sin(q[j])
        for r in range(3):
            row = _vector(R[f, r])
            x, y, z = _turned_back(joints[j].R, row)
            _store(R[j + 1, r], (cosine * x + sine * y, cosine * y - sine * x, z))
            p[j + 1, r] = p[f, r] + row[0] * shift[0] + row[1] * shift[1] + row[2] * shift[2]
    for k in range(len(parts)):
        f = parts[k].frame
        _store(centres[k], _plus(_turned(R[f], parts[k].centre), p[f]))


@inlined
def _see(work: Workspace, n: int, viewer: int, frame: int, to: int) -> None:
    """Write a frame's pose at state n, seen from the viewer's frame, into row `to`."""
    R = work.R[n]
    p = work.p[n]
    for r in range(3):
        viewer_axis = (R[viewer, 0, r], R[viewer, 1, r], R[viewer, 2, r])
        _store(work.seen_R[to, r], _turned_back(R[frame], viewer_axis))
    _store(work.seen_p[to], _turned_back(R[viewer], _minus(p[frame], p[viewer])))


@inlined
def _farthest(geometry: Geometry, k: int, R: Array, p: Array, way: Vector) -> tuple[float, Vector]:
    """Return solid k's extent along `way`, without ball, and its extreme point."""
    clusters = geometry.clusters
    solids = geometry.solids
    own = _turned_back(R, way)
    best_cluster = solids[k].first
    best_vertex = 0
    far = -np.inf
    total = 0.0
    for i in range(best_cluster, solids[k].end):
        most = _dot(clusters[i].centre, own) + clusters[i].radius
        total += most
        if most <= far:
            continue  # most clusters; a state's check takes 3.3 us, 4.5 with every vertex compared
        for j in range(8):
            d = _dot(clusters[i].vertices[j], own)
            if d > far:
                far = d
                best_cluster = i
                best_vertex = j
    if not abs(total) < np.inf:
        far = np.nan  # the comparison drops NaN, the sum does not
    point = _vector(clusters[best_cluster].vertices[best_vertex])
    disc = solids[k].disc
    axis = solids[k].axis
    if disc > 0.0:
        across = _minus(own, _times(_dot(own, axis), axis))
        length = math.sqrt(_dot(across, across))
        far += disc * length
        if length > 0.0:
            point = _plus(point, _times(disc / length, across))
    return far + _dot(way, p), _plus(_turned(R, point), p)


@inlined
def _difference(
    geometry: Geometry,
    facing: _Facing,
    way: Vector,
    work: Workspace,
) -> tuple[float, Vector]:
    """Return solid a's smallest distance beyond b along `way` over the ends, and the difference.

    Even pose rows hold a, odd rows b.
    """
    R = work.seen_R
    p = work.seen_p
    gap = np.inf
    apart = (0.0, 0.0, 0.0)
    for end in range(facing.ends):
        of_a = 2 * end
        of_b = 2 * end + 1
        back, on_a = _farthest(geometry, facing.a, R[of_a], p[of_a], _times(-1.0, way))
        front, on_b = _farthest(geometry, facing.b, R[of_b], p[of_b], way)
        here = -back - front
        if here != here:
            return np.nan, apart
        if not here >= gap:
            gap = here
            apart = _minus(on_a, on_b)
    return gap, apart


@inlined
def _on_triangle(a: Vector, b: Vector, c: Vector) -> Vector:
    """Return weights of the triangle's nearest point to the origin.

    Source: Ericson, "Real-Time Collision Detection", 5.1.5.
    """
    ab = _minus(b, a)
    ac = _minus(c, a)
    d1 = -_dot(ab, a)
    d2 = -_dot(ac, a)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    d3 = -_dot(ab, b)
    d4 = -_dot(ac, b)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    of_c = d1 * d4 - d3 * d2
    if of_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    d5 = -_dot(ab, c)
    d6 = -_dot(ac, c)
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
def _nearest(S: Array, count: int) -> tuple[int, Vector]:
    """Return (count, point), the simplex's nearest point to the origin, and drop unneeded rows."""
    weights = (1.0, 0.0, 0.0)
    i = 0
    j = 1
    k = 2
    if count == 2:
        edge = _minus(S[1], S[0])
        square = _dot(edge, edge)
        t = min(1.0, max(0.0, -_dot(edge, S[0]) / square)) if square > 0.0 else 0.0
        weights = (1.0 - t, t, 0.0)
    elif count == 3:
        weights = _on_triangle(_vector(S[0]), _vector(S[1]), _vector(S[2]))
    elif count == 4:
        least = np.inf
        for face in range(4):
            r = 1 if face == 0 else 0
            s = 2 if face <= 1 else 1
            t = 3 if face <= 2 else 2
            a = _vector(S[r])
            b = _vector(S[s])
            c = _vector(S[t])
            normal = _cross(_minus(b, a), _minus(c, a))
            # The origin is not strictly on the face's inner side.
            if not -_dot(normal, a) * _dot(normal, _minus(_vector(S[face]), a)) > 0.0:
                here = _on_triangle(a, b, c)
                point = _plus(_plus(_times(here[0], a), _times(here[1], b)), _times(here[2], c))
                square = _dot(point, point)
                if square < least:
                    least = square
                    weights = here
                    i = r
                    j = s
                    k = t
        if least == np.inf:
            return 4, (0.0, 0.0, 0.0)
    point = (0.0, 0.0, 0.0)
    kept = 0
    for row, weight in ((i, weights[0]), (j, weights[1]), (k, weights[2])):
        if weight > 0.0:
            corner = _vector(S[row])
            point = _plus(point, _times(weight, corner))
            _store(S[kept], corner)
            kept += 1
    return kept, point


@inlined
def _separate(
    geometry: Geometry,
    facing: _Facing,
    need: float,
    exact: bool,
    work: Workspace,
) -> float:
    """Return a lower bound on the solids' distance at all ends.

    Stops when it exceeds `need` or cannot; if `exact`, within `_EXACT_M` of convergence.
    """
    solids = geometry.solids
    directions = work.directions
    simplex = work.simplex
    thick = solids[facing.a].ball + solids[facing.b].ball
    way = _vector(directions[facing.row])
    if way[0] == 0.0 and way[1] == 0.0 and way[2] == 0.0:
        way = (0.0, 0.0, 1.0)  # arbitrary first direction
    size = np.inf
    count = 0
    best = -np.inf
    best_way = way
    for _ in range(_TRIES):
        gap, apart = _difference(geometry, facing, way, work)
        if gap - thick > best:
            best = gap - thick
            best_way = way
        if best > need:
            break
        _store(simplex[count], apart)
        count, nearest = _nearest(simplex, count + 1)
        length = math.sqrt(_dot(nearest, nearest))
        if not length < size:
            break  # converged
        size = length
        # The length of the nearest difference is an upper bound for every direction.
        if count == 4 or not size - thick > (best + _EXACT_M if exact else need) or size == 0.0:
            break
        way = (nearest[0] / size, nearest[1] / size, nearest[2] / size)
    _store(directions[facing.row], best_way)
    return best


@inlined
def _between_balls(geometry: Geometry, pair: Any, stretch: _Stretch, work: Workspace) -> float:
    """Return the bounding balls' smallest distance on the straight way between the two states."""
    parts = geometry.parts
    R = work.R
    centres = work.centres
    i = stretch.first
    j = stretch.last
    a = pair.a
    b = pair.b
    f = pair.frame
    x = _minus(centres[i, a], centres[i, b])
    if i != j:
        y = _minus(centres[j, a], centres[j, b])
        if f != 0:
            x = _turned_back(R[i, f], x)
            y = _turned_back(R[j, f], y)
        d = _minus(y, x)
        square = _dot(d, d)
        if square > 0.0:
            x = _plus(x, _times(min(1.0, max(0.0, -_dot(x, d) / square)), d))
    return math.sqrt(_dot(x, x)) - parts[a].radius - parts[b].radius


@inlined
def _beside(geometry: Geometry, pair: Any, stretch: _Stretch, work: Workspace) -> float:
    """Return how far a's ball lies beyond b along their last direction.

    -inf unless b is one fixed solid.
    """
    solids = geometry.solids
    parts = geometry.parts
    centres = work.centres
    i = stretch.first
    j = stretch.last
    a = pair.a
    b = pair.b
    way = _vector(work.directions[pair.row])
    if parts[b].frame != 0 or parts[b].end - parts[b].first != 1 or _dot(way, way) == 0.0:
        return -np.inf
    front, _ = _farthest(geometry, parts[b].first, work.R[i, 0], work.p[i, 0], way)
    return (
        min(_dot(centres[i, a], way), _dot(centres[j, a], way))
        - parts[a].radius
        - front
        - solids[parts[b].first].ball
    )


@inlined
def _apart(
    geometry: Geometry,
    pair: Any,
    stretch: _Stretch,
    need: float,
    exact: bool,
    work: Workspace,
) -> float:
    """Return a lower bound on the parts' distance at both ends of the stretch.

    Stops at the first solids within `need`, unless `exact`.
    """
    parts = geometry.parts
    a = pair.a
    b = pair.b
    ends = 1 if stretch.first == stretch.last else 2
    for end in range(ends):
        n = stretch.first if end == 0 else stretch.last
        _see(work, n, pair.frame, parts[a].frame, 2 * end)
        _see(work, n, pair.frame, parts[b].frame, 2 * end + 1)
    least = np.inf
    row = pair.row
    for solid_a in range(parts[a].first, parts[a].end):
        for solid_b in range(parts[b].first, parts[b].end):
            facing = _Facing(solid_a, solid_b, row, ends)
            gap = _separate(geometry, facing, need, exact, work)
            row += 1
            if not gap > need:
                if not exact or gap == -np.inf or gap != gap:
                    return gap
                need = gap
            least = min(least, gap)
    return least


@inlined
def _left_joints(geometry: Geometry) -> int:
    """Return the number of the left arm's joints: the next one hangs on the world again."""
    joints = geometry.joints
    count = 1
    while joints[count].parent != 0:
        count += 1
    return count


@inlined
def _deviate(geometry: Geometry, step: Array, off: Array, table: Array) -> None:
    """Tabulate each part's largest deviation from its chords [m].

    Column i: seen from the link that joint i moves. Last row: fixed parts. `off` [rad] is the
    joints' departure from the straight line.
    """
    parts = geometry.parts
    reach = geometry.reach
    left_n = _left_joints(geometry)
    table[:] = 0.0
    for m in range(len(parts)):
        if parts[m].frame == 0:
            continue
        first = 0
        n = left_n
        if parts[m].frame > left_n:
            first = left_n
            n = len(step) - left_n
        for i in range(n):
            total = 0.0
            inside = 0.0
            for j in range(i, n):
                turn = abs(step[first + j])
                total += reach[m, j] * (off[first + j] + 0.125 * turn * (turn + 2.0 * inside))
                inside += turn
            table[m, i] = total


@inlined
def _off_chord(q: Array, bend: Array, stretch: _Stretch, step: Array, off: Array) -> None:
    """Write the step of a stretch and the largest departure from its straight line, both (dof,).

    `bend`: see `bends`.
    """
    i = stretch.first
    j = stretch.last
    square = 0.0
    total = 0.0
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
            # Between two samples: at most the larger of theirs plus the cubic's own bend.
            away = abs(q[k, c] - q[i, c] - x * step[c]) + max(bend[k, c], bend[max(k - 1, i), c])
            total += away
            off[c] = max(off[c], away)
    if not total < np.inf:  # `max` drops NaN, the sum does not
        off[:] = np.inf


@inlined
def _blocked(
    geometry: Geometry,
    chosen: Rows,
    stretch: _Stretch,
    need: float,
    moved: Array,
    work: Workspace,
) -> bool:
    """Return whether a chosen pair is not proven apart throughout a stretch.

    `moved` is the flattened table of `_deviate`. The blocking pair goes first in `chosen`.
    """
    for at in range(len(chosen)):
        row = chosen[at]
        pair = geometry.pairs[row]
        deviation = moved[pair.moves_a] + moved[pair.moves_b]
        if _between_balls(geometry, pair, stretch, work) - deviation > need:
            continue
        if _beside(geometry, pair, stretch, work) - deviation > need:
            continue
        if not _apart(geometry, pair, stretch, need + deviation, False, work) - deviation > need:
            for k in range(at, 0, -1):
                chosen[k] = chosen[k - 1]
            chosen[0] = row  # likely to fail next, too
            return True
    return False


@kernel()
def bends(q: Array, v: Array, dt: float) -> Array:
    """Return the cubics' departures (n - 1, dof) [rad] from their chords."""
    # A cubic's second derivative is largest at an end; an eighth of it bounds the departure.
    out = np.empty((len(q) - 1, q.shape[1]))
    for k in range(len(out)):
        for c in range(q.shape[1]):
            rise = q[k + 1, c] - q[k, c]
            before = v[k, c] * dt
            after = v[k + 1, c] * dt
            first = 6.0 * rise - 4.0 * before - 2.0 * after
            last = 6.0 * rise - 2.0 * before - 4.0 * after
            out[k, c] = 0.125 * max(abs(first), abs(last))  # one that is NaN makes the other NaN
    return out


def prove(
    geometry: Geometry,
    motion: Motion,
    stretches: Rows,
    chosen: Rows,
    need_m: float,
    work: Workspace,
) -> MotionProof:
    """Prove that pairs stay farther apart than a distance throughout a motion.

    Args:
        geometry: From `Solids`.
        motion: The samples.
        stretches: First and last samples (s, 2), covering the motion.
        chosen: Rows of `geometry.pairs` (c,).
        need_m: The distance [m], including rounding.
        work: For n states.
    """
    return MotionProof(
        *_prove(
            tuple(geometry),
            tuple(motion),
            stretches,
            chosen,
            need_m,
            tuple(work),
        ),
    )


@kernel()
def _prove(
    geometry_arrays: Any,
    motion_arrays: Any,
    stretches: Rows,
    chosen: Rows,
    need: float,
    work_arrays: Any,
) -> tuple[np.ndarray, int, int]:
    geometry = Geometry(*geometry_arrays)
    work = Workspace(*work_arrays)
    q, v, dt = motion_arrays
    n, dof = q.shape
    placed = np.zeros(n, dtype=np.bool_)
    step = np.empty(dof)
    off = np.empty(dof)
    bend = bends(q, v, dt)
    table = np.empty((len(geometry.parts) + 1, geometry.reach.shape[1] + 1))
    moved = table.reshape(-1)
    order = chosen.copy()
    top = len(stretches)
    stack = np.empty((top + 64, 2), dtype=np.int64)
    stack[:top] = stretches[::-1]
    while top > 0:
        top -= 1
        i = stack[top, 0]
        j = stack[top, 1]
        for k in (i, j):
            if not placed[k]:
                _place(geometry, q[k], k, work)
                placed[k] = True
        stretch = _Stretch(i, j)
        _off_chord(q, bend, stretch, step, off)
        _deviate(geometry, step, off, table)
        if not _blocked(geometry, order, stretch, need, moved, work):
            continue
        if j - i < 2:
            return placed, i, order[0]
        middle = (i + j) // 2
        stack[top, 0] = middle
        stack[top, 1] = j
        stack[top + 1, 0] = i
        stack[top + 1, 1] = middle
        top += 2
    return placed, -1, -1


def survey(geometry: Geometry, Q: Array, chosen: Rows, padding: Padding, work: Workspace) -> int:
    """Return the first row of Q (n, dof) that is not free, or n.

    Free: all chosen pairs are proven farther apart than the padding; near a tight state its
    clearance suffices. `chosen` is reordered, blocking pairs first.
    """
    return _survey(tuple(geometry), Q, chosen, tuple(padding), tuple(work))


@kernel()
def _survey(
    geometry_arrays: Any,
    Q: Array,
    chosen: Rows,
    padding_arrays: Any,
    work_arrays: Any,
) -> int:
    geometry = Geometry(*geometry_arrays)
    work = Workspace(*work_arrays)
    padding, tight, clearances, relax = padding_arrays
    still = np.zeros((len(geometry.parts) + 1) * (geometry.reach.shape[1] + 1))
    for k in range(len(Q)):
        need = padding
        for t in range(len(tight)):
            away = 0.0
            for c in range(Q.shape[1]):
                away = max(away, abs(Q[k, c] - tight[t, c]))
            need = min(need, clearances[t] + (padding - clearances[t]) * min(1.0, away / relax))
        _place(geometry, Q[k], 0, work)
        if _blocked(geometry, chosen, _Stretch(0, 0), need, still, work):
            return k
    return len(Q)


def clearance(
    geometry: Geometry,
    Q: Array,
    chosen: Rows,
    most_m: float,
    work: Workspace,
) -> float:
    """Return a lower bound [m] on the chosen pairs' distance over Q (n, dof), at most `most_m`.

    Negative in contact; -inf if nothing is proven.
    """
    return _clearance(tuple(geometry), Q, chosen, most_m, tuple(work))


@kernel()
def _clearance(
    geometry_arrays: Any,
    Q: Array,
    chosen: Rows,
    most: float,
    work_arrays: Any,
) -> float:
    geometry = Geometry(*geometry_arrays)
    work = Workspace(*work_arrays)
    state = _Stretch(0, 0)
    least = most
    for k in range(len(Q)):
        _place(geometry, Q[k], 0, work)
        for at in range(len(chosen)):
            pair = geometry.pairs[chosen[at]]
            if _between_balls(geometry, pair, state, work) > least:
                continue
            gap = _apart(geometry, pair, state, least, True, work)
            if not gap > least:
                least = gap
                if not least > -np.inf:
                    return -np.inf  # nothing was proven
    return least
