"""Visual meshes of one Panda, decimated for fast software rendering and split by colour."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from minidual.robot.description import panda_description_dir

FACES_PER_ARM = 9000
"""Target number of triangles an arm: 134,300 in the source; a face costs more than a pixel on a CPU."""


@dataclass(frozen=True)
class VisualMesh:
    """One mesh of one colour in the frame of its link.

    Attributes:
        link: Link name without prefix, e.g. `panda_link3`.
        vertices: (V, 3) [m].
        faces: (F, 3) indices.
        rgba: (4,) in 0..1.
    """

    link: str
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    rgba: tuple[float, float, float, float]


_LINK_MESHES: dict[str, tuple[str, bool]] = {
    **{f"panda_link{i}": (f"link{i}", False) for i in range(8)},
    "panda_hand": ("hand", False),
    "panda_leftfinger": ("finger", False),
    "panda_rightfinger": ("finger", True),  # the URDF turns the same mesh by pi about z
}


@functools.cache
def panda_visuals() -> tuple[VisualMesh, ...]:
    """Return the visual meshes of one arm; about one second the first time in a process."""
    import fast_simplification
    import trimesh

    folder = panda_description_dir() / "meshes" / "visual"
    parts: list[tuple[str, tuple[int, ...], npt.NDArray[np.float64], npt.NDArray[np.int64]]] = []
    for link, (stem, turned) in _LINK_MESHES.items():
        by_colour: dict[tuple[int, ...], list[trimesh.Trimesh]] = {}
        scene = trimesh.load_scene(folder / f"{stem}.dae")
        for mesh in scene.dump():
            colour = tuple(int(c) for c in mesh.visual.material.main_color)
            by_colour.setdefault(colour, []).append(mesh)
        for colour, meshes in by_colour.items():
            merged = trimesh.util.concatenate([trimesh.Trimesh(m.vertices, m.faces, process=False) for m in meshes])
            merged.merge_vertices()
            vertices = np.asarray(merged.vertices)
            if turned:
                vertices = vertices * np.array([-1.0, -1.0, 1.0])
            parts.append((link, colour, vertices, np.asarray(merged.faces)))
    total = sum(len(faces) for *_, faces in parts)
    reduction = max(0.0, 1.0 - FACES_PER_ARM / total)
    visuals = []
    for link, colour, vertices, faces in parts:
        if len(faces) > 200:
            vertices, faces = fast_simplification.simplify(
                vertices.astype(np.float32), faces.astype(np.int32), target_reduction=reduction
            )
        if len(faces) < 4:
            continue
        rgba = tuple(c / 255.0 for c in colour)
        visuals.append(VisualMesh(link, vertices.astype(np.float32), faces.astype(np.int32), rgba))  # type: ignore[arg-type]
    return tuple(visuals)
