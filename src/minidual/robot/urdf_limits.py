"""Joints and limits of an arm as its URDF states them, to begin an arm model with."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import NamedTuple

from minidual.errors import UsageError
from minidual.robot.files import packages_of
from minidual.robot.urdf import in_order, part

TURNS_RAD = 2.0 * math.pi
"""How far a continuous joint may turn either way from zero."""


class JointLimits(NamedTuple):
    """The moving joints between two links, base first; units as in ArmModel."""

    joints: tuple[str, ...]
    q_lower: tuple[float, ...]
    q_upper: tuple[float, ...]
    v_max: tuple[float, ...]
    tau_max: tuple[float, ...]


def joint_limits(
    urdf: str,
    base_link: str,
    flange_link: str,
    packages: Mapping[str, str] | None = None,
) -> JointLimits:
    """Return the limits of the joints from `base_link` to `flange_link`.

    A continuous joint may turn once either way from zero.

    Raises:
        UsageError: The URDF cannot be read, or states no velocity or effort.
    """
    elements = part(urdf, base_link, flange_link, packages_of(packages or {}))
    joints = [j for j in in_order(elements, base_link) if j.get("type") != "fixed"]
    ranges = [_range(joint) for joint in joints]
    return JointLimits(
        joints=tuple(joint.attrib["name"] for joint in joints),
        q_lower=tuple(lower for lower, _ in ranges),
        q_upper=tuple(upper for _, upper in ranges),
        v_max=tuple(_most(joint, "velocity", urdf) for joint in joints),
        tau_max=tuple(_most(joint, "effort", urdf) for joint in joints),
    )


def _range(joint: ET.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    if joint.get("type") == "continuous" or limit is None:
        return -TURNS_RAD, TURNS_RAD
    return float(limit.get("lower", "0")), float(limit.get("upper", "0"))


def _most(joint: ET.Element, attribute: str, urdf: str) -> float:
    limit = joint.find("limit")
    most = 0.0 if limit is None else float(limit.get(attribute, "0"))
    if not most > 0.0:
        raise UsageError(
            f"{urdf}, joint '{joint.attrib['name']}': the {attribute} of its <limit> is {most:g}; "
            "it must be above 0",
        )
    return most
