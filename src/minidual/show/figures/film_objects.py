"""The look of objects in films: rounded, and with details such as a bottle's neck and cap.

The simulated geoms stay in the model, hidden: a look takes their colour and size from them.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from minidual.config.scene import ObjectConfig, PartConfig, SceneConfig
from minidual.plant.contact import GROUP_COLLISION, GROUP_VISUAL, INTANGIBLE
from minidual.plant.marks import marks
from minidual.show.figures.film_shapes import (
    Shape,
    rounded_box,
    rounded_cylinder,
    smooth,
    turned,
)

PREFIX = "look/"
"""Of the names of geoms that only films have."""
_PAINT = "paint"
_TRIM = "trim"
Rgba = tuple[float, float, float, float]
Position = tuple[float, float, float]

_EDGE_SHARE = 0.12
"""Radius of an edge, of the smallest half extent."""
_EDGE_MAX_M = 0.004
_ALONG_Y = (float(np.sqrt(0.5)), -float(np.sqrt(0.5)), 0.0, 0.0)
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_BLUE: Rgba = (0.10, 0.22, 0.60, 1.0)
_BLACK: Rgba = (0.10, 0.10, 0.11, 1.0)
_STEEL: Rgba = (0.72, 0.74, 0.77, 1.0)
_PAPER: Rgba = (0.93, 0.91, 0.85, 1.0)
_COLLAR_M = 0.0012
_COLLAR_HALF_LENGTH_M = 0.015
_RIM_HEIGHT_M = 0.014
_RIM_THICKNESS_M = 0.006


class Look(NamedTuple):
    """The look that a geom belongs to, and whether it has the object's own colour."""

    object: str
    takes_colour: bool


def look_of(geom_name: str) -> Look | None:
    """Return the look that the name of a geom stands for; None for other geoms."""
    kind, _, rest = geom_name.removeprefix(PREFIX).partition("/")
    if not geom_name.startswith(PREFIX) or kind not in (_PAINT, _TRIM):
        return None
    return Look(rest.split("/")[0], kind == _PAINT)


class Piece(NamedTuple):
    """A part of a look, in the object's frame.

    Attributes:
        shape: About its own origin.
        position_m: Of that origin.
        quat: wxyz.
        rgba: None takes the colour of the object, which a condition of trials may change.
        shine: From 0, dull, to 1, a mirror for lamps.
    """

    shape: Shape
    position_m: Position = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = _UPRIGHT
    rgba: Rgba | None = None
    shine: float = 0.3


