"""The URDF of two arms, composed from descriptions.

Links and joints are prefixed `left_` and `right_`; both bases are fixed to `world`.
"""

import copy
import functools
import itertools
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from minidual.errors import UsageError
from minidual.robot.arm_checks import check_hand, check_joints, check_masses, set_limits
from minidual.robot.files import file_at, packages_of
from minidual.robot.inertias import mass_of, mend_inertia
from minidual.robot.mesh_files import own_name, readable
from minidual.robot.models import ArmModel
from minidual.robot.pair import SIDES, Robot
from minidual.robot.urdf import ends, part
from minidual.robot.urdf import materials as materials


class Link(NamedTuple):
    """One link of an arm or hand.

    Attributes:
        joints_before: Number of arm joints that move it, without fingers.
        collides: Whether it has collision geometry.
    """

    side: str
    joints_before: int
    collides: bool


class _Prepared(NamedTuple):
    """Links and joints of an arm and its hand, and the repairs of their description."""

    elements: tuple[ET.Element, ...]
    notes: tuple[str, ...]


def arm_elements(arm: ArmModel) -> tuple[ET.Element, ...]:
    """Return the links and joints of an arm and its hand. Cached: do not modify.

    They are those of the URDF, but inertias are possible ones, limits those of the model, and
    collision meshes in formats that both engines read.

    Raises:
        UsageError: The URDF cannot be used; the message names what is wrong.
    """
    return _prepared(arm).elements


def description_notes(robot: Robot) -> tuple[str, ...]:
    """Return the repairs of the descriptions of both arms."""
    return tuple(dict.fromkeys(note for arm in robot.arms for note in _prepared(arm).notes))


@functools.cache
def _prepared(arm: ArmModel) -> _Prepared:
    hand = arm.hand
    packages = packages_of(arm.packages)
    own = part(arm.urdf, arm.base_link, arm.flange_link, packages)
    check_joints(arm, own, packages)
    set_limits(arm, own)
    of_hand = part(hand.urdf, hand.palm_link, None, packages)
    check_hand(hand, of_hand)
    mount = ET.Element("joint", name=f"{hand.palm_link}_joint", type="fixed")
    ET.SubElement(mount, "parent", link=arm.flange_link)
    ET.SubElement(mount, "child", link=hand.palm_link)
    rpy = " ".join(map(str, arm.mount_rpy_rad))
    ET.SubElement(mount, "origin", rpy=rpy, xyz=_text(arm.mount_xyz_m))
    elements = (*own, mount, *of_hand)
    _check_distinct(arm, elements)
    notes = [_mend(element, arm) for element in elements if element.tag == "link"]
    check_masses(arm, elements)
    return _Prepared(elements, tuple(note for note in notes if note))


def _check_distinct(arm: ArmModel, elements: tuple[ET.Element, ...]) -> None:
    """Refuse names that arm and hand share."""
    names: set[tuple[str, str]] = set()
    for element in elements:
        key = (element.tag, element.attrib["name"])
        if key in names:
            raise UsageError(
                f"arm '{arm.name}' and its hand '{arm.hand.name}' both have a {key[0]} '{key[1]}'",
                remedy="end the arm at a flange_link before the hand, or rename it in the URDF",
            )
        names.add(key)


def _mend(link: ET.Element, arm: ArmModel) -> str:
    """Balance the inertia of a link, and make its collision meshes readable; return a note, or ""."""
    owner = f"arm '{arm.name}', link '{link.attrib['name']}'"
    for mesh in link.findall("collision/geometry/mesh"):
        try:
            mesh.set("filename", str(readable(Path(mesh.attrib["filename"]))))
        except UsageError as error:
            raise UsageError(f"{owner}: {error.message}", remedy=error.remedy) from error
    for mesh in link.iter("mesh"):
        scale = mesh.get("scale", "1 1 1")
        if not all(map(float, scale.split())):
            raise UsageError(f"{owner}: a mesh has the scale {scale}; no factor may be 0")
    return mend_inertia(link, owner)


@functools.cache
def links_of(robot: Robot) -> dict[str, Link]:
    """Return all links by name, left arm first, base to tip."""
    links: dict[str, Link] = {}
    for side, arm in zip(SIDES, robot.arms, strict=True):
        links |= _links_of_arm(side, arm)
    return links


def _links_of_arm(side: str, arm: ArmModel) -> dict[str, Link]:
    """Return the links of one arm by prefixed name, base to tip."""
    elements = arm_elements(arm)
    joint_above = {ends(element).child: element for element in elements if element.tag == "joint"}

    def joints_before(link: str) -> int:
        joint = joint_above.get(link)
        if joint is None:
            return 0
        is_arm_joint = joint.attrib["name"] in arm.joints
        return joints_before(ends(joint).parent) + is_arm_joint

    links: dict[str, Link] = {}
    for element in elements:
        if element.tag == "link":
            name = element.attrib["name"]
            collides = element.find("collision") is not None
            links[f"{side}_{name}"] = Link(side, joints_before(name), collides)
    return links


