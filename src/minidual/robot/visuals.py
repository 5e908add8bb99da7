"""Visual meshes, decimated and split by colour."""

import functools
import itertools
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from minidual.robot.description import arm_elements, materials
from minidual.robot.pair import ArmModel, Array

FACES_PER_ARM = 9000
"""Target triangles per arm (the Panda's files: 134,300), for rendering on a CPU."""


@dataclass(frozen=True)
class VisualMesh:
    """One single-colour mesh.

    Attributes:
        link: Without side prefix.
        vertices: (V, 3) [m].
        faces: (F, 3).
        rgba: In 0..1.
    """

    link: str
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    rgba: tuple[float, float, float, float]


_Colour = tuple[float, float, float, float]
_SHRINK_MAX_M = 0.01  # a link that shrinks by more was cut
_GREY: _Colour = (0.7, 0.7, 0.7, 1.0)


@functools.cache
def arm_visuals(arm: ArmModel) -> tuple[VisualMesh, ...]:
    """Return one arm's meshes (first call about 1 s)."""
    import pinocchio as pin

    colours = materials(arm.hand.urdf) | materials(arm.urdf)
    parts: list[tuple[str, _Colour, Array, npt.NDArray[np.int64]]] = []
    for link in arm_elements(arm):
        for visual in link.findall("visual"):
            mesh, origin, material = (visual.find(tag) for tag in ("geometry/mesh", "origin", "material"))
            if mesh is None:
                continue
            place = ET.Element("origin") if origin is None else origin
            rpy, xyz = (np.array([float(x) for x in place.get(k, "0 0 0").split()]) for k in ("rpy", "xyz"))
            R = pin.rpy.rpyToMatrix(rpy).round(15)  # removes the noise of rounded multiples of pi
            scale = np.array([float(x) for x in mesh.get("scale", "1 1 1").split()])
            named = None if material is None else colours.get(material.attrib["name"])
            for colour, vertices, faces in _coloured(Path(mesh.attrib["filename"]), named):
                parts.append((link.attrib["name"], colour, (vertices * scale) @ R.T + xyz, faces))
    total = sum(len(faces) for *_, faces in parts)
    reduction = max(0.0, 1.0 - FACES_PER_ARM / total)
    visuals = []
    for name, of_link in itertools.groupby(parts, key=lambda part: part[0]):
        _, colours_of, vertices, faces = zip(*of_link, strict=True)
        meshes = _decimated(list(zip(vertices, faces, strict=True)), reduction)
        for colour, (points, triangles) in zip(colours_of, meshes, strict=True):
            if len(triangles) >= 4:
                visuals.append(VisualMesh(name, points.astype(np.float32), triangles.astype(np.int32), colour))
    return tuple(visuals)


def _coloured(path: Path, colour: _Colour | None) -> list[tuple[_Colour, Array, npt.NDArray[np.int64]]]:
    import trimesh

    by_colour: dict[_Colour, list[trimesh.Trimesh]] = {}
    for mesh in trimesh.load_scene(path).dump():
        material = getattr(mesh.visual, "material", None)
        own: Any = None if material is None else tuple(int(c) / 255.0 for c in material.main_color)
        by_colour.setdefault(own or colour or _GREY, []).append(mesh)
    coloured = []
    for shade, meshes in by_colour.items():
        merged = trimesh.util.concatenate([trimesh.Trimesh(m.vertices, m.faces, process=False) for m in meshes])
        merged.merge_vertices()
        coloured.append((shade, np.asarray(merged.vertices), np.asarray(merged.faces)))
    return coloured


def _decimated(meshes: list[tuple[Any, Any]], reduction: float) -> list[tuple[Any, Any]]:
    import fast_simplification

    def size(parts: list[tuple[Any, Any]]) -> Array:
        return np.ptp(np.concatenate([vertices for vertices, _ in parts]), axis=0)

    for aggressiveness in (7, 3, 1):
        fewer: list[tuple[Any, Any]] = [
            fast_simplification.simplify(
                vertices.astype(np.float32), faces.astype(np.int32), target_reduction=reduction, agg=aggressiveness
            )
            if len(faces) > 200
            else (vertices, faces)
            for vertices, faces in meshes
        ]
        if (size(fewer) > size(meshes) - _SHRINK_MAX_M).all():
            return fewer
    return meshes
