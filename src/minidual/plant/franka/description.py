"""The robot description that a controller sends: seven joints, no shapes, velocity limits by position."""

import xml.etree.ElementTree as ET
from functools import cache

import numpy as np

from minidual.plant.franka.limits import limits_of
from minidual.robot.description import file_at
from minidual.robot.models import ArmModel
from minidual.robot.pair import Array

_SHAPES = ("visual", "collision")
_LAST_LINK = "link8"
EMULATED = "emulated_arm"
"""Name of the described robot; by it a client distinguishes the emulator from hardware."""


@cache
def model_urdf(arm: ArmModel) -> str:
    """Return the URDF of one arm as the client library reads it.

    Links are `link0` to `link8`, joints `joint1` to `joint7`; a client finds them by these names.
    """
    limits = limits_of(arm)
    source = ET.parse(file_at(arm.urdf)).getroot()
    names = _chain(source, arm)
    joints = {name: index for index, name in enumerate(arm.joints)}
    robot = ET.Element("robot", {"name": EMULATED})
    for element in source:
        if element.tag == "link" and element.get("name") in names:
            for shape in _SHAPES:
                for part in element.findall(shape):
                    element.remove(part)
            element.set("name", names[element.get("name", "")])
            robot.append(element)
    for element in source.findall("joint"):
        parent = element.find("parent")
        child = element.find("child")
        if parent is None or child is None:
            continue
        if parent.get("link") not in names or child.get("link") not in names:
            continue
        parent.set("link", names[parent.get("link", "")])
        child.set("link", names[child.get("link", "")])
        index = joints.get(element.get("name", ""))
        if index is not None:
            element.set("name", f"joint{index + 1}")
            velocity = {
                "velocity_offset": f"{limits.velocity_offset[index]:g}",
                "deceleration_limit": f"{limits.deceleration[index]:g}",
            }
            ET.SubElement(element, "position_based_velocity_limits", velocity)
            limit = element.find("limit")
            if limit is not None:
                limit.set("velocity", f"{limits.v_max[index]:g}")
                limit.set("lower", f"{limits.q_lower[index]:g}")
                limit.set("upper", f"{limits.q_upper[index]:g}")
        robot.append(element)
    return ET.tostring(robot, encoding="unicode")


def _chain(source: ET.Element, arm: ArmModel) -> dict[str, str]:
    """Return {link of the arm: its name for the client}, from the base to the flange."""
    child_of: dict[str, tuple[str, str]] = {}
    for joint in source.findall("joint"):
        parent = joint.find("parent")
        child = joint.find("child")
        if parent is not None and child is not None:
            child_of[child.get("link", "")] = (parent.get("link", ""), joint.get("name", ""))
    links = [arm.flange_link]
    while links[-1] != arm.base_link:
        links.append(child_of[links[-1]][0])
    links.reverse()
    names = {link: f"link{index}" for index, link in enumerate(links)}
    names[arm.flange_link] = _LAST_LINK
    return names


def declared_limits(urdf: str) -> tuple[Array, Array] | None:
    """Return the least and largest positions (7,) [rad] in a controller's description, or None."""
    try:
        robot = ET.fromstring(urdf)
    except ET.ParseError:
        return None
    bounds: dict[int, tuple[float, float]] = {}
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        number = joint.get("name", "")[-1:]
        if limit is not None and joint.get("type") == "revolute" and number.isdigit():
            bounds[int(number)] = (
                float(limit.get("lower", "nan")),
                float(limit.get("upper", "nan")),
            )
    if sorted(bounds) != list(range(1, 8)):
        return None
    lower, upper = np.array([bounds[index] for index in range(1, 8)]).T
    return lower, upper
