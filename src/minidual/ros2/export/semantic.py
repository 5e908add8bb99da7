"""SRDF: groups, named postures, end effectors and allowed collisions."""

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from minidual.collision.scene import PlanningScene
from minidual.robot.description import collision_links
from minidual.robot.pair import GROUP_ARMS, SIDES, Robot
from minidual.ros2.export.markup import number
from minidual.ros2.names import PackageNames, arm_group, hand_group

_REASONS = {
    "rigid": "Adjacent",
    "adjacent": "Adjacent",
    "model": "User",
    "always": "Default",
    "never": "Never",
    "neither": "Never",
}
"""MoveIt's word for the first word of each of ours."""


def unchecked_pairs(robot: Robot) -> Iterator[tuple[str, str, str]]:
    """Yield the pairs of links that minidual's planner does not check, and the reason."""
    scene = PlanningScene(obstacles=(), robot=robot)
    for first, second in itertools.combinations(collision_links(robot), 2):
        reason = scene.why_unchecked(first, second)
        if reason is not None:
            yield first, second, reason


def srdf(robot: Robot, names: PackageNames) -> ET.Element:
    """Return the SRDF.

    An arm's group ends at the flange: a group must not contain its own end effector.
    """
    root = ET.Element("robot", name=names.robot)
    for side, arm in zip(SIDES, robot.arms, strict=True):
        group = ET.SubElement(root, "group", name=arm_group(side))
        ET.SubElement(
            group,
            "chain",
            base_link=f"{side}_{arm.base_link}",
            tip_link=f"{side}_{arm.flange_link}",
        )
    for name, sides in GROUP_ARMS.items():
        if len(sides) > 1:
            group = ET.SubElement(root, "group", name=name)
            for side in sides:
                ET.SubElement(group, "group", name=arm_group(side))
    for side in SIDES:
        _add_hand_group(root, robot, side)
    for group, word, values in _group_states(robot):
        state = ET.SubElement(root, "group_state", name=word, group=group)
        for joint, value in values.items():
            ET.SubElement(state, "joint", name=joint, value=number(value))
    for side, arm in zip(SIDES, robot.arms, strict=True):
        ET.SubElement(
            root,
            "end_effector",
            name=hand_group(side),
            parent_link=f"{side}_{arm.flange_link}",
            group=hand_group(side),
            parent_group=arm_group(side),
        )
    for side in SIDES:
        _, following = robot.hand.finger_joints
        ET.SubElement(root, "passive_joint", name=f"{side}_{following}")
    for first, second, reason in unchecked_pairs(robot):
        word = _REASONS.get(reason.split(" ")[0], "User")
        ET.SubElement(root, "disable_collisions", link1=first, link2=second, reason=word)
    return root


def _add_hand_group(root: ET.Element, robot: Robot, side: str) -> None:
    group = ET.SubElement(root, "group", name=hand_group(side))
    links = (*robot.hand_links(side), f"{side}_{robot.hand.tcp_link}")
    for link in dict.fromkeys(links):
        ET.SubElement(group, "link", name=link)
    for joint in robot.hand.finger_joints:
        ET.SubElement(group, "joint", name=f"{side}_{joint}")


def _group_states(robot: Robot) -> list[tuple[str, str, dict[str, float]]]:
    """Return group, name and joint positions of each named posture, and of open and closed hands."""
    left, right = robot.arms
    postures = {"home": (left.home, right.home)}
    for word in left.postures:
        if word in right.postures:
            postures[word] = (left.postures[word][0], right.postures[word][1])
    states: list[tuple[str, str, dict[str, float]]] = []
    for word, posture in postures.items():
        both: dict[str, float] = {}
        for side, arm, values in zip(SIDES, robot.arms, posture, strict=True):
            joints = (f"{side}_{joint}" for joint in arm.joints)
            of_arm = dict(zip(joints, values, strict=True))
            states.append((arm_group(side), f"{side}_{word}", of_arm))
            both |= of_arm
        states.append(("both_arms", f"both_{word}", both))
    for side in SIDES:
        fingers = [f"{side}_{joint}" for joint in robot.hand.finger_joints]
        for word, opening_m in (("open", robot.hand.travel_m), ("closed", 0.0)):
            states.append((hand_group(side), f"{side}_{word}", dict.fromkeys(fingers, opening_m)))
    return states
