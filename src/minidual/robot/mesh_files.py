"""Read meshes of any format, and write what MuJoCo and coal do not read as binary STL.

A COLLADA file's unit counts. Its up axis does not: ROS draws the numbers of the file as they are,
and descriptions are made for that.
"""

import contextlib
import functools
import hashlib
import os
import re
import struct
import tempfile
from pathlib import Path
from typing import Any

from minidual.durable import expanded, replacing
from minidual.errors import UsageError
from minidual.variables import private_folder

FORMATS = (".stl", ".obj", ".dae", ".ply", ".off", ".glb", ".gltf")
_READ_BY_ENGINES = (".stl", ".obj")
_FACES_MAX = 200_000
"""MuJoCo refuses STL files with more faces."""
_STL_HEADER = 84
_STL_FACE = 50
_UNIT = re.compile(rb"<unit[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']")
_HEAD_BYTES = 65536
_RULE_VERSION = b"1"


def load_parts(path: Path) -> list[Any]:
    """Return the `trimesh.Trimesh` of a file, in metres and in the frame of the file.

    Raises:
        UsageError: It is no mesh.
    """
    import trimesh

    if path.suffix.lower() not in FORMATS:
        raise UsageError(
            f"{path}: no meshes are read from '{path.suffix}'; there are {', '.join(FORMATS)}",
        )
    try:
        parts = list(trimesh.load_scene(path).dump())
    except Exception as error:  # the readers of trimesh raise anything
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path} is no mesh: {reason}", remedy=_RECOPY) from error
    unit_m = unit_of(path)
    if unit_m != 1.0:
        for mesh in parts:
            mesh.apply_scale(unit_m)
    parts = [mesh for mesh in parts if hasattr(mesh, "faces") and len(mesh.faces)]
    if not parts:
        raise UsageError(f"{path} holds no triangles", remedy=_RECOPY)
    return parts


_RECOPY = "the file may be cut off: take it from its source again"


def unit_of(path: Path) -> float:
    """Return the length of a COLLADA file's unit [m], 1 for other formats.

    Raises:
        UsageError: It is no positive number.
    """
    if path.suffix.lower() != ".dae":
        return 1.0
    with path.open("rb") as file:
        match = _UNIT.search(file.read(_HEAD_BYTES))
    if match is None:
        return 1.0
    try:
        unit_m = float(match[1])
    except ValueError:
        unit_m = 0.0
    if not 0.0 < unit_m < float("inf"):
        text = match[1].decode(errors="replace")
        raise UsageError(f"{path}: its unit is '{text}' m; it must be a positive number")
    return unit_m


def readable(path: Path) -> Path:
    """Return a file with the same mesh that both engines read: `path` itself, or an STL copy.

    Raises:
        UsageError: It is no mesh.
    """
    is_known = path.suffix.lower() in _READ_BY_ENGINES
    if is_known and (path.suffix.lower() != ".stl" or _is_binary_stl(path)):
        return path
    return _converted(path)


def _is_binary_stl(path: Path) -> bool:
    """Return whether the length of a file is that of a binary STL that MuJoCo reads."""
    size = path.stat().st_size
    if size < _STL_HEADER:
        return False
    with path.open("rb") as file:
        file.seek(_STL_HEADER - 4)
        (faces_n,) = struct.unpack("<I", file.read(4))
    return size == _STL_HEADER + faces_n * _STL_FACE and 0 < faces_n <= _FACES_MAX


@functools.cache
def _converted(path: Path) -> Path:
    """Return an STL copy; of a mesh with too many faces, its convex hull, which is what collides."""
    import trimesh

    target = _stored(path, b"stl")
    if target.is_file():
        return target
    parts = load_parts(path)
    whole = trimesh.util.concatenate([trimesh.Trimesh(m.vertices, m.faces) for m in parts])
    if len(whole.faces) > _FACES_MAX:
        whole = whole.convex_hull
    with replacing(target) as partial:
        partial.write_bytes(trimesh.exchange.stl.export_stl(whole))
    return target


@functools.cache
def own_name(path: Path) -> Path:
    """Return a copy of a file whose name no other mesh has: MuJoCo takes equal names for one file."""
    target = _stored(path, b"copy")
    if not target.is_file():
        with replacing(target) as partial:
            partial.write_bytes(path.read_bytes())
    return target


def _stored(path: Path, purpose: bytes) -> Path:
    """Return the path in the user's cache for a product of a file, by the file's content."""
    digest = hashlib.sha256(_RULE_VERSION + purpose)
    digest.update(path.suffix.lower().encode())
    digest.update(path.read_bytes())
    suffix = ".stl" if purpose == b"stl" else path.suffix.lower()
    return _cache_folder() / f"mesh-{digest.hexdigest()[:24]}{suffix}"


@functools.cache
def _cache_folder() -> Path:
    """Return the user's cache folder, or a private one if that cannot be written."""
    folder = expanded(os.environ.get("MINIDUAL_CACHE") or "~/.cache/minidual")
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    if os.access(folder, os.W_OK):
        return folder
    return private_folder() or Path(tempfile.mkdtemp(prefix="minidual-"))
