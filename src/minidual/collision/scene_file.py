"""Planning scenes in YAML (docs/planning-scenes.md). Messages name file, line and dotted path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from minidual.collision.meshes import PARTS_MAX, load_mesh
from minidual.collision.places import PlaceFields
from minidual.collision.scene import MIN_DISTANCE_MAX_M, TABLE, Attached, PlanningScene
from minidual.collision.shapes import Box, Capsule, Cylinder, Shape, Sphere
from minidual.config.base import StrictModel
from minidual.config.document import Document, read_document
from minidual.config.loader import validate_document
from minidual.errors import ConfigError, MinidualError
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Robot

Length = Annotated[float, Field(ge=1e-4, le=10.0)]
"""The minimum is a mesh's: MuJoCo gets boxes as meshes, whose hulls need volume."""


class _Held(StrictModel):
    """Marks a shape as held."""

    link: str
    """Its frame places the shape."""
    touch_links: tuple[str, ...] = ()
    """Links that may touch it, besides those rigid with `link`."""


class BoxEntry(PlaceFields):
    """A box."""

    name: str = Field(min_length=1)
    shape: Literal["box"] = "box"
    size_m: tuple[Length, Length, Length]
    held: _Held | None = None


class CylinderEntry(PlaceFields):
    """A cylinder along z."""

    name: str = Field(min_length=1)
    shape: Literal["cylinder"] = "cylinder"
    radius_m: Length
    length_m: Length
    held: _Held | None = None


class CapsuleEntry(PlaceFields):
    """A capsule along z."""

    name: str = Field(min_length=1)
    shape: Literal["capsule"] = "capsule"
    radius_m: Length
    length_m: Length
    """Of the cylindrical part."""
    held: _Held | None = None


class SphereEntry(PlaceFields):
    """A ball."""

    name: str = Field(min_length=1)
    shape: Literal["sphere"] = "sphere"
    radius_m: Length
    held: _Held | None = None


class MeshEntry(PlaceFields):
    """A mesh file."""

    name: str = Field(min_length=1)
    shape: Literal["mesh"] = "mesh"
    file: str = Field(min_length=1)
    """Relative to the scene file."""
    scale: float = Field(default=1.0, gt=0.0, le=1000.0)
    """Metres per unit."""
    parts_max_n: int = Field(default=1, ge=1, le=PARTS_MAX)
    """Most convex pieces; 1 gives one hull."""
    held: _Held | None = None


Entry = Annotated[BoxEntry | CylinderEntry | CapsuleEntry | SphereEntry | MeshEntry, Field(discriminator="shape")]


class AllowedEntry(StrictModel):
    """A pair that may touch."""

    pair: tuple[str, str]
    reason: str = Field(min_length=1)


class SceneFile(StrictModel):
    """Content of a scene file."""

    table: bool = True
    """Whether the simulated table is an obstacle."""
    min_distance_m: float = Field(default=0.0, ge=0.0, le=MIN_DISTANCE_MAX_M)
    obstacles: tuple[Entry, ...] = ()
    allowed: tuple[AllowedEntry, ...] = ()
    """Added to the robot's own matrix."""
    checked: tuple[tuple[str, str], ...] = ()
    """Pairs of the robot's own matrix to check anyway."""


@dataclass(frozen=True)
class LoadedScene:
    """A scene and notes on its meshes."""

    scene: PlanningScene
    notes: tuple[str, ...] = ()


def load_scene(path: Path, robot: Robot = DUAL_PANDA) -> LoadedScene:
    """Read a scene file.

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
    obstacles: list[Shape] = [TABLE] if content.table else []
    attached: list[Attached] = []
    for index, entry in enumerate(content.obstacles):
        with _told(document, f"obstacles.{index}"):
            shape = _shape(entry, path.parent, notes.append)
            if entry.held is None:
                obstacles.append(shape)
            else:
                attached.append(Attached(shape, entry.held.link, entry.held.touch_links))
            # Built after every entry, so that the error about a duplicate name carries its line.
            scene = PlanningScene(tuple(obstacles), tuple(attached), min_distance_m=content.min_distance_m, robot=robot)
    scene = PlanningScene(tuple(obstacles), tuple(attached), min_distance_m=content.min_distance_m, robot=robot)
    for index, rule in enumerate(content.allowed):
        with _told(document, f"allowed.{index}"):
            scene = scene.allowing(*rule.pair, rule.reason)
    for index, pair in enumerate(content.checked):
        with _told(document, f"checked.{index}"):
            scene = scene.forbidding(*pair)
    return LoadedScene(scene, tuple(notes))


@contextmanager
def _told(document: Document, path: str) -> Iterator[None]:
    """Prepend file, line and path to errors raised inside."""
    try:
        yield
    except MinidualError as error:
        where = f"{document.origins.get(path, document.source)}: {path}"
        raise type(error)(f"{where}: {error.message}", remedy=error.remedy) from error


def _shape(entry: Entry, folder: Path, say: Callable[[str], None]) -> Shape:
    place = (entry.name, entry.position_m, entry.quaternion_or_identity())
    match entry:
        case BoxEntry():
            return Box(*place, size_m=entry.size_m)
        case CylinderEntry():
            return Cylinder(*place, radius_m=entry.radius_m, length_m=entry.length_m)
        case CapsuleEntry():
            return Capsule(*place, radius_m=entry.radius_m, length_m=entry.length_m)
        case SphereEntry():
            return Sphere(*place, radius_m=entry.radius_m)
        case MeshEntry():
            mesh, report = load_mesh(folder / entry.file, *place, scale=entry.scale, parts_max=entry.parts_max_n)
            say(f"mesh '{entry.name}': {report}")
            return mesh