@functools.cache
def massless_links(robot: Robot) -> frozenset[str]:
    """Return the names of the links for which the URDF gives no mass."""
    names: list[str] = []
    for side, arm in zip(SIDES, robot.arms, strict=True):
        for element in arm_elements(arm):
            if element.tag == "link" and not mass_of(element) > 0.0:
                names.append(f"{side}_{element.attrib['name']}")
    return frozenset(names)


@functools.cache
def collision_links(robot: Robot) -> tuple[str, ...]:
    """Return the names of the links with collision geometry."""
    return tuple(name for name, link in links_of(robot).items() if link.collides)


@functools.cache
def beside_base(arm: ArmModel) -> tuple[tuple[str, str], ...]:
    """Return the pairs of a link that stands still and one that the first joint moves.

    They meet at the joint. MuJoCo leaves out such neighbours elsewhere, but not on the world.
    """
    links = _links_of_arm(SIDES[0], arm)
    prefix = f"{SIDES[0]}_"
    still = [name.removeprefix(prefix) for name, link in links.items() if link.joints_before == 0]
    moved = [name.removeprefix(prefix) for name, link in links.items() if link.joints_before == 1]
    return tuple(itertools.product(still, moved[:1]))


@functools.cache
def never_touching(arm: ArmModel) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that never touch, by the SRDF files and the arm model."""
    links = {element.attrib["name"] for element in arm_elements(arm) if element.tag == "link"}
    pairs: list[tuple[str, str]] = []
    for address in (arm.srdf, arm.hand.srdf):
        if address:
            pairs += _disabled_pairs(address, arm)
    pairs += arm.never_touch
    without_repeats = dict.fromkeys(pairs)
    return tuple(pair for pair in without_repeats if links.issuperset(pair))


def drawn_apart(robot: Robot) -> set[str]:
    """Return the links that their makers draw beside what collides, by the rows of the arms."""
    return {
        f"{side}_{link}"
        for side, arm in zip(SIDES, robot.arms, strict=True)
        for link in arm.drawn_apart
    }


def _disabled_pairs(address: str, arm: ArmModel) -> list[tuple[str, str]]:
    """Return the pairs of links that an SRDF does not check."""
    path = file_at(address, packages_of(arm.packages))
    try:
        entries = list(ET.parse(path).getroot().iter("disable_collisions"))
        return [(entry.attrib["link1"], entry.attrib["link2"]) for entry in entries]
    except (ET.ParseError, UnicodeError, KeyError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"arm '{arm.name}': {path} is no SRDF: {reason}") from error


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
    root = ET.Element("robot", name=f"dual_{robot.name}")
    ET.SubElement(root, "link", name="world")
    poses = zip(SIDES, robot.arms, robot.base_positions_m, robot.base_rpys_rad, strict=True)
    for side, arm, position, rpy in poses:
        for element in arm_elements(arm):
            prepared = _prefixed(element, f"{side}_")
            for tag in ("visual", "mimic", "safety_controller"):
                for child in prepared.findall(tag):
                    prepared.remove(child)
            root.append(prepared)
        taken = {element.get("name") for element in root}
        name = f"{side}_base" if f"{side}_base" not in taken else f"{side}_base_on_world"
        base = ET.SubElement(root, "joint", name=name, type="fixed")
        ET.SubElement(base, "origin", xyz=_text(position), rpy=_text(rpy))
        ET.SubElement(base, "parent", link="world")
        ET.SubElement(base, "child", link=f"{side}_{arm.base_link}")
    _distinguish_meshes(root)
    return ET.tostring(root, encoding="unicode")


def _text(numbers: tuple[float, ...]) -> str:
    """Return numbers as URDFs hold them."""
    return " ".join(map(str, numbers)) if any(numbers) else "0 0 0"


def _distinguish_meshes(root: ET.Element) -> None:
    """Give each mesh file a name of its own: MuJoCo takes the first file of a name for all."""
    files: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        path = mesh.attrib["filename"]
        if files.setdefault(Path(path).stem, path) != path:
            mesh.set("filename", str(own_name(Path(path))))


def mujoco_urdf(robot: Robot) -> str:
    """Return `pair_urdf` with options for MuJoCo's reader.

    By default that reader fuses fixed links, the tool centre point among them, into their parents.
    """
    options = (
        '<mujoco><compiler fusestatic="false" discardvisual="true" strippath="false"/></mujoco>'
    )
    return pair_urdf(robot).replace('<link name="world"', f'{options}<link name="world"', 1)
