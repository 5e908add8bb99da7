"""Checks of an arm model against its URDF: joints, limits, hand.

Each fault is refused by name, before an engine reads the description.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from minidual.errors import UsageError, unknown_name
from minidual.robot.files import Packages
from minidual.robot.inertias import has_inertia
from minidual.robot.models import ArmModel, HandModel
from minidual.robot.urdf import ends, in_order, listed, read_urdf

_HINGES = ("revolute", "continuous")
_ROUNDING_RAD = 1e-6
"""A limit of the model may lie this far beyond that of the URDF."""
_EXCESS_MAX = 1.0 + 1e-6


def check_joints(arm: ArmModel, elements: Sequence[ET.Element], packages: Packages) -> None:
    """Refuse an arm model whose joints are not the moving ones of its chain, in their order.

    Args:
        arm: The model.
        elements: Links and joints from base to flange.
        packages: See `files.file_at`.

    Raises:
        UsageError: A joint is unknown, fixed, no hinge, mimics another, or is left out.
    """
    owner = f"arm '{arm.name}'"
    chain = in_order(elements, arm.base_link)
    moving = [joint.attrib["name"] for joint in chain if joint.get("type") != "fixed"]
    existing = {j.attrib["name"]: j for j in read_urdf(arm.urdf, packages).findall("joint")}
    on_chain = {joint.attrib["name"] for joint in chain}
    way = f"between '{arm.base_link}' and '{arm.flange_link}'"
    for name in arm.joints:
        if name not in existing:
            error = unknown_name(f"joint of {owner}, {arm.urdf},", name, moving)
            raise UsageError(error.message, remedy=error.remedy)
        if name not in on_chain:
            raise UsageError(
                f"{owner}: joint '{name}' is not {way}; the joints that move there: "
                f"{listed(moving)}",
            )
        _check_hinge(owner, existing[name], moving)
    left_out = [name for name in moving if name not in arm.joints]
    if left_out:
        raise UsageError(
            f"{owner}: joint '{left_out[0]}' moves {way}, and `joints` does not name it; "
            f"the joints that move there: {listed(moving)}",
            remedy=f"name it, or make it fixed in {arm.urdf}",
        )
    if list(arm.joints) != moving:
        raise UsageError(
            f"{owner}: `joints` is in another order than the URDF: {listed(arm.joints)} instead "
            f"of {listed(moving)}",
            remedy=f"joints={tuple(moving)}, and every limit in that order",
        )


def _check_hinge(owner: str, joint: ET.Element, moving: Sequence[str]) -> None:
    name = joint.attrib["name"]
    kind = joint.get("type")
    if kind == "fixed":
        raise UsageError(
            f"{owner}: joint '{name}' is fixed in the URDF; no motor turns it; "
            f"the joints that move: {listed(moving)}",
            remedy="leave it out of `joints`, and its entry out of every limit",
        )
    if kind not in _HINGES:
        raise UsageError(
            f"{owner}: joint '{name}' is of type '{kind}'; an arm has {' and '.join(_HINGES)} "
            "joints",
        )
    mimic = joint.find("mimic")
    if mimic is not None:
        raise UsageError(
            f"{owner}: joint '{name}' mimics '{mimic.get('joint')}': it has no motor of its own",
        )
    axis = joint.find("axis")
    if axis is not None and not any(map(float, axis.get("xyz", "1 0 0").split())):
        raise UsageError(f"{owner}: the axis of joint '{name}' is 0 0 0; it must have a direction")


def set_limits(arm: ArmModel, elements: Sequence[ET.Element]) -> None:
    """Check the limits of the URDF's joints against those of the model, and make them equal.

    The URDF's numbers stay where they differ by rounding only. A continuous joint becomes a
    revolute one with the limits of the model: both engines then hold one angle for it.

    Raises:
        UsageError: The URDF's limits are no range, or the model allows more than they do.
    """
    joints = {element.attrib["name"]: element for element in elements if element.tag == "joint"}
    for index, name in enumerate(arm.joints):
        owner = f"arm '{arm.name}', joint '{name}'"
        _set_range(owner, joints[name], arm.q_lower[index], arm.q_upper[index])
        _set_most(owner, joints[name], "velocity", arm.v_max[index], "v_max", "rad/s")
        _set_most(owner, joints[name], "effort", arm.tau_max[index], "tau_max", "Nm")


def _set_range(owner: str, joint: ET.Element, least_rad: float, most_rad: float) -> None:
    limit = joint.find("limit")
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        limit.set("lower", repr(least_rad))
        limit.set("upper", repr(most_rad))
        return
    if limit is None:
        raise UsageError(
            f"{owner} is revolute and has no <limit> in the URDF",
            remedy="write the limits there, or make the joint continuous",
        )
    lower_rad = float(limit.get("lower", "0"))
    upper_rad = float(limit.get("upper", "0"))
    range_text = f"{lower_rad:g} to {upper_rad:g} rad"
    if not lower_rad < upper_rad:
        raise UsageError(
            f"{owner}: the URDF's limits are {range_text}; the joint cannot move",
            remedy="write the limits there, or make the joint continuous",
        )
    if least_rad < lower_rad - _ROUNDING_RAD or most_rad > upper_rad + _ROUNDING_RAD:
        raise UsageError(
            f"{owner}: q_lower and q_upper are {least_rad:g} to {most_rad:g} rad, the URDF's "
            f"limits {range_text}",
            remedy="take q_lower and q_upper from inside the URDF's limits",
        )
    if least_rad > lower_rad + _ROUNDING_RAD:
        limit.set("lower", repr(least_rad))
    if most_rad < upper_rad - _ROUNDING_RAD:
        limit.set("upper", repr(most_rad))


def _set_most(
    owner: str,
    joint: ET.Element,
    attribute: str,
    most: float,
    name: str,
    unit: str,
) -> None:
    """Set the URDF's velocity or effort where it has none or a larger one."""
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    stated = float(limit.get(attribute, "0"))
    if stated > 0.0 and most > stated * _EXCESS_MAX:
        raise UsageError(
            f"{owner}: {name} is {most:g} {unit}, the URDF's {attribute} {stated:g} {unit}",
            remedy=f"take a {name} of at most {stated:g}",
        )
    if not most <= stated <= most * _EXCESS_MAX:
        limit.set(attribute, repr(most))


