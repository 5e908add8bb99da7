"""Cover a mesh with convex pieces.

The cover is one hull, or up to `parts_max` hulls found by cutting with planes. Lids (convex hulls of the cut's loops)
close both halves, so each half's hull contains its side of the solid.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from minidual.collision.shapes import IDENTITY, Mesh, Quat, Vec3
from minidual.errors import DataError, UsageError
from minidual.robot.pair import Array

PARTS_MAX = 64
SUFFIXES = (".stl", ".obj", ".ply", ".off", ".dae", ".glb", ".gltf")
_EXTENT_MAX_M = 10.0
_EXTENT_MIN_M = 1e-4
_SAVING_MIN = 1e-3
_LEVELS_MAX = 8
_FRACTIONS = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)


@dataclass(frozen=True)
class MeshReport:
    """Quality of the cover.

    Attributes:
        volume_m3: None for an open mesh.
        hull_volume_m3: Sum over pieces, which may overlap.
    """

    faces_n: int
    pieces_n: int
    volume_m3: float | None
    hull_volume_m3: float

    def __str__(self) -> str:
        fit = (
            "an open surface"
            if self.volume_m3 is None
            else f"{self.hull_volume_m3 / self.volume_m3:.2f} times its volume"
        )
        return f"{self.faces_n} faces in {self.pieces_n} convex pieces ({fit})"


def load_mesh(
    path: Path, name: str, position_m: Vec3, quat_wxyz: Quat = IDENTITY, *, scale: float = 1.0, parts_max: int = 1
) -> tuple[Mesh, MeshReport]:
    """Read a mesh file (STL, OBJ, PLY, OFF, Collada, glTF) as convex pieces.

    `scale` is metres per unit of the file.

    Raises:
        UsageError: Missing file, unknown extension, bad scale, size or `parts_max`.
        DataError: Unreadable, or without volume.
    """
    if not (np.isfinite(scale) and scale > 0.0):
        raise UsageError(f"mesh '{name}': scale {scale}; it must be a finite number > 0")
    if not 1 <= parts_max <= PARTS_MAX:
        raise UsageError(f"mesh '{name}': parts_max_n = {parts_max}; it must be from 1 to {PARTS_MAX}")
    mesh = _read(path, name)
    mesh.apply_scale(scale)
    extent = float(np.max(mesh.extents))
    if not _EXTENT_MIN_M <= extent <= _EXTENT_MAX_M:
        raise UsageError(
            f"mesh '{name}' ({path.name}) measures {' x '.join(f'{v:.4g}' for v in mesh.extents)} m at scale {scale:g}; "
            f"its longest side must be from {_EXTENT_MIN_M} to {_EXTENT_MAX_M} m",
            remedy="a file in millimetres needs scale: 0.001",
        )
    pieces = _cover(np.asarray(mesh.triangles, dtype=float), parts_max)
    if not pieces:
        raise DataError(f"mesh '{name}' ({path.name}) is flat: it encloses no volume")
    report = MeshReport(
        len(mesh.faces),
        len(pieces),
        float(mesh.volume) if mesh.is_watertight else None,
        float(sum(volume for volume, _ in pieces)),
    )
    blobs = tuple(np.ascontiguousarray(points).tobytes() for _, points in pieces)
    return Mesh(name, position_m, quat_wxyz, blobs, str(path)), report


def _read(path: Path, name: str) -> Any:
    import trimesh

    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"mesh '{name}': {path.name} has the extension '{path.suffix}'; known are {', '.join(SUFFIXES)}"
        )
    if not path.is_file():
        raise UsageError(f"mesh '{name}': there is no file {path}")
    try:
        mesh = trimesh.load(path, force="mesh")
    except Exception as error:  # trimesh's readers raise errors of many types
        raise DataError(
            f"mesh '{name}': {path.name} does not load: {type(error).__name__}: {error}",
            remedy="open it in a mesh viewer and export it again",
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise DataError(f"mesh '{name}': {path.name} holds no triangles")
    if not np.isfinite(mesh.vertices).all():
        raise DataError(f"mesh '{name}': {path.name} holds a vertex that is not finite")
    return mesh


_Piece = tuple[float, Array]
"""Volume [m^3] and vertices (n, 3)."""


def _cover(triangles: Array, parts_max: int) -> list[_Piece]:
    """Cut triangles (n, 3, 3) where it saves the most volume."""
    counter = itertools.count()
    first = _hull(triangles)
    if first is None:
        return []
    done: list[_Piece] = []
    heap = [_entry(triangles, first, counter)]
    while heap and len(heap) + len(done) < parts_max:
        saved, _, own, halves = heapq.heappop(heap)
        if -saved < _SAVING_MIN * first[0]:
            done.append(own)
            continue
        for half, hull in halves:
            heapq.heappush(heap, _entry(half, hull, counter))
    return sorted(done + [own for _, _, own, _ in heap], key=lambda piece: -piece[0])


def _entry(triangles: Array, hull: _Piece, counter: itertools.count[int]) -> Any:
    """Return (-volume saved, order, hull, halves)."""
    saved, halves = _best_cut(triangles, hull, _FRACTIONS)
    if saved < _SAVING_MIN * hull[0]:
        # One cut through a ring saves nothing, two do: look one cut ahead.
        for axis in range(3):
            tried = _halves(triangles, axis, _planes(triangles[:, :, axis], (0.5,))[0])
            if len(tried) == 2:
                later = sum(_best_cut(shell, piece, (0.5,))[0] for shell, piece in tried)
                gain = hull[0] - sum(piece[0] for _, piece in tried) + later
                if gain > saved:
                    saved, halves = gain, tried
    return (-saved, next(counter), hull, halves)


def _best_cut(triangles: Array, hull: _Piece, fractions: tuple[float, ...]) -> tuple[float, list[tuple[Array, _Piece]]]:
    """Return the volume saved by the best cut, and its halves."""
    best: tuple[float, list[tuple[Array, _Piece]]] = (0.0, [])
    for axis in range(3):
        for at in _planes(triangles[:, :, axis], fractions):
            halves = _halves(triangles, axis, at)
            saved = hull[0] - sum(piece[0] for _, piece in halves)
            if len(halves) == 2 and saved > best[0]:
                best = (saved, halves)
    return best


def _planes(heights: Array, fractions: tuple[float, ...]) -> list[float]:
    """Return cuts at fractions of the height and beside few levels."""
    low, high = float(heights.min()), float(heights.max())
    levels = np.unique(heights.round(9))[1:-1]
    # Beside a face, not in it: a triangle in the plane would be neither above nor below.
    beside = 1e-6 * (high - low)
    faces = [float(z) + side for z in levels for side in (-beside, beside)] if len(levels) <= _LEVELS_MAX else []
    return [low + f * (high - low) for f in fractions] + faces


def _halves(triangles: Array, axis: int, at: float) -> list[tuple[Array, _Piece]]:
    shells = cut(triangles, axis, at)
    return [(shell, piece) for shell in shells if (piece := _hull(shell)) is not None]


def cut(triangles: Array, axis: int, at: float) -> tuple[Array, Array]:
    """Cut triangles (n, 3, 3) by a plane; return (above, below) with lids."""
    height = triangles[:, :, axis] - at
    above = (height >= 0.0).sum(axis=1)
    sides = {3: [triangles[above == 3]], 0: [triangles[above == 0]]}
    rim: list[Array] = []
    for lone_above in (1, 2):
        rows = above == lone_above
        chosen, h = triangles[rows], height[rows]
        # Rotate each triangle's corners so that the one alone on its side comes first.
        alone = np.argmax((h >= 0.0) == (lone_above == 1), axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        chosen = np.take_along_axis(chosen, order[:, :, None], axis=1)
        h = np.take_along_axis(h, order, axis=1)
        a, b, c = chosen[:, 0], chosen[:, 1], chosen[:, 2]
        p = a + (b - a) * (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None]
        r = a + (c - a) * (h[:, 0] / (h[:, 0] - h[:, 2]))[:, None]
        p[:, axis] = r[:, axis] = at
        tip = [np.stack([a, p, r], axis=1)]
        rest = [np.stack([p, b, c], axis=1), np.stack([p, c, r], axis=1)]
        sides[3] += tip if lone_above == 1 else rest
        sides[0] += rest if lone_above == 1 else tip
        rim.append(np.stack([p, r], axis=1))
    lids = _lids(np.concatenate(rim), axis, float(np.ptp(triangles.reshape(-1, 3), axis=0).max()))
    return np.concatenate([*sides[3], lids]), np.concatenate([*sides[0], lids])


def _lids(segments: Array, axis: int, size: float) -> Array:
    """Cover each loop of a rim (k, 2, 3) with its planar hull."""
    if len(segments) == 0:
        return np.zeros((0, 3, 3))
    points = segments.reshape(-1, 3)
    ends = np.arange(len(points)).reshape(-1, 2)
    near = KDTree(points).query_pairs(1e-7 * size, output_type="ndarray").reshape(-1, 2)
    edges = np.vstack([ends, near])
    links = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(points), len(points)))
    loops_n, loop = connected_components(links, directed=False)
    flat = [k for k in range(3) if k != axis]
    lids = []
    for index in range(loops_n):
        own = points[loop == index]
        try:
            corners = own[ConvexHull(own[:, flat]).vertices]
        except QhullError:
            continue  # a sliver without area
        fan = np.arange(1, len(corners) - 1)
        lids.append(np.stack([np.broadcast_to(corners[0], (len(fan), 3)), corners[fan], corners[fan + 1]], axis=1))
    return np.concatenate(lids) if lids else np.zeros((0, 3, 3))


def _hull(triangles: Array) -> _Piece | None:
    """Return None for coplanar points."""
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    size = float(np.ptp(points, axis=0).max())
    if hull.volume < 1e-9 * size**3:
        return None
    return float(hull.volume), points[hull.vertices]
