"""Planning scenes in YAML (docs/planning-scenes.md)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from minidual.collision.meshes import load_mesh
from minidual.collision.places import PlaceFields
from minidual.collision.scene import MIN_DISTANCE_MAX_M, TABLE, Attached, PlanningScene
from minidual.collision.shapes import IDENTITY, Box, Capsule, Cylinder, Shape, Sphere
from minidual.config.base import StrictModel
from minidual.config.document import Document, read_document
from minidual.config.loader import validate_document
from minidual.errors import ConfigError, MinidualError
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Robot

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


class CylinderEntry(_Entry):
    """A cylinder along z."""

    shape: Literal["cylinder"] = "cylinder"
    radius_m: Length
    length_m: Length


class CapsuleEntry(_Entry):
    """A capsule along z."""

    shape: Literal["capsule"] = "capsule"
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


_SHAPES = {"box": Box, "cylinder": Cylinder, "capsule": Capsule, "sphere": Sphere}
_Entries = Annotated[BoxEntry | CylinderEntry | CapsuleEntry | SphereEntry | MeshEntry, Field(discriminator="shape")]


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
    obstacles: list[Shape] = [TABLE] if content.table else []
    attached: list[Attached] = []

    def scene_so_far() -> PlanningScene:
        return PlanningScene(tuple(obstacles), tuple(attached), min_distance_m=content.min_distance_m, robot=robot)

    for index, entry in enumerate(content.obstacles):
        with _told(document, f"obstacles.{index}"):
            shape = _shape(entry, path.parent, notes)
            if entry.held is None:
                obstacles.append(shape)
            else:
                attached.append(Attached(shape, entry.held.link, entry.held.touch_links))
            scene_so_far()  # so that the error about a duplicate name carries its line
    scene = scene_so_far()
    for index, rule in enumerate(content.allowed):
        with _told(document, f"allowed.{index}"):
            scene = scene.allowing(*rule.pair, rule.reason)
    for index, pair in enumerate(content.checked):
        with _told(document, f"checked.{index}"):
            scene = scene.forbidding(*pair)
    return scene, notes


@contextmanager
def _told(document: Document, path: str) -> Iterator[None]:
    try:
        yield
    except MinidualError as error:
        where = f"{document.origins.get(path, document.source)}: {path}"
        raise type(error)(f"{where}: {error.message}", remedy=error.remedy) from error


def _shape(entry: _Entries, folder: Path, notes: list[str]) -> Shape:
    place = (entry.name, entry.position_m, entry.quaternion() or IDENTITY)
    if not isinstance(entry, MeshEntry):
        return _SHAPES[entry.shape](*place, **entry.model_dump(include={"size_m", "radius_m", "length_m"}))
    mesh, note = load_mesh(folder / entry.file, *place, scale=entry.scale, separate=entry.separate)
    notes.append(note)
    return mesh
