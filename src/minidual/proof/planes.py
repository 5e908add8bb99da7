"""Compiled search for planes that separate two parts, at a state or throughout a stretch.

A part is a union of convex solids: vertex hulls, thickened by a ball or (cylinders) a disc. Two solids are d apart if
along some direction all of one lies d beyond the other. Checking a direction does not depend on its search (Gilbert,
Johnson, Keerthi).

A plane clearing both ends of a stretch by more than both parts deviate separates them throughout. Bounds on the
deviations: docs/proof.md. Links of one arm are seen from the inner one.

NaN counts as not proven: sums propagate it, comparisons drop it.
"""

import math
from typing import Any

import numpy as np

from minidual.robot import vectors
from minidual.robot.compiled import inlined, kernel
from minidual.robot.pair import Array

JOINT = np.dtype([("parent", "i8"), ("R", "f8", (3, 3)), ("p", "f8", 3)])
"""Parent frame (0: world, k + 1: joint k) and placement; the joint turns about z."""
CLUSTER = np.dtype([("centre", "f8", 3), ("radius", "f8"), ("vertices", "f8", (8, 3))])
"""Neighbouring vertices of a solid (the last may repeat) in its frame, and their ball [m]."""
SOLID = np.dtype(
    [("first", "i8"), ("end", "i8"), ("ball", "f8"), ("disc", "f8"), ("axis", "f8", 3)],
)
"""Cluster rows, radii of ball and disc [m], disc axis."""
PART = np.dtype(
    [("first", "i8"), ("end", "i8"), ("frame", "i8"), ("centre", "f8", 3), ("radius", "f8")],
)
"""Solid rows, frame, bounding ball [m]."""
PAIR = np.dtype([(name, "i8") for name in ("a", "b", "frame", "row", "moves_a", "moves_b")])
"""Two parts, their planes' frame, first direction row, both indices in `_deviate`'s flattened table."""

Rows = Any
"""Records or integers, (n,)."""
Geometry = tuple[Rows, Rows, Rows, Rows, Rows, Array]
"""Joints (dof,), clusters, solids, parts, pairs, reach (parts, dof / 2) [m]."""
Work = tuple[Array, Array, Array, Array, Array, Array, Array]
"""Plane directions; frame poses R, p and part centres C of n states; a pair's poses R, p at two ends; a simplex."""
Keep = tuple[float, Array, Array, float]
"""Padding [m], tight states (t, dof), their clearances (t,) [m], joint distance [rad] over which clearance grows to
padding."""
Vector = tuple[float, float, float]

_algebra: Any = map(
    inlined,
    (vectors.cross, vectors.inner, vectors.plus, vectors.minus, vectors.times),
)
_cross, _dot, _plus, _minus, _times = _algebra
_TRIES = 40
"""Most directions per plane."""
_EXACT_M = 1e-4


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
def _place(geometry: Geometry, q: Array, n: int, work: Work) -> None:
    """Write poses and centres into row n."""
    joints = geometry[0]
    parts = geometry[3]
    R = work[1][n]
    p = work[2][n]
    C = work[3][n]
    p[0] = 0.0
    R[0] = 0.0
    R[0, 0, 0] = R[0, 1, 1] = R[0, 2, 2] = 1.0
    for j in range(len(joints)):
        f = joints[j].parent
        shift = joints[j].p
        c = math.cos(q[j])
        s = math.sin(q[j])
        for r in range(3):
            row = _vector(R[f, r])
            x, y, z = _turned_back(joints[j].R, row)
            _store(R[j + 1, r], (c * x + s * y, c * y - s * x, z))
            p[j + 1, r] = p[f, r] + row[0] * shift[0] + row[1] * shift[1] + row[2] * shift[2]
    for k in range(len(parts)):
        f = parts[k].frame
        _store(C[k], _plus(_turned(R[f], parts[k].centre), p[f]))


@inlined
def _seen_from(work: Work, n: int, f: int, a: int, to: int) -> None:
    """Write frame a's pose, seen from f, into row `to`."""
    R = work[1][n]
    p = work[2][n]
    seen_R = work[4]
    seen_p = work[5]
    for r in range(3):
        _store(seen_R[to, r], _turned_back(R[a], (R[f, 0, r], R[f, 1, r], R[f, 2, r])))
    _store(seen_p[to], _turned_back(R[f], _minus(p[a], p[f])))


