"""Visual meshes of an arm, decimated for rendering on a CPU."""

import functools
import itertools
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.errors import UsageError
from minidual.robot.description import arm_elements
from minidual.robot.files import packages_of
from minidual.robot.mesh_files import load_parts
from minidual.robot.models import ArmModel
from minidual.robot.pair import Array
from minidual.robot.urdf import materials, own_rgba

FACES_PER_ARM = 9000
"""Target number of triangles per arm; the Panda's files have 134,300."""
_SHRINK_MAX_M = 0.01
"""A link whose extent shrinks by more has lost a part."""
_FACES_KEPT = 200
"""Meshes of at most as many faces are not decimated."""
_AGGRESSIVENESS = (7, 3, 1)
"""Of the decimation, tried in turn until no part is lost."""
_FACES_MIN = 4
"""MuJoCo refuses meshes with fewer."""
_Colour = tuple[float, ...]
_Faces = npt.NDArray[np.int64]
_GREY: _Colour = (0.7, 0.7, 0.7, 1.0)


class VisualMesh(NamedTuple):
    """A mesh of one colour.

    Attributes:
        link: Name without side prefix.
        vertices: (V, 3) [m], in the link's frame.
        faces: (F, 3), indices of vertices.
        rgba: From 0 to 1.
    """

    link: str
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    rgba: _Colour


@dataclass(frozen=True, eq=False)
class VisualPart:
    """The part of a link's mesh that has one colour, with all its triangles.

    Attributes:
        link: Name without side prefix.
        rgba: From 0 to 1.
        vertices: (V, 3) [m], in the link's frame.
        faces: (F, 3), indices of vertices.
    """

    link: str
    rgba: _Colour
    vertices: Array
    faces: _Faces


@functools.cache
def arm_visuals(arm: ArmModel, faces_per_arm: int = FACES_PER_ARM) -> tuple[VisualMesh, ...]:
    """Return the meshes of one arm; the first call takes about 1 s."""
    parts = visual_parts(arm)
    faces_n = sum(len(part.faces) for part in parts)
    reduction = max(0.0, 1.0 - faces_per_arm / faces_n) if parts else 0.0
    visuals: list[VisualMesh] = []
    for _, parts_of_link in itertools.groupby(parts, key=lambda part: part.link):
        visuals += _decimated(list(parts_of_link), reduction)
    return tuple(visual for visual in visuals if len(visual.faces) >= _FACES_MIN)


@functools.cache
def visual_parts(arm: ArmModel) -> tuple[VisualPart, ...]:
    """Return the parts of all links, in their links' frames.

    An arm without any visual shows what collides.

    Raises:
        UsageError: A mesh cannot be read.
    """
    packages = packages_of(arm.packages)
    colours = materials(arm.hand.urdf, packages) | materials(arm.urdf, packages)
    links = [element for element in arm_elements(arm) if element.tag == "link"]
    is_drawn = any(link.find("visual") is not None for link in links)
    parts: list[VisualPart] = []
    for link in links:
        for shape in link.findall("visual" if is_drawn else "collision"):
            try:
                parts += _parts_of_shape(link.attrib["name"], shape, colours)
            except UsageError as error:
                owner = f"arm '{arm.name}', link '{link.attrib['name']}'"
                raise UsageError(f"{owner}: {error.message}", remedy=error.remedy) from error
    return tuple(parts)


def _parts_of_shape(
    link: str,
    shape: ET.Element,
    colours: dict[str, _Colour],
) -> list[VisualPart]:
    """Return the parts of a `visual` or `collision`, in its link's frame."""
    geometry = shape.find("geometry")
    if geometry is None:
        return []
    colour = _colour_of(shape.find("material"), colours)
    R, p = _placement(shape.find("origin"))
    mesh = geometry.find("mesh")
    scale = np.ones(3) if mesh is None else _numbers(mesh, "scale", "1 1 1")
    parts: list[VisualPart] = []
    for rgba, vertices, faces in _coloured(_loaded(geometry), colour):
        placed = (vertices * scale) @ R.T + p
        if np.prod(scale) < 0.0:
            faces = faces[:, ::-1]  # a mirror turns the surface inside out
        parts.append(VisualPart(link, rgba, placed, faces))
    return parts


