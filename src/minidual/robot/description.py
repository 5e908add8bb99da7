"""The URDF of two arms, and their visual meshes, from installed descriptions.

Links and joints are prefixed `left_` and `right_`; both bases are fixed to `world`.
"""

import copy
import functools
import importlib.metadata
import itertools
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.robot.pair import SIDES, ArmModel, Array, Robot

_SCHEME = "package://"
_PREFIX = "cmeel.prefix/share"
"""Data folder of cmeel wheels."""


class Link(NamedTuple):
    """One link of an arm or hand.

    Attributes:
        joints_before: Number of arm joints that move it, without fingers.
        collides: Has collision geometry.
    """

    side: str
    joints_before: int
    collides: bool


@functools.cache
def file_at(address: str) -> Path:
    """Resolve an absolute path or package://DISTRIBUTION/path.

    Raises:
        EnvironmentMissingError: No such distribution or file.
    """
    if not address.startswith(_SCHEME):
        path = Path(address)
        if not (path.is_absolute() and path.is_file()):
            remedy = f"give an absolute path or {_SCHEME}DISTRIBUTION/path"
            raise EnvironmentMissingError(f"no robot description at '{address}'", remedy=remedy)
        return path
    name = address.removeprefix(_SCHEME).partition("/")[0]
    remedy = f"pip install -r requirements.lock, or pip install {name}"
    try:
        distribution = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError as error:
        raise EnvironmentMissingError(
            f"the package '{name}' is not installed",
            remedy=remedy,
        ) from error
    path = Path(
        str(distribution.locate_file(f"{_PREFIX}/{address.removeprefix(_SCHEME)}")),
    ).resolve()
    if not path.is_file():
        raise EnvironmentMissingError(f"'{name}' has no file {path}", remedy=remedy)
    return path


@functools.cache
def _document(address: str) -> ET.Element:
    path = file_at(address)
    root = ET.parse(path).getroot()
    for mesh in root.iter("mesh"):
        name = mesh.attrib["filename"]
        mesh.set(
            "filename",
            str(file_at(name) if name.startswith(_SCHEME) else (path.parent / name).resolve()),
        )
    return root


def _ends(joint: ET.Element) -> tuple[str, str]:
    parent = joint.find("parent")
    child = joint.find("child")
    if parent is None or child is None:
        raise UsageError(f"joint '{joint.get('name')}' of a URDF has no parent or child link")
    return parent.attrib["link"], child.attrib["link"]


def _part(address: str, base: str, tip: str | None) -> list[ET.Element]:
    root = _document(address)
    parent = {child: mother for mother, child in map(_ends, root.findall("joint"))}
    links = {link.attrib["name"] for link in root.findall("link")}
    for link in (base, tip):
        if link is not None and link not in links:
            raise UsageError(f"{address} has no link '{link}'; it has {', '.join(sorted(links))}")

    def upwards(link: str | None) -> list[str]:
        chain = []
        while link is not None:
            chain.append(link)
            link = parent.get(link)
        return chain

    taken = {link for link in links if base in upwards(link)} if tip is None else set(upwards(tip))
    if base not in taken:
        raise UsageError(f"{address}: link '{tip}' does not hang on '{base}'")
    taken -= set(upwards(base)[1:])
    return [
        element
        for element in root
        if (element.tag == "link" and element.attrib["name"] in taken)
        or (element.tag == "joint" and taken.issuperset(_ends(element)))
    ]


@functools.cache
def arm_elements(arm: ArmModel) -> tuple[ET.Element, ...]:
    """Return links and joints of arm and hand. Cached: do not modify."""
    hand = arm.hand
    mount = ET.Element("joint", name=f"{hand.palm_link}_joint", type="fixed")
    ET.SubElement(mount, "parent", link=arm.flange_link)
    ET.SubElement(mount, "child", link=hand.palm_link)
    ET.SubElement(mount, "origin", rpy=" ".join(map(str, arm.mount_rpy_rad)), xyz="0 0 0")
    return (
        *_part(arm.urdf, arm.base_link, arm.flange_link),
        mount,
        *_part(hand.urdf, hand.palm_link, None),
    )


@functools.cache
def materials(address: str) -> dict[str, tuple[float, ...]]:
    """Return named rgba colours."""
    found = [(m.attrib["name"], m.find("color")) for m in _document(address).iter("material")]
    return {name: tuple(map(float, c.attrib["rgba"].split())) for name, c in found if c is not None}


@functools.cache
def links_of(robot: Robot) -> dict[str, Link]:
    """Return all links by name, left arm first, base to tip."""
    elements = arm_elements(robot.arm)
    above = {_ends(e)[1]: e for e in elements if e.tag == "joint"}

    def joints_before(link: str) -> int:
        if link not in above:
            return 0
        return joints_before(_ends(above[link])[0]) + (
            above[link].attrib["name"] in robot.arm.joints
        )

    return {
        f"{side}_{name}": Link(side, joints_before(name), e.find("collision") is not None)
        for side in SIDES
        for e in elements
        if e.tag == "link" and (name := e.attrib["name"])
    }


@functools.cache
def collision_links(robot: Robot) -> tuple[str, ...]:
    """Return the names of links with collision geometry."""
    return tuple(name for name, link in links_of(robot).items() if link.collides)


