"""Planning scenes in YAML (docs/planning-scenes.md).

Places, shapes, and mesh files covered with convex hulls.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from minidual.collision.scene import MIN_DISTANCE_MAX_M, TABLE, PlanningScene
from minidual.collision.shapes import (
    IDENTITY,
    Attached,
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Quat,
    Shape,
    Sphere,
    Vec3,
)
from minidual.config.base import Coordinate, StrictModel
from minidual.config.document import Document, read_document
from minidual.config.validation import validate_document
from minidual.durable import regular_file
from minidual.errors import ConfigError, DataError, MinidualError, UsageError
from minidual.robot.pair import DUAL_PANDA, Robot

Finite3 = tuple[Coordinate, Coordinate, Coordinate]
_LENGTH_TOLERANCE = 1e-3


class PlaceFields(StrictModel):
    """A position with optional orientation, in one of two forms."""

    position_m: Finite3
    quat_wxyz: tuple[float, float, float, float] | None = None
    """Scalar first; normalised if its length is within 0.001 of 1."""
    rpy_rad: Finite3 | None = None
    """About fixed x, y, z in this order, as in a URDF."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.quat_wxyz is not None:
            if self.rpy_rad is not None:
                raise ValueError(
                    "quat_wxyz and rpy_rad are two ways to say one thing; give one of them",
                )
            length = math.hypot(*self.quat_wxyz)
            if abs(length - 1.0) > _LENGTH_TOLERANCE:
                raise ValueError(
                    f"quat_wxyz has length {length:.4f}; a rotation has 1 (scalar first: w, x, y,"
                    " z)",
                )
        return self

    def quaternion(self) -> Quat | None:
        """Return the unit quaternion, or None."""
        if self.quat_wxyz is not None:
            w, x, y, z = (np.array(self.quat_wxyz) / math.hypot(*self.quat_wxyz)).tolist()
            return (w, x, y, z)
        if self.rpy_rad is not None:
            quat = pin.Quaternion(pin.rpy.rpyToMatrix(np.array(self.rpy_rad))).normalized()
            return (float(quat.w), float(quat.x), float(quat.y), float(quat.z))
        return None


SUFFIXES = (".stl", ".obj", ".ply", ".off", ".dae", ".glb", ".gltf")
_BYTES_MAX = 2**26
_PIECES_MAX = 64
_EXTENT_MAX_M = 10.0
_EXTENT_MIN_M = 1e-4
_FLAT = 1e-9
"""Volume per cubed longest side below which a hull counts as flat."""


def load_mesh(
    path: Path,
    name: str,
    position_m: Vec3,
    quat_wxyz: Quat = IDENTITY,
    *,
    scale: float = 1.0,
    separate: bool = False,
) -> tuple[Mesh, str]:
    """Read a mesh file (STL, OBJ, PLY, OFF, Collada, glTF).

    Its cover is one hull, or one per connected piece if `separate`.

    Args:
        path: The file.
        name: Of the obstacle.
        position_m: Its position [m].
        quat_wxyz: Its orientation.
        scale: Metres per unit of the file.
        separate: One hull for each connected piece.

    Returns:
        The cover, and a note on its volume.

    Raises:
        UsageError, DataError: The file, its scale, size or number of pieces is unfit.
    """
    mesh = _read(path, name)
    mesh.apply_scale(scale)
    if not _EXTENT_MIN_M <= float(np.max(mesh.extents)) <= _EXTENT_MAX_M:
        size = " x ".join(f"{v:.4g}" for v in mesh.extents)
        raise UsageError(
            f"mesh '{name}' ({path.name}) measures {size} m at scale {scale:g}; its longest side"
            f" must be from {_EXTENT_MIN_M} to {_EXTENT_MAX_M} m",
            remedy="a file in millimetres needs scale: 0.001",
        )
    pieces = list(mesh.split(only_watertight=False)) if separate else [mesh]
    if len(pieces) > _PIECES_MAX:
        raise UsageError(
            f"mesh '{name}' ({path.name}) has {len(pieces)} pieces; at most {_PIECES_MAX} are"
            " allowed",
        )
    hulls = [_hull(piece) for piece in pieces]
    if None in hulls:
        raise DataError(
            f"mesh '{name}' ({path.name}) is flat or has a flat piece, which encloses no volume",
        )
    fit = "an open surface"
    if mesh.is_watertight:
        volume = sum(hull.volume for hull in hulls)
        fit = f"{volume / mesh.volume:.2f} times its volume"
    note = f"mesh '{name}': {len(mesh.faces)} faces in {len(hulls)} convex pieces ({fit})"
    corners = [np.ascontiguousarray(hull.points[hull.vertices]) for hull in hulls]
    blobs = tuple(vertices.tobytes() for vertices in corners)
    return Mesh(name, position_m, quat_wxyz, blobs, str(path)), note


