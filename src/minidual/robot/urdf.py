"""Read a URDF, and the part of it that is an arm or a hand.

What a URDF must hold: https://wiki.ros.org/urdf/XML
"""

import copy
import functools
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from typing import NamedTuple

from minidual.errors import UsageError, shortened, unknown_name
from minidual.robot.files import Packages, file_at, mesh_at

_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mesh": {"scale": 3},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "color": {"rgba": 4},
}
"""Numbers that an attribute holds, by tag and attribute."""
_XACRO = ("${", "$(")
_NAMES_SHOWN = 12


class Ends(NamedTuple):
    """Links of a joint."""

    parent: str
    child: str


def ends(joint: ET.Element) -> Ends:
    """Return the links of a joint.

    Raises:
        UsageError: One is missing.
    """
    return Ends(_end(joint, "parent"), _end(joint, "child"))


def _end(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    link = None if element is None else element.get("link")
    if not link:
        raise UsageError(f"joint '{joint.get('name')}' of a URDF has no {tag} link")
    return link


@functools.cache
def read_urdf(address: str, packages: Packages = ()) -> ET.Element:
    """Return a URDF whose links and joints form trees. Cached: do not modify.

    Raises:
        UsageError: It is no URDF; the message names what is wrong.
    """
    path = file_at(address, packages)
    try:
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        line, column = error.position
        if "unbound prefix" in str(error) and b"xacro:" in path.read_bytes():
            raise _not_expanded(str(path), "tags of xacro") from error
        raise UsageError(
            f"{path}, line {line}, column {column}: this is no XML: {error.msg}",
            remedy="the file may be cut off: take it from its source again",
        ) from error
    except UnicodeError as error:
        raise UsageError(f"{path} is no text: {error}") from error
    _check_expanded(root, str(path))
    if root.tag != "robot":
        raise UsageError(f"{path} begins with <{root.tag}>; a URDF begins with <robot>")
    _check_names(root, str(path))
    _check_tree(root, str(path))
    return root


def _check_expanded(root: ET.Element, path: str) -> None:
    """Refuse text that xacro should have replaced."""
    for element in root.iter():
        rest = next((v for v in element.attrib.values() if v.startswith(_XACRO) or "${" in v), "")
        if not rest and "ros.org" in element.tag and "xacro" in element.tag:
            rest = f"<xacro:{element.tag.rpartition('}')[2]}>"
        if rest:
            raise _not_expanded(path, rest)


def _not_expanded(path: str, rest: str) -> UsageError:
    return UsageError(
        f"{path} holds {rest}, which xacro replaces: this is the source of a URDF",
        remedy="run xacro first: xacro FILE.xacro > FILE.urdf",
    )


def _check_names(root: ET.Element, path: str) -> None:
    """Refuse links and joints without a name, or with one that is taken."""
    for tag in ("link", "joint"):
        names: set[str] = set()
        for element in root.findall(tag):
            name = element.get("name")
            if not name:
                raise UsageError(f"{path}: a {tag} has no name")
            if name in names:
                raise UsageError(f"{path}: two {tag}s are named '{name}'")
            names.add(name)


def _check_tree(root: ET.Element, path: str) -> None:
    """Refuse joints without two links, links with two parents, and loops."""
    links = {link.attrib["name"] for link in root.findall("link")}
    parent_of: dict[str, str] = {}
    for joint in root.findall("joint"):
        name = joint.attrib["name"]
        try:
            parent, child = ends(joint)
        except UsageError as error:
            raise _of_file(path, error) from error
        for link in (parent, child):
            if link not in links:
                raise _of_file(path, unknown_name(f"link (of joint '{name}')", link, links))
        if child in parent_of:
            raise UsageError(f"{path}: two joints move link '{child}'; a URDF is a tree")
        parent_of[child] = parent
    for link in links:
        above = _upwards(link, parent_of)
        if above and above[-1] in parent_of:
            raise UsageError(f"{path}: link '{link}' hangs on itself; a URDF is a tree")


def _of_file(path: str, error: UsageError) -> UsageError:
    return UsageError(f"{path}: {error.message}", remedy=error.remedy)


def _upwards(link: str, parent_of: dict[str, str]) -> list[str]:
    """Return a link and all above it, nearest first; the way ends where it meets itself."""
    chain = [link]
    while chain[-1] in parent_of and len(chain) <= len(parent_of):
        chain.append(parent_of[chain[-1]])
    return chain


def part(address: str, base: str, tip: str | None, packages: Packages = ()) -> list[ET.Element]:
    """Return copies of the links and joints from `base` to `tip`, or all beyond it if tip is None.

    Their meshes have absolute paths.

    Raises:
        UsageError: There is no such part, or it holds what is no number or no file.
    """
    root = read_urdf(address, packages)
    parent_of = {child: parent for parent, child in map(ends, root.findall("joint"))}
    links = [link.attrib["name"] for link in root.findall("link")]
    for link in (base, tip):
        if link is not None and link not in links:
            raise _of_file(address, unknown_name("link", link, links))
    if tip is None:
        taken = {link for link in links if base in _upwards(link, parent_of)}
    else:
        taken = set(_upwards(tip, parent_of))
    if base not in taken:
        raise UsageError(f"{address}: link '{tip}' does not hang on '{base}'")
    taken -= set(_upwards(base, parent_of)[1:])

    def is_taken(element: ET.Element) -> bool:
        if element.tag == "link":
            return element.attrib["name"] in taken
        return element.tag == "joint" and taken.issuperset(ends(element))

    elements = [copy.deepcopy(element) for element in root if is_taken(element)]
    folder = file_at(address, packages).parent
    for element in elements:
        check_numbers(element, address)
        for mesh in element.iter("mesh"):
            owner = f"{address}, link '{element.attrib['name']}'"
            name = mesh.get("filename")
            if not name:
                raise UsageError(f"{owner}: a mesh has no filename")
            try:
                mesh.set("filename", str(mesh_at(name, folder, packages)))
            except UsageError as error:
                raise _of_file(owner, error) from error
    return elements


def in_order(elements: Iterable[ET.Element], base: str) -> list[ET.Element]:
    """Return the joints of a chain of links and joints, base first."""
    joint_below = {ends(j).parent: j for j in elements if j.tag == "joint"}
    chain: list[ET.Element] = []
    link = base
    while link in joint_below:
        joint = joint_below[link]
        chain.append(joint)
        link = ends(joint).child
    return chain


def check_numbers(element: ET.Element, address: str) -> None:
    """Refuse attributes of a link or joint that do not hold their finite numbers."""
    owner = f"{address}, {element.tag} '{element.attrib['name']}'"
    for inner in element.iter():
        for name, count in _NUMBERS.get(inner.tag, {}).items():
            text = inner.get(name)
            if text is None:
                continue
            try:
                numbers = [float(word) for word in text.split()]
            except ValueError:
                numbers = []
            if len(numbers) != count or not all(map(math.isfinite, numbers)):
                raise UsageError(
                    f"{owner}: <{inner.tag} {name}='{text}'> must hold {count} finite "
                    f"number{'s' if count > 1 else ''}",
                )


@functools.cache
def materials(address: str, packages: Packages = ()) -> dict[str, tuple[float, ...]]:
    """Return the rgba colours of a URDF by material name."""
    colours: dict[str, tuple[float, ...]] = {}
    for material in read_urdf(address, packages).iter("material"):
        name = material.get("name")
        rgba = own_rgba(material)
        if name and rgba is not None:
            colours[name] = rgba
    return colours


def own_rgba(material: ET.Element) -> tuple[float, ...] | None:
    """Return the rgba that a material itself holds, or None."""
    colour = material.find("color")
    if colour is None or "rgba" not in colour.attrib:
        return None
    try:
        rgba = tuple(map(float, colour.attrib["rgba"].split()))
    except ValueError:
        return None
    return rgba if len(rgba) == 4 else None


def listed(names: Iterable[str]) -> str:
    """Return names for a message."""
    return shortened(list(names), _NAMES_SHOWN) or "none"
