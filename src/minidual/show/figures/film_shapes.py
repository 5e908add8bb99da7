"""Meshes of films: rounded boxes, turned solids and the arms' shells."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.robot.models import ArmModel
from minidual.robot.pair import Array
from minidual.robot.visuals import VisualMesh, arm_visuals

_ALL_FACES = 1_000_000
"""More than an arm's files have."""
_LARGE_FACES = 4_000
"""Parts with more triangles are large, smooth shells."""
_SHELL_FACES = 3_600
_GENTLE = 3
"""Aggressiveness of the decimation that opens no gaps in the Panda's shells."""
_SHARP_RAD = np.deg2rad(35.0)
"""Sharper edges stay unsmoothed."""
_ARC_STEPS = 4
_TURN_SECTIONS = 56


class Shape(NamedTuple):
    """A closed surface.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3), counter-clockwise from outside.
        normals: (V, 3); empty if they follow from the faces.
    """

    vertices: Array
    faces: npt.NDArray[np.int32]
    normals: Array


def rounded_box(half_m: Sequence[float], radius_m: float) -> Shape:
    """Return a box of half extents (3,) [m] with rounded edges."""
    from scipy.spatial import ConvexHull

    half = np.asarray(half_m, dtype=np.float64)
    radius_m = min(radius_m, 0.49 * float(half.min()))
    angles = np.linspace(0.0, np.pi / 2.0, _ARC_STEPS)
    azimuth, polar = np.meshgrid(angles, angles, indexing="ij")
    ring = np.sin(polar)
    octant = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), np.cos(polar)], axis=-1)
    octant = np.unique(octant.reshape(-1, 3).round(12), axis=0)
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    normals = (signs[:, None, :] * octant[None, :, :]).reshape(-1, 3)
    corners = np.repeat(signs * (half - radius_m), len(octant), axis=0)
    vertices = corners + radius_m * normals
    faces = ConvexHull(vertices).simplices
    first, second, third = (vertices[faces[:, k]] for k in range(3))
    outward = np.einsum("ij,ij->i", np.cross(second - first, third - first), first)
    faces = np.where(outward[:, None] < 0.0, faces[:, ::-1], faces)
    return Shape(vertices, faces.astype(np.int32), normals)


def turned(profile_m: Sequence[tuple[float, float]]) -> Shape:
    """Return the solid that a profile of (radius, z) [m], from below upwards, makes about z."""
    import trimesh

    line = np.asarray(profile_m, dtype=np.float64)
    solid = trimesh.creation.revolve(line, sections=_TURN_SECTIONS)
    return smooth(solid.vertices, solid.faces)


def rounded_cylinder(radius_m: float, half_m: float, edge_m: float) -> Shape:
    """Return a cylinder about z with rounded edges."""
    edge_m = min(edge_m, 0.49 * radius_m, 0.49 * half_m)
    angles = np.linspace(0.0, np.pi / 2.0, _ARC_STEPS)
    arc = np.stack(
        [
            radius_m - edge_m + edge_m * np.sin(angles),
            edge_m - half_m - edge_m * np.cos(angles),
        ],
        axis=-1,
    )
    above = arc[::-1] * (1.0, -1.0)
    profile = [(0.0, -half_m), *arc.tolist(), *above.tolist(), (0.0, half_m)]
    return turned(profile)


def smooth(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> Shape:
    """Return a shape that is smooth but for sharp edges."""
    import trimesh

    mesh = trimesh.Trimesh(np.asarray(vertices, float), np.asarray(faces), process=True)
    shaded = trimesh.graph.smooth_shade(mesh, angle=_SHARP_RAD)
    return Shape(
        np.asarray(shaded.vertices),
        np.asarray(shaded.faces, dtype=np.int32),
        np.empty((0, 3)),
    )


@functools.cache
def arm_shells(arm: ArmModel, *, fine: bool) -> tuple[VisualMesh, ...]:
    """Return the meshes of one arm, with sharp edges; `fine` ones have all triangles of its files."""
    return tuple(_shell(visual, fine=fine) for visual in arm_visuals(arm, _ALL_FACES))


def _shell(visual: VisualMesh, *, fine: bool) -> VisualMesh:
    vertices = visual.vertices
    faces = visual.faces
    if not fine and len(faces) > _LARGE_FACES:
        import fast_simplification

        vertices, faces = fast_simplification.simplify(
            vertices,
            faces,
            target_reduction=1.0 - _SHELL_FACES / len(faces),
            agg=_GENTLE,
        )
    shape = smooth(vertices, faces)
    return visual._replace(vertices=shape.vertices.astype(np.float32), faces=shape.faces)