def check_masses(arm: ArmModel, elements: Sequence[ET.Element]) -> None:
    """Refuse a link that a joint of the arm moves and that has no mass, nor has what is fixed to it.

    Raises:
        UsageError: There is one.
    """
    links = {element.attrib["name"]: element for element in elements if element.tag == "link"}
    joints = [element for element in elements if element.tag == "joint"]
    fixed_below: dict[str, list[str]] = {}
    for joint in joints:
        if joint.get("type") == "fixed":
            parent, child = ends(joint)
            fixed_below.setdefault(parent, []).append(child)

    def bears_mass(link: str) -> bool:
        rigid = (bears_mass(child) for child in fixed_below.get(link, ()))
        return has_inertia(links[link]) or any(rigid)

    for joint in joints:
        moved = ends(joint).child
        if joint.get("type") != "fixed" and not bears_mass(moved):
            raise UsageError(
                f"arm '{arm.name}': joint '{joint.attrib['name']}' moves link '{moved}', which "
                "has no mass or no inertia",
                remedy=f"give link '{moved}' an <inertial> in the URDF",
            )


def check_hand(hand: HandModel, elements: Sequence[ET.Element]) -> None:
    """Refuse a hand whose fingers are not those of its URDF.

    Args:
        hand: The model.
        elements: Links and joints from the palm outwards.

    Raises:
        UsageError: A finger is missing or does not slide, or something else moves.
    """
    owner = f"hand '{hand.name}'"
    links = [element.attrib["name"] for element in elements if element.tag == "link"]
    joints = {element.attrib["name"]: element for element in elements if element.tag == "joint"}
    for link in (*hand.finger_links, hand.tcp_link):
        if link not in links:
            error = unknown_name(f"link of {owner}, {hand.urdf},", link, links)
            raise UsageError(error.message, remedy=error.remedy)
    for name in hand.finger_joints:
        if name not in joints:
            error = unknown_name(f"joint of {owner}, {hand.urdf},", name, joints)
            raise UsageError(error.message, remedy=error.remedy)
        kind = joints[name].get("type")
        if kind != "prismatic":
            raise UsageError(
                f"{owner}: joint '{name}' is of type '{kind}'; a finger is prismatic",
            )
    for name, joint in joints.items():
        if joint.get("type") != "fixed" and name not in hand.finger_joints:
            raise UsageError(
                f"{owner}: joint '{name}' moves too; fingers are {listed(hand.finger_joints)}",
                remedy=f"make it fixed in {hand.urdf}",
            )