def _colour_of(material: ET.Element | None, colours: dict[str, _Colour]) -> _Colour | None:
    """Return the rgba of a material, by itself or by its name."""
    if material is None:
        return None
    return own_rgba(material) or colours.get(material.get("name", ""))


def _loaded(geometry: ET.Element) -> list[Any]:
    """Return the `trimesh.Trimesh` of a geometry in its own frame; none for an unknown kind."""
    import trimesh

    mesh = geometry.find("mesh")
    if mesh is not None:
        return load_parts(Path(mesh.attrib["filename"]))
    box = geometry.find("box")
    if box is not None:
        return [trimesh.creation.box(extents=_numbers(box, "size", "0 0 0"))]
    cylinder = geometry.find("cylinder")
    if cylinder is not None:
        (radius_m,) = _numbers(cylinder, "radius", "0")
        (length_m,) = _numbers(cylinder, "length", "0")
        return [trimesh.creation.cylinder(radius_m, length_m)]
    sphere = geometry.find("sphere")
    if sphere is not None:
        (radius_m,) = _numbers(sphere, "radius", "0")
        return [trimesh.creation.icosphere(radius=radius_m)]
    return []


def _numbers(element: ET.Element, name: str, default: str) -> Array:
    return np.array([float(x) for x in element.get(name, default).split()])


def _placement(origin: ET.Element | None) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and position (3,) [m] of an `origin`."""
    import pinocchio as pin

    element = ET.Element("origin") if origin is None else origin
    rpy = _numbers(element, "rpy", "0 0 0")
    R = pin.rpy.rpyToMatrix(rpy).round(15)  # removes the noise of rounded multiples of pi
    return R, _numbers(element, "xyz", "0 0 0")


def _coloured(
    meshes: list[Any],
    colour: _Colour | None,
) -> list[tuple[_Colour, Array, _Faces]]:
    """Return colour, vertices and faces of parts; a mesh's own colour goes first."""
    import trimesh

    by_colour: dict[_Colour, list[trimesh.Trimesh]] = {}
    for mesh in meshes:
        rgba = _own_colour(mesh) or colour or _GREY
        by_colour.setdefault(rgba, []).append(mesh)
    coloured = []
    for rgba, own in by_colour.items():
        bare = [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False) for mesh in own]
        merged = trimesh.util.concatenate(bare)
        merged.merge_vertices()
        coloured.append((rgba, np.asarray(merged.vertices), np.asarray(merged.faces)))
    return coloured


def _own_colour(mesh: Any) -> _Colour | None:
    """Return the rgba of a trimesh's material, if it has one."""
    material = getattr(mesh.visual, "material", None)
    if material is None:
        return None
    return tuple(int(channel) / 255.0 for channel in material.main_color)


def _decimated(parts: list[VisualPart], reduction: float) -> list[VisualMesh]:
    """Return one link's parts with a share `reduction` of the faces removed, if no part is lost."""
    extent_min_m = _extent_m([part.vertices for part in parts]) - _SHRINK_MAX_M
    for aggressiveness in _AGGRESSIVENESS:
        fewer = [_simplified(part, reduction, aggressiveness) for part in parts]
        if (_extent_m([mesh.vertices for mesh in fewer]) > extent_min_m).all():
            return fewer
    return [_as_visual(part, part.vertices, part.faces) for part in parts]


def _simplified(part: VisualPart, reduction: float, aggressiveness: int) -> VisualMesh:
    import fast_simplification

    if len(part.faces) <= _FACES_KEPT:
        return _as_visual(part, part.vertices, part.faces)
    vertices, faces = fast_simplification.simplify(
        part.vertices.astype(np.float32),
        part.faces.astype(np.int32),
        target_reduction=reduction,
        agg=aggressiveness,
    )
    return _as_visual(part, vertices, faces)


def _as_visual(part: VisualPart, vertices: Any, faces: Any) -> VisualMesh:
    return VisualMesh(
        part.link,
        vertices.astype(np.float32),
        faces.astype(np.int32),
        part.rgba,
    )


def _extent_m(vertices: list[Any]) -> Array:
    """Return the extent (3,) [m] of parts."""
    return np.ptp(np.concatenate(vertices), axis=0)