def _read(path: Path, name: str) -> Any:
    import trimesh

    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"mesh '{name}': {path.name} has extension '{path.suffix}'; known are"
            f" {', '.join(SUFFIXES)}",
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
    """Return the convex hull of a mesh, or None if it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(np.unique(mesh.triangles.reshape(-1, 3), axis=0))
    except QhullError:
        return None
    volume_min = _FLAT * float(np.max(mesh.extents)) ** 3
    return hull if hull.volume >= volume_min else None


Length = Annotated[float, Field(ge=1e-4, le=10.0)]
"""MuJoCo gets boxes as meshes, whose hulls need volume."""


class _Held(StrictModel):
    """Marks a shape as held."""

    link: str
    """Its frame places the shape."""
    touch_links: tuple[str, ...] = ()
    """Others that may touch it, besides those rigid with `link`."""


class _Entry(PlaceFields):
    name: str = Field(min_length=1)
    held: _Held | None = None


class BoxEntry(_Entry):
    """A box."""

    shape: Literal["box"] = "box"
    size_m: tuple[Length, Length, Length]


class RoundEntry(_Entry):
    """A cylinder or capsule along z."""

    shape: Literal["cylinder", "capsule"]
    radius_m: Length
    length_m: Length
    """Of the cylindrical part."""


class SphereEntry(_Entry):
    """A ball."""

    shape: Literal["sphere"] = "sphere"
    radius_m: Length


class MeshEntry(_Entry):
    """A mesh file."""

    shape: Literal["mesh"] = "mesh"
    file: str = Field(min_length=1)
    """Relative to the scene file."""
    scale: float = Field(default=1.0, gt=0.0, le=1000.0)
    """Metres per unit."""
    separate: bool = False
    """One hull for each connected piece, not one for all."""


_Entries = Annotated[BoxEntry | RoundEntry | SphereEntry | MeshEntry, Field(discriminator="shape")]


class AllowedEntry(StrictModel):
    """A pair that may touch."""

    pair: tuple[str, str]
    reason: str = Field(min_length=1)


class SceneFile(StrictModel):
    """Content of a scene file."""

    table: bool = True
    """Whether the simulated table is an obstacle."""
    min_distance_m: float = Field(default=0.0, ge=0.0, le=MIN_DISTANCE_MAX_M)
    obstacles: tuple[_Entries, ...] = ()
    allowed: tuple[AllowedEntry, ...] = ()
    """Added to the robot's own matrix."""
    checked: tuple[tuple[str, str], ...] = ()
    """Pairs of that matrix to check anyway."""


def load_scene(path: Path, robot: Robot = DUAL_PANDA) -> tuple[PlanningScene, list[str]]:
    """Read a scene file; return the scene and notes on its meshes.

    Raises:
        ConfigError: Empty or invalid file.
        UsageError, DataError: Unknown name, or unreadable mesh.
    """
    document = read_document(path)
    if not document.tree:
        raise ConfigError(
            f"{path.name}: the scene file is empty; it would mean the bare table",
            remedy="leave --scene out for the bare table, or write at least 'table: true'",
        )
    content = validate_document(document, SceneFile)
    notes: list[str] = []
    scene = PlanningScene(
        (TABLE,) if content.table else (),
        min_distance_m=content.min_distance_m,
        robot=robot,
    )
    for index, entry in enumerate(content.obstacles):
        with _located(document, f"obstacles.{index}"):
            shape = _shape(entry, path.parent, notes)
            held = entry.held
            if held is None:
                scene = scene.with_obstacles(shape)
            else:
                scene = scene.with_attached(Attached(shape, held.link, held.touch_links))
    for index, rule in enumerate(content.allowed):
        with _located(document, f"allowed.{index}"):
            scene = scene.allowing(*rule.pair, rule.reason)
    for index, pair in enumerate(content.checked):
        with _located(document, f"checked.{index}"):
            scene = scene.forbidding(*pair)
    return scene, notes


@contextmanager
def _located(document: Document, path: str) -> Iterator[None]:
    """Add file, line and dotted path to an error."""
    try:
        yield
    except MinidualError as error:
        where = f"{document.origins.get(path, document.source)}: {path}"
        raise type(error)(f"{where}: {error.message}", remedy=error.remedy) from error


def _shape(entry: _Entries, folder: Path, notes: list[str]) -> Shape:
    """Return an entry's shape; add a note on a mesh."""
    name = entry.name
    position_m = entry.position_m
    quat_wxyz = entry.quaternion() or IDENTITY
    if isinstance(entry, BoxEntry):
        return Box(name, position_m, quat_wxyz, size_m=entry.size_m)
    if isinstance(entry, SphereEntry):
        return Sphere(name, position_m, quat_wxyz, radius_m=entry.radius_m)
    if isinstance(entry, RoundEntry):
        shape = Cylinder if entry.shape == "cylinder" else Capsule
        return shape(
            name,
            position_m,
            quat_wxyz,
            radius_m=entry.radius_m,
            length_m=entry.length_m,
        )
    mesh, note = load_mesh(
        folder / entry.file,
        name,
        position_m,
        quat_wxyz,
        scale=entry.scale,
        separate=entry.separate,
    )
    notes.append(note)
    return mesh