@inlined
def _farthest(geometry: Geometry, k: int, R: Array, p: Array, way: Vector) -> tuple[float, Vector]:
    """Return solid k's extent along `way`, without ball, and its extreme point."""
    clusters = geometry[1]
    solids = geometry[2]
    own = _turned_back(R, way)
    at = solids[k].first
    of = 0
    far = -np.inf
    total = 0.0
    for i in range(at, solids[k].end):
        most = _dot(clusters[i].centre, own) + clusters[i].radius
        total += most
        if most <= far:
            continue  # most clusters; a state's check takes 3.3 us, 4.5 with every vertex asked
        for j in range(8):
            d = _dot(clusters[i].vertices[j], own)
            if d > far:
                far = d
                at = i
                of = j
    if not abs(total) < np.inf:
        far = np.nan  # the comparison drops NaN, the sum does not
    point = _vector(clusters[at].vertices[of])
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
    a: int,
    b: int,
    ends: int,
    way: Vector,
    work: Work,
) -> tuple[float, Vector]:
    """Return solid a's smallest distance beyond b along `way` over the ends, and the difference vector.

    Even pose rows hold a, odd rows b.
    """
    R = work[4]
    p = work[5]
    gap = np.inf
    apart = (0.0, 0.0, 0.0)
    for end in range(ends):
        back, on_a = _farthest(geometry, a, R[2 * end], p[2 * end], _times(-1.0, way))
        front, on_b = _farthest(geometry, b, R[2 * end + 1], p[2 * end + 1], way)
        here = -back - front
        if here != here:
            return np.nan, apart
        if not here >= gap:
            gap = here
            apart = _minus(on_a, on_b)
    return gap, apart


@inlined
def _on_triangle(a: Vector, b: Vector, c: Vector) -> Vector:
    """Return weights of the triangle's nearest point to the origin (Ericson, Real-Time Collision Detection, 5.1.5)."""
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
    a: int,
    b: int,
    ends: int,
    need: float,
    exact: bool,
    row: int,
    work: Work,
) -> float:
    """Return a lower bound on the solids' distance at all ends.

    Stops when it exceeds `need` or cannot; if `exact`, within `_EXACT_M` of convergence.
    """
    solids = geometry[2]
    directions = work[0]
    S = work[6]
    thick = solids[a].ball + solids[b].ball
    way = _vector(directions[row])
    if way[0] == 0.0 and way[1] == 0.0 and way[2] == 0.0:
        way = (0.0, 0.0, 1.0)  # arbitrary first direction
    size = np.inf
    count = 0
    best = -np.inf
    best_way = way
    for _ in range(_TRIES):
        gap, apart = _difference(geometry, a, b, ends, way, work)
        if gap - thick > best:
            best = gap - thick
            best_way = way
        if best > need:
            break
        _store(S[count], apart)
        count, nearest = _nearest(S, count + 1)
        length = math.sqrt(_dot(nearest, nearest))
        if not length < size:
            break  # converged
        size = length
        # The length of the nearest difference is an upper bound for every direction.
        if count == 4 or not size - thick > (best + _EXACT_M if exact else need) or size == 0.0:
            break
        way = (nearest[0] / size, nearest[1] / size, nearest[2] / size)
    _store(directions[row], best_way)
    return best


@inlined
def _between_balls(geometry: Geometry, pair: Any, i: int, j: int, work: Work) -> float:
    """Return the bounding balls' smallest distance at states i and j."""
    parts = geometry[3]
    R = work[1]
    C = work[3]
    a = pair.a
    b = pair.b
    f = pair.frame
    x = _minus(C[i, a], C[i, b])
    if i != j:
        y = _minus(C[j, a], C[j, b])
        if f != 0:
            x = _turned_back(R[i, f], x)
            y = _turned_back(R[j, f], y)
        d = _minus(y, x)
        square = _dot(d, d)
        if square > 0.0:
            x = _plus(x, _times(min(1.0, max(0.0, -_dot(x, d) / square)), d))
    return math.sqrt(_dot(x, x)) - parts[a].radius - parts[b].radius


@inlined
def _beside(geometry: Geometry, pair: Any, i: int, j: int, work: Work) -> float:
    """Return how far a's ball lies beyond b along their last direction; -inf unless b is one fixed solid."""
    solids = geometry[2]
    parts = geometry[3]
    R = work[1]
    p = work[2]
    C = work[3]
    a = pair.a
    b = pair.b
    way = _vector(work[0][pair.row])
    if parts[b].frame != 0 or parts[b].end - parts[b].first != 1 or _dot(way, way) == 0.0:
        return -np.inf
    front, _ = _farthest(geometry, parts[b].first, R[i, 0], p[i, 0], way)
    return (
        min(_dot(C[i, a], way), _dot(C[j, a], way))
        - parts[a].radius
        - front
        - solids[parts[b].first].ball
    )