@functools.cache
def never_touching(arm: ArmModel) -> tuple[tuple[str, str], ...]:
    """Return pairs that never touch, by SRDF files and arm model."""
    known = {e.attrib["name"] for e in arm_elements(arm) if e.tag == "link"}
    roots = [
        ET.parse(file_at(address)).getroot() for address in (arm.srdf, arm.hand.srdf) if address
    ]
    told = [
        (e.attrib["link1"], e.attrib["link2"])
        for root in roots
        for e in root.iter("disable_collisions")
    ]
    return tuple(
        pair for pair in dict.fromkeys([*told, *arm.never_touch]) if known.issuperset(pair)
    )


def _prefixed(element: ET.Element, prefix: str) -> ET.Element:
    element = copy.deepcopy(element)
    element.set("name", prefix + element.attrib["name"])
    for tag in ("parent", "child"):
        for ref in element.iter(tag):
            ref.set("link", prefix + ref.attrib["link"])
    return element


@functools.cache
def pair_urdf(robot: Robot) -> str:
    """Return the URDF with absolute mesh paths.

    Without visuals (MuJoCo reads no DAE) and the fingers' `mimic` (each has its own servo).
    """
    root = ET.Element("robot", name=f"dual_{robot.arm.name}")
    ET.SubElement(root, "link", name="world")
    for side, position in zip(SIDES, robot.base_positions_m, strict=True):
        for element in arm_elements(robot.arm):
            part = _prefixed(element, f"{side}_")
            for tag in ("visual", "mimic", "safety_controller"):
                for child in part.findall(tag):
                    part.remove(child)
            root.append(part)
        base = ET.SubElement(root, "joint", name=f"{side}_base", type="fixed")
        ET.SubElement(base, "origin", xyz=" ".join(map(str, position)), rpy="0 0 0")
        ET.SubElement(base, "parent", link="world")
        ET.SubElement(base, "child", link=f"{side}_{robot.arm.base_link}")
    return ET.tostring(root, encoding="unicode")


def mujoco_urdf(robot: Robot) -> str:
    """Return `pair_urdf` with options for MuJoCo's reader: it fuses fixed links (and the tcp) into their parents."""
    options = (
        '<mujoco><compiler fusestatic="false" discardvisual="true" strippath="false"/></mujoco>'
    )
    return pair_urdf(robot).replace('<link name="world"', f'{options}<link name="world"', 1)


FACES_PER_ARM = 9000
"""Target triangles per arm (the Panda's files: 134,300), for rendering on a CPU."""
_Colour = tuple[float, ...]
VisualMesh = tuple[str, npt.NDArray[np.float32], npt.NDArray[np.int32], _Colour]
"""One single-colour mesh: link without side prefix, vertices (V, 3) [m], faces (F, 3), rgba in 0..1."""
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
            mesh, origin, material = (
                visual.find(tag) for tag in ("geometry/mesh", "origin", "material")
            )
            if mesh is None:
                continue
            place = ET.Element("origin") if origin is None else origin
            rpy, xyz = (
                np.array([float(x) for x in place.get(k, "0 0 0").split()]) for k in ("rpy", "xyz")
            )
            R = pin.rpy.rpyToMatrix(rpy).round(15)  # removes the noise of rounded multiples of pi
            scale = np.array([float(x) for x in mesh.get("scale", "1 1 1").split()])
            named = None if material is None else colours.get(material.attrib["name"])
            for colour, vertices, faces in _coloured(Path(mesh.attrib["filename"]), named):
                parts.append((link.attrib["name"], colour, (vertices * scale) @ R.T + xyz, faces))
    reduction = max(0.0, 1.0 - FACES_PER_ARM / sum(len(faces) for *_, faces in parts))
    visuals: list[VisualMesh] = []
    for name, of_link in itertools.groupby(parts, key=lambda part: part[0]):
        _, colours_of, vertices, faces = zip(*of_link, strict=True)
        meshes = _decimated(list(zip(vertices, faces, strict=True)), reduction)
        for colour, (points, triangles) in zip(colours_of, meshes, strict=True):
            if len(triangles) >= 4:
                visuals.append(
                    (name, points.astype(np.float32), triangles.astype(np.int32), colour),
                )
    return tuple(visuals)


def _coloured(
    path: Path,
    colour: _Colour | None,
) -> list[tuple[_Colour, Array, npt.NDArray[np.int64]]]:
    import trimesh

    by_colour: dict[_Colour, list[trimesh.Trimesh]] = {}
    for mesh in trimesh.load_scene(path).dump():
        material = getattr(mesh.visual, "material", None)
        own: Any = None if material is None else tuple(int(c) / 255.0 for c in material.main_color)
        by_colour.setdefault(own or colour or _GREY, []).append(mesh)
    coloured = []
    for shade, meshes in by_colour.items():
        merged = trimesh.util.concatenate(
            [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in meshes],
        )
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
                vertices.astype(np.float32),
                faces.astype(np.int32),
                target_reduction=reduction,
                agg=aggressiveness,
            )
            if len(faces) > 200
            else (vertices, faces)
            for vertices, faces in meshes
        ]
        if (size(fewer) > size(meshes) - _SHRINK_MAX_M).all():
            return fewer
    return meshes
