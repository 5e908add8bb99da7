"""URDF of both arms, and the xacro files that expand to it."""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from minidual.robot.description import arm_elements
from minidual.robot.files import packages_of
from minidual.robot.models import ArmModel
from minidual.robot.pair import SIDES, Robot
from minidual.robot.urdf import materials
from minidual.ros2.export.markup import number, numbers, xacro
from minidual.ros2.export.meshes import MeshFiles
from minidual.ros2.names import PackageNames

ROOT_LINK = "world"
_DROPPED = ("safety_controller",)
"""Soft limits of ROS 1."""
_MESH_KINDS = ("visual", "collision")
_PREFIX = "${prefix}"
_FIND = "$(find {})"


def urdf(robot: Robot, meshes: MeshFiles, names: PackageNames) -> ET.Element:
    """Return the whole URDF without hardware, as the xacro files expand."""
    root = ET.Element("robot", name=names.robot)
    for arm in dict.fromkeys(robot.arms):
        root.extend(_material_elements(arm))
    ET.SubElement(root, "link", name=ROOT_LINK)
    for side, arm, origin in zip(SIDES, robot.arms, _origins(robot), strict=True):
        root.extend(_arm_parts(arm, f"{side}_", meshes))
        base = _base_joint(f"{side}_", arm.base_link, ROOT_LINK)
        base.insert(0, origin)
        root.append(base)
    return root


def arm_macro(arm: ArmModel, meshes: MeshFiles) -> ET.Element:
    """Return the xacro file of one arm: the macro ARM_arm(prefix, parent, *origin)."""
    root = ET.Element("robot")
    root.extend(_material_elements(arm))
    macro = ET.SubElement(
        root,
        xacro("macro"),
        name=f"{arm.name}_arm",
        params="prefix parent *origin",
    )
    macro.extend(_arm_parts(arm, _PREFIX, meshes))
    base = _base_joint(_PREFIX, arm.base_link, "${parent}")
    base.insert(0, ET.Element(xacro("insert_block"), name="origin"))
    macro.append(base)
    return root


def pair_xacro(robot: Robot, names: PackageNames, hardware: tuple[str, ...]) -> ET.Element:
    """Return the xacro file of the robot: two arms, and the hardware named by an argument.

    Args:
        robot: The pair.
        names: Names of the workspace.
        hardware: Values of the argument `hardware`, default first.
    """
    root = ET.Element("robot", name=names.robot)
    root.append(ET.Comment(f" hardware: {', '.join(hardware)}, or none "))
    defaults = {"hardware": hardware[0], "headless": "false"}
    for side in SIDES:
        defaults[f"{side}_robot_ip"] = ""
    for name, default in defaults.items():
        ET.SubElement(root, xacro("arg"), name=name, default=default)
    folder = f"{_FIND.format(names.description)}/urdf"
    files = [f"{arm.name}_arm.xacro" for arm in dict.fromkeys(robot.arms)]
    for file in (*files, f"{names.robot}.ros2_control.xacro"):
        ET.SubElement(root, xacro("include"), filename=f"{folder}/{file}")
    ET.SubElement(root, "link", name=ROOT_LINK)
    for side, arm, origin in zip(SIDES, robot.arms, _origins(robot), strict=True):
        call = ET.SubElement(
            root,
            xacro(f"{arm.name}_arm"),
            {"prefix": f"{side}_", "parent": ROOT_LINK},
        )
        call.append(origin)
    ET.SubElement(root, xacro(f"{names.robot}_ros2_control"), hardware="$(arg hardware)")
    return root


def _origins(robot: Robot) -> list[ET.Element]:
    """Return where the left and the right base stand."""
    return [
        ET.Element("origin", xyz=numbers(position_m), rpy=numbers(rpy_rad))
        for position_m, rpy_rad in zip(robot.base_positions_m, robot.base_rpys_rad, strict=True)
    ]


def _base_joint(prefix: str, base_link: str, parent: str) -> ET.Element:
    """Return the joint that fixes a base, without its origin."""
    joint = ET.Element("joint", name=f"{prefix}base_on_world", type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=f"{prefix}{base_link}")
    return joint


def _material_elements(arm: ArmModel) -> Iterator[ET.Element]:
    """Yield the colours that visuals name without giving them."""
    packages = packages_of(arm.packages)
    colours = materials(arm.hand.urdf, packages) | materials(arm.urdf, packages)
    used: dict[str, None] = {}
    for element in arm_elements(arm):
        for material in element.iter("material"):
            used[material.get("name", "")] = None
    for name in used:
        if name in colours:
            material = ET.Element("material", name=name)
            ET.SubElement(material, "color", rgba=numbers(colours[name]))
            yield material


def _arm_parts(arm: ArmModel, prefix: str, meshes: MeshFiles) -> Iterator[ET.Element]:
    """Yield the links and joints of an arm and its hand with a prefix."""
    for element in arm_elements(arm):
        part = copy.deepcopy(element)
        part.set("name", prefix + part.attrib["name"])
        for tag in ("parent", "child"):
            for reference in part.findall(tag):
                reference.set("link", prefix + reference.attrib["link"])
        for mimic in part.findall("mimic"):
            mimic.set("joint", prefix + mimic.attrib["joint"])
        for tag in _DROPPED:
            for child in part.findall(tag):
                part.remove(child)
        for kind in _MESH_KINDS:
            for mesh in part.iterfind(f"{kind}/geometry/mesh"):
                mesh.set("filename", meshes.uri(kind, Path(mesh.attrib["filename"])))
        _set_limits(part, arm, element.attrib["name"])
        yield part


def _set_limits(part: ET.Element, arm: ArmModel, name: str) -> None:
    """Give an arm's joint the limits of the arm model, which all of minidual uses."""
    if part.tag != "joint" or name not in arm.joints:
        return
    k = arm.joints.index(name)
    limit = part.find("limit")
    if limit is None:
        limit = ET.SubElement(part, "limit")
    limit.set("lower", number(arm.q_lower[k]))
    limit.set("upper", number(arm.q_upper[k]))
    limit.set("velocity", number(arm.v_max[k]))
    limit.set("effort", number(arm.tau_max[k]))