@inlined
def _apart(
    geometry: Geometry,
    pair: Any,
    i: int,
    j: int,
    need: float,
    exact: bool,
    work: Work,
) -> float:
    """Return a lower bound on the parts' distance at states i and j.

    Stops at the first solids within `need`, unless `exact`.
    """
    parts = geometry[3]
    a = pair.a
    b = pair.b
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

    Last row: fixed parts. `off` [rad]: departure from the straight line.
    """
    parts = geometry[3]
    reach = geometry[5]
    n = reach.shape[1]
    table[:] = 0.0
    for m in range(len(parts)):
        if parts[m].frame == 0:
            continue
        first = n if parts[m].frame > n else 0
        for i in range(n):
            total = 0.0
            inside = 0.0
            for j in range(i, n):
                turn = abs(step[first + j])
                total += reach[m, j] * (off[first + j] + 0.125 * turn * (turn + 2.0 * inside))
                inside += turn
            table[m, i] = total


@inlined
def _off_chord(q: Array, bend: Array, i: int, j: int, step: Array, off: Array) -> None:
    """Write the step from sample i to j and the largest departure from the straight line.

    `bend`: see `bends`.
    """
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
            # Between two samples the departure is at most the larger of theirs plus the cubic's own bend.
            away = abs(q[k, c] - q[i, c] - x * step[c]) + max(bend[k, c], bend[max(k - 1, i), c])
            total += away
            off[c] = max(off[c], away)
    if not total < np.inf:  # `max` drops NaN, the sum does not
        off[:] = np.inf


@inlined
def _blocked(
    geometry: Geometry,
    chosen: Rows,
    i: int,
    j: int,
    need: float,
    moved: Array,
    work: Work,
) -> bool:
    """Return whether a pair is not proven apart at states i and j, whose parts deviate by `moved` (see `_deviate`); put it first in `chosen`."""
    for at in range(len(chosen)):
        row = chosen[at]
        pair = geometry[4][row]
        deviation = moved[pair.moves_a] + moved[pair.moves_b]
        if _between_balls(geometry, pair, i, j, work) - deviation > need:
            continue
        if _beside(geometry, pair, i, j, work) - deviation > need:
            continue
        if not _apart(geometry, pair, i, j, need + deviation, False, work) - deviation > need:
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


@kernel()
def prove(
    geometry: Geometry,
    q: Array,
    v: Array,
    dt: float,
    stretches: Rows,
    chosen: Rows,
    need: float,
    work: Work,
) -> tuple[np.ndarray, int, int]:
    """Prove that pairs stay farther apart than `need` throughout a motion.

    Args:
        geometry: From `Solids`.
        q: Samples (n, dof) [rad], n >= 2, joined by cubics.
        v: [rad/s].
        dt: Step [s].
        stretches: First and last samples (s, 2), covering the motion.
        chosen: (c,) rows of `pairs`.
        need: [m], including rounding.
        work: For n states.

    Returns:
        Ends of stretches (n,) bool; the unproven step's first sample and pair, or -1, -1.
    """
    n, dof = q.shape
    asked = np.zeros(n, dtype=np.bool_)
    step = np.empty(dof)
    off = np.empty(dof)
    bend = bends(q, v, dt)
    table = np.empty((len(geometry[3]) + 1, geometry[5].shape[1] + 1))
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
            if not asked[k]:
                _place(geometry, q[k], k, work)
                asked[k] = True
        _off_chord(q, bend, i, j, step, off)
        _deviate(geometry, step, off, table)
        if not _blocked(geometry, order, i, j, need, moved, work):
            continue
        if j - i < 2:
            return asked, i, order[0]
        middle = (i + j) // 2
        stack[top, 0], stack[top, 1] = middle, j
        stack[top + 1, 0], stack[top + 1, 1] = i, middle
        top += 2
    return asked, -1, -1


@kernel()
def survey(geometry: Geometry, Q: Array, chosen: Rows, keep: Keep, work: Work) -> int:
    """Return the first row of Q (n, dof) that is not free, or n.

    Free: all pairs are proven farther apart than the padding; near a tight state its clearance suffices (see `Keep`).
    `chosen` is reordered, blocking pairs first.
    """
    padding, tight, clearances, relax = keep
    still = np.zeros((len(geometry[3]) + 1) * (geometry[5].shape[1] + 1))
    for k in range(len(Q)):
        need = padding
        for t in range(len(tight)):
            away = 0.0
            for c in range(Q.shape[1]):
                away = max(away, abs(Q[k, c] - tight[t, c]))
            need = min(need, clearances[t] + (padding - clearances[t]) * min(1.0, away / relax))
        _place(geometry, Q[k], 0, work)
        if _blocked(geometry, chosen, 0, 0, need, still, work):
            return k
    return len(Q)


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
