"""The URDF of two arms, composed from installed descriptions.

Links and joints are prefixed `left_` and `right_`; both bases are fixed to `world`.
"""

import copy
import functools
import importlib.metadata
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.robot.models import ArmModel
from minidual.robot.pair import SIDES, Robot

_SCHEME = "package://"
_PREFIX = "cmeel.prefix/share"
"""Data folder of cmeel wheels."""


class Link(NamedTuple):
    """One link of an arm or hand.

    Attributes:
        joints_before: Number of arm joints that move it, without fingers.
        collides: Whether it has collision geometry.
    """

    side: str
    joints_before: int
    collides: bool


@functools.cache
def file_at(address: str) -> Path:
    """Return the file at an absolute path or package://DISTRIBUTION/path.

    Raises:
        EnvironmentMissingError: There is no such distribution or file.
    """
    if address.startswith(_SCHEME):
        return _file_of_package(address.removeprefix(_SCHEME))
    path = Path(address)
    if not (path.is_absolute() and path.is_file()):
        raise EnvironmentMissingError(
            f"no robot description at '{address}'",
            remedy=f"give an absolute path or {_SCHEME}DISTRIBUTION/path",
        )
    return path


def _file_of_package(location: str) -> Path:
    """Return the file at DISTRIBUTION/path."""
    name = location.partition("/")[0]
    remedy = f"pip install -r requirements.lock, or pip install {name}"
    try:
        distribution = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError as error:
        raise EnvironmentMissingError(
            f"the package '{name}' is not installed",
            remedy=remedy,
        ) from error
    path = Path(str(distribution.locate_file(f"{_PREFIX}/{location}"))).resolve()
    if not path.is_file():
        raise EnvironmentMissingError(f"'{name}' has no file {path}", remedy=remedy)
    return path


@functools.cache
def _document(address: str) -> ET.Element:
    """Return a URDF with absolute mesh paths. Cached: do not modify."""
    path = file_at(address)
    root = ET.parse(path).getroot()
    for mesh in root.iter("mesh"):
        name = mesh.attrib["filename"]
        if name.startswith(_SCHEME):
            mesh_path = file_at(name)
        else:
            mesh_path = (path.parent / name).resolve()
        mesh.set("filename", str(mesh_path))
    return root


def _ends(joint: ET.Element) -> tuple[str, str]:
    """Return the parent and child link of a joint."""
    parent = joint.find("parent")
    child = joint.find("child")
    if parent is None or child is None:
        raise UsageError(f"joint '{joint.get('name')}' of a URDF has no parent or child link")
    return parent.attrib["link"], child.attrib["link"]


def _part(address: str, base: str, tip: str | None) -> list[ET.Element]:
    """Return the links and joints from `base` to `tip`, or all beyond `base` if tip is None."""
    root = _document(address)
    parent_of: dict[str, str] = {}
    for joint in root.findall("joint"):
        parent, child = _ends(joint)
        parent_of[child] = parent
    links = {link.attrib["name"] for link in root.findall("link")}
    for link in (base, tip):
        if link is not None and link not in links:
            raise UsageError(f"{address} has no link '{link}'; it has {', '.join(sorted(links))}")

    def upwards(link: str | None) -> list[str]:
        chain = []
        while link is not None:
            chain.append(link)
            link = parent_of.get(link)
        return chain

    if tip is None:
        taken = {link for link in links if base in upwards(link)}
    else:
        taken = set(upwards(tip))
    if base not in taken:
        raise UsageError(f"{address}: link '{tip}' does not hang on '{base}'")
    above_base = upwards(base)[1:]
    taken -= set(above_base)

    def is_taken(element: ET.Element) -> bool:
        if element.tag == "link":
            return element.attrib["name"] in taken
        return element.tag == "joint" and taken.issuperset(_ends(element))

    return [element for element in root if is_taken(element)]


@functools.cache
def arm_elements(arm: ArmModel) -> tuple[ET.Element, ...]:
    """Return the links and joints of an arm and its hand. Cached: do not modify."""
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
    """Return the rgba colours of a URDF by material name."""
    colours: dict[str, tuple[float, ...]] = {}
    for material in _document(address).iter("material"):
        colour = material.find("color")
        if colour is not None:
            colours[material.attrib["name"]] = tuple(map(float, colour.attrib["rgba"].split()))
    return colours


@functools.cache
def links_of(robot: Robot) -> dict[str, Link]:
    """Return all links by name, left arm first, base to tip."""
    elements = arm_elements(robot.arm)
    joint_above = {_ends(element)[1]: element for element in elements if element.tag == "joint"}

    def joints_before(link: str) -> int:
        joint = joint_above.get(link)
        if joint is None:
            return 0
        parent, _ = _ends(joint)
        is_arm_joint = joint.attrib["name"] in robot.arm.joints
        return joints_before(parent) + is_arm_joint

    links: dict[str, Link] = {}
    for side in SIDES:
        for element in elements:
            if element.tag == "link":
                name = element.attrib["name"]
                collides = element.find("collision") is not None
                links[f"{side}_{name}"] = Link(side, joints_before(name), collides)
    return links


@functools.cache
def collision_links(robot: Robot) -> tuple[str, ...]:
    """Return the names of the links with collision geometry."""
    return tuple(name for name, link in links_of(robot).items() if link.collides)


@functools.cache
def never_touching(arm: ArmModel) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that never touch, by the SRDF files and the arm model."""
    links = {element.attrib["name"] for element in arm_elements(arm) if element.tag == "link"}
    pairs: list[tuple[str, str]] = []
    for address in (arm.srdf, arm.hand.srdf):
        if address:
            root = ET.parse(file_at(address)).getroot()
            for entry in root.iter("disable_collisions"):
                pairs.append((entry.attrib["link1"], entry.attrib["link2"]))
    pairs += arm.never_touch
    without_repeats = dict.fromkeys(pairs)
    return tuple(pair for pair in without_repeats if links.issuperset(pair))


def _prefixed(element: ET.Element, prefix: str) -> ET.Element:
    """Return a copy of a link or joint with a prefix to all link and joint names."""
    element = copy.deepcopy(element)
    element.set("name", prefix + element.attrib["name"])
    for tag in ("parent", "child"):
        for reference in element.iter(tag):
            reference.set("link", prefix + reference.attrib["link"])
    return element


@functools.cache
def pair_urdf(robot: Robot) -> str:
    """Return the URDF of both arms, with absolute mesh paths.

    It has no visuals (MuJoCo reads no DAE) and no `mimic` fingers (each has its own servo).
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
    """Return `pair_urdf` with options for MuJoCo's reader.

    By default that reader fuses fixed links, the tool centre point among them, into their parents.
    """
    options = (
        '<mujoco><compiler fusestatic="false" discardvisual="true" strippath="false"/></mujoco>'
    )
    return pair_urdf(robot).replace('<link name="world"', f'{options}<link name="world"', 1)