def dress(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Give the objects their looks, and painted fields a border."""
    for item in scene.objects.values():
        body = spec.body(item.name)
        for geom in body.geoms:
            geom.group = GROUP_COLLISION
        look = LOOKS.get(item.name, plain)
        for index, piece in enumerate(look(item)):
            rgba = item.colour if piece.rgba is None else piece.rgba
            kind = _PAINT if piece.rgba is None else _TRIM
            _add(spec, body, piece, rgba, f"{PREFIX}{kind}/{item.name}/{index}")
    for mark in marks(scene):
        if mark.name.endswith("_rim"):
            _add_border(spec, mark.name, mark.xy_m, mark.size_m, mark.colour)


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, piece: Piece, rgba: Rgba, name: str) -> None:
    vertices, faces, normals = piece.shape
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        usernormal=normals.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.add_material(name=name, specular=piece.shine, shininess=0.3 + 0.5 * piece.shine)
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=name,
        pos=piece.position_m,
        quat=piece.quat,
        rgba=rgba,
        group=GROUP_VISUAL,
        density=0.0,
        **INTANGIBLE,
    )


def plain(item: ObjectConfig) -> Iterator[Piece]:
    """Yield the parts of an object with rounded edges, and collars where hands grasp."""
    main, *more = item.solids
    yield _solid(main, None)
    for part in more:
        yield _solid(part, part.colour)
    if item.parts or not item.grasp_offset_m:
        return
    half = np.array(main.half_m) + _COLLAR_M
    long_axis = 2 if item.upright else 1
    half[long_axis] = _COLLAR_HALF_LENGTH_M
    for offset_m in (-item.grasp_offset_m, item.grasp_offset_m):
        position = np.zeros(3)
        position[long_axis] = offset_m
        size_m = tuple((2.0 * half).tolist())
        collar = PartConfig(shape=main.shape, size_m=size_m, axis=main.axis)
        yield _solid(collar, _BLUE)._replace(position_m=tuple(position.tolist()), shine=0.1)


def _solid(part: PartConfig, rgba: Rgba | None) -> Piece:
    edge_m = min(_EDGE_MAX_M, _EDGE_SHARE * 2.0 * min(part.half_m))
    if part.shape == "box":
        return Piece(rounded_box(part.half_m, edge_m), part.position_m, rgba=rgba)
    x_m, y_m, z_m = part.half_m
    lies = part.axis == "y"
    shape = rounded_cylinder(x_m, y_m if lies else z_m, edge_m)
    return Piece(shape, part.position_m, _ALONG_Y if lies else _UPRIGHT, rgba, shine=0.5)


def bottle(item: ObjectConfig) -> Iterator[Piece]:
    """Yield a square bottle with a label and a wide cap."""
    half_x, half_y, half_z = item.solids[0].half_m
    shoulder_m = half_z - 0.020
    body_half_m = (half_z + shoulder_m) / 2.0
    centre_m = (shoulder_m - half_z) / 2.0
    radius_m = 0.25 * min(half_x, half_y)
    yield Piece(
        rounded_box((half_x, half_y, body_half_m), radius_m),
        (0.0, 0.0, centre_m),
        shine=0.8,
    )
    label = (half_x + 0.0004, half_y + 0.0004, 0.38 * half_z)
    yield Piece(_tube(label, radius_m), (0.0, 0.0, -0.25 * half_z), rgba=_PAPER, shine=0.05)
    stripe = (half_x + 0.0007, half_y + 0.0007, 0.05 * half_z)
    yield Piece(_tube(stripe, radius_m), (0.0, 0.0, -0.48 * half_z), shine=0.05)
    neck_m = 0.62 * min(half_x, half_y)
    yield Piece(rounded_cylinder(neck_m, 0.006, 0.001), (0.0, 0.0, shoulder_m + 0.002), shine=0.8)
    cap_m = (half_z - shoulder_m - 0.004) / 2.0
    cap = rounded_cylinder(0.78 * min(half_x, half_y), cap_m, 0.002)
    yield Piece(cap, (0.0, 0.0, half_z - cap_m), rgba=_PAPER, shine=0.3)


def _tube(half_m: tuple[float, float, float], radius_m: float) -> Shape:
    """Return a block about z with rounded vertical edges."""
    import trimesh

    half_x, half_y, half_z = half_m
    angles = np.linspace(0.0, np.pi / 2.0, 6)
    corners: list[list[float]] = []
    for quarter, (sign_x, sign_y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for angle in angles + quarter * np.pi / 2.0:
            x = sign_x * (half_x - radius_m) + radius_m * np.cos(angle)
            y = sign_y * (half_y - radius_m) + radius_m * np.sin(angle)
            corners.append([x, y])
    outline = np.array(corners)
    n = len(outline)
    below = np.column_stack([outline, np.full(n, -half_z)])
    above = np.column_stack([outline, np.full(n, half_z)])
    solid = trimesh.convex.convex_hull(np.vstack([below, above]))
    return smooth(solid.vertices, solid.faces)


def pot(item: ObjectConfig) -> Iterator[Piece]:
    """Yield an enamelled pot: rounded below, with a steel rim, a domed lid, a knob, two handles."""
    main, *more = item.solids
    radius_m, _, half_m = main.half_m
    base_m = 0.18 * radius_m
    angles = np.linspace(0.0, np.pi / 2.0, 6)
    foot = [
        (radius_m - base_m + base_m * np.sin(angle), base_m - half_m - base_m * np.cos(angle))
        for angle in angles
    ]
    yield Piece(turned([(0.0, -half_m), *foot, (radius_m, half_m), (0.0, half_m)]), shine=0.7)
    rim = rounded_cylinder(radius_m + 0.002, 0.003, 0.002)
    yield Piece(rim, (0.0, 0.0, half_m - 0.003), rgba=_STEEL, shine=0.9)
    for part in more:
        if part.shape == "box":
            yield _rounded(part, 0.9)
        elif part.half_m[0] > 0.5 * radius_m:
            yield _lid(part)
        else:
            yield _knob(part)


def _rounded(part: PartConfig, share: float) -> Piece:
    shape = rounded_box(part.half_m, share * min(part.half_m))
    return Piece(shape, part.position_m, rgba=part.colour, shine=0.3)


def _lid(part: PartConfig) -> Piece:
    radius_m, _, half_m = part.half_m
    edge = [(0.0, -half_m), (radius_m, -half_m), (radius_m, -0.5 * half_m)]
    dome = [
        (share * 0.96 * radius_m, half_m * (1.0 - 1.3 * share**2.5))
        for share in np.linspace(1.0, 0.0, 12)
    ]
    return Piece(turned([*edge, *dome]), part.position_m, rgba=part.colour, shine=0.9)


def _knob(part: PartConfig) -> Piece:
    radius_m, _, half_m = part.half_m
    profile = [
        (0.0, -half_m - 0.002),
        (0.45 * radius_m, -half_m - 0.002),
        (0.40 * radius_m, -0.2 * half_m),
        (0.95 * radius_m, 0.15 * half_m),
        (1.00 * radius_m, 0.45 * half_m),
        (0.85 * radius_m, 0.85 * half_m),
        (0.45 * radius_m, half_m),
        (0.0, half_m),
    ]
    return Piece(turned(profile), part.position_m, rgba=part.colour, shine=0.5)


def peg(item: ObjectConfig) -> Iterator[Piece]:
    """Yield a square peg with a pale tip as long as the bore is deep."""
    yield from plain(item)
    half_x, half_y, half_z = item.solids[0].half_m
    tip_m = 0.0225
    tip = (half_x + 0.0002, tip_m, half_z + 0.0002)
    yield Piece(
        rounded_box(tip, 0.0015),
        (0.0, half_y - tip_m + 0.0002, 0.0),
        rgba=(0.95, 0.80, 0.74, 1.0),
    )


LOOKS: dict[str, Callable[[ObjectConfig], Iterator[Piece]]] = {
    "bottle": bottle,
    "peg": peg,
    "pot": pot,
}
"""By an object's name; others are `plain`."""


def _add_border(
    spec: mujoco.MjSpec,
    name: str,
    xy_m: tuple[float, float],
    size_m: tuple[float, float],
    rgba: Rgba,
) -> None:
    """Stand four low walls on the outline of a field."""
    half_x, half_y = (size / 2.0 for size in size_m)
    thin_m = _RIM_THICKNESS_M / 2.0
    height_m = _RIM_HEIGHT_M / 2.0
    walls = (
        (0.0, half_y - thin_m, half_x, thin_m),
        (0.0, thin_m - half_y, half_x, thin_m),
        (half_x - thin_m, 0.0, thin_m, half_y),
        (thin_m - half_x, 0.0, thin_m, half_y),
    )
    for index, (x, y, wall_x, wall_y) in enumerate(walls):
        shape = rounded_box((wall_x, wall_y, height_m), 0.002)
        piece = Piece(shape, (xy_m[0] + x, xy_m[1] + y, height_m))
        _add(spec, spec.worldbody, piece, rgba, f"{PREFIX}border/{name}/{index}")
