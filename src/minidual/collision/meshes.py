"""Cover a mesh file with convex hulls."""

from pathlib import Path
from typing import Any

import numpy as np

from minidual.collision.shapes import IDENTITY, Mesh, Quat, Vec3
from minidual.durable import regular_file
from minidual.errors import DataError, UsageError

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".dae", ".glb", ".gltf")
_BYTES_MAX = 2**26
_PIECES_MAX = 64
_EXTENT_MAX_M = 10.0
_EXTENT_MIN_M = 1e-4


def load_mesh(
    path: Path, name: str, position_m: Vec3, quat_wxyz: Quat = IDENTITY, *, scale: float = 1.0, separate: bool = False
) -> tuple[Mesh, str]:
    """Read a mesh file (STL, OBJ, PLY, OFF, Collada, glTF); return its cover and a note on its volume.

    The cover is one hull, or one per connected piece if `separate`. `scale` is metres per unit of the file.

    Raises:
        UsageError, DataError: The file, its scale, size or number of pieces is unfit.
    """
    mesh = _read(path, name)
    mesh.apply_scale(scale)
    extent = float(np.max(mesh.extents))
    if not _EXTENT_MIN_M <= extent <= _EXTENT_MAX_M:
        raise UsageError(
            f"mesh '{name}' ({path.name}) measures {' x '.join(f'{v:.4g}' for v in mesh.extents)} m at scale {scale:g}; "
            f"its longest side must be from {_EXTENT_MIN_M} to {_EXTENT_MAX_M} m",
            remedy="a file in millimetres needs scale: 0.001",
        )
    pieces = list(mesh.split(only_watertight=False)) if separate else [mesh]
    if len(pieces) > _PIECES_MAX:
        raise UsageError(f"mesh '{name}' ({path.name}) has {len(pieces)} pieces; at most {_PIECES_MAX} are allowed")
    hulls = [_hull(piece) for piece in pieces]
    if None in hulls:
        raise DataError(f"mesh '{name}' ({path.name}) is flat or has a flat piece, which encloses no volume")
    held = sum(hull.volume for hull in hulls)
    fit = f"{held / mesh.volume:.2f} times its volume" if mesh.is_watertight else "an open surface"
    blobs = tuple(np.ascontiguousarray(hull.points[hull.vertices]).tobytes() for hull in hulls)
    note = f"mesh '{name}': {len(mesh.faces)} faces in {len(hulls)} convex pieces ({fit})"
    return Mesh(name, position_m, quat_wxyz, blobs, str(path)), note


def _read(path: Path, name: str) -> Any:
    import trimesh

    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"mesh '{name}': {path.name} has the extension '{path.suffix}'; known are {', '.join(SUFFIXES)}"
        )
    try:
        regular_file(path, _BYTES_MAX)
    except DataError as error:
        raise UsageError(f"mesh '{name}': {error.message}") from None
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


def _hull(mesh: Any) -> Any:
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(np.unique(mesh.triangles.reshape(-1, 3), axis=0))
    except QhullError:
        return None
    return hull if hull.volume >= 1e-9 * float(np.max(mesh.extents)) ** 3 else None
