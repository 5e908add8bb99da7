"""The SRDF: groups of the right joints, postures within limits, and minidual's allowed collisions."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET

import pytest

from minidual.collision.engines import MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Pairs
from minidual.config.scene import RobotConfig
from minidual.robot.description import collision_links
from minidual.robot.pair import DUAL_PANDA, SIDES, Robot, robot_from
from minidual.ros2.export.description import urdf
from minidual.ros2.export.meshes import MeshFiles
from minidual.ros2.export.semantic import srdf
from minidual.ros2.names import workspace_names

ROBOTS = [robot_from(RobotConfig(arm=name)) for name in ("panda", "xarm7", "ur5")]
ROBOTS.append(robot_from(RobotConfig(arm="panda", right_arm="ur5")))
each_robot = pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)


def trees(robot: Robot) -> tuple[ET.Element, ET.Element]:
    """Return SRDF and URDF."""
    names = workspace_names(robot)
    return srdf(robot, names), urdf(robot, MeshFiles(names.description), names)


def chain_joints(tree: ET.Element, base: str, tip: str) -> list[str]:
    """Return the moving joints from base to tip of a URDF."""
    above = {joint.find("child").get("link"): joint for joint in tree.findall("joint")}
    joints: list[str] = []
    link = tip
    while link != base:
        joint = above[link]
        if joint.get("type") != "fixed":
            joints.append(joint.get("name"))
        link = joint.find("parent").get("link")
    return joints[::-1]


@each_robot
def test_the_groups_have_the_arms_joints_in_order(robot: Robot) -> None:
    semantic, tree = trees(robot)
    groups = {group.get("name"): group for group in semantic.findall("group")}
    assert set(groups) == {"left_arm", "right_arm", "both_arms", "left_hand", "right_hand"}
    found: list[str] = []
    for side in SIDES:
        chain = groups[f"{side}_arm"].find("chain")
        found += chain_joints(tree, chain.get("base_link"), chain.get("tip_link"))
    assert found == list(robot.joint_names)
    subgroups = [group.get("name") for group in groups["both_arms"].findall("group")]
    assert subgroups == ["left_arm", "right_arm"]


@each_robot
def test_an_end_effector_hangs_on_its_arm_and_is_no_part_of_it(robot: Robot) -> None:
    semantic, tree = trees(robot)
    links = {link.get("name") for link in tree.findall("link")}
    groups = {group.get("name"): group for group in semantic.findall("group")}
    effectors = semantic.findall("end_effector")
    assert len(effectors) == len(SIDES)
    for effector in effectors:
        chain = groups[effector.get("parent_group")].find("chain")
        assert effector.get("parent_link") == chain.get("tip_link")
        own = {link.get("name") for link in groups[effector.get("group")].findall("link")}
        assert own <= links
        assert effector.get("parent_link") not in own


@each_robot
def test_named_postures_are_complete_and_within_limits(robot: Robot) -> None:
    semantic, tree = trees(robot)
    limits = {}
    for joint in tree.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            limits[joint.get("name")] = float(limit.get("lower")), float(limit.get("upper"))
    names = set()
    for state in semantic.findall("group_state"):
        names.add(state.get("name"))
        values = {j.get("name"): float(j.get("value")) for j in state.findall("joint")}
        for name, value in values.items():
            lower, upper = limits[name]
            assert lower <= value <= upper
        if state.get("group") == "both_arms":
            assert list(values) == list(robot.joint_names)
    assert {"left_home", "both_home", "left_open", "right_closed"} <= names


@each_robot
def test_the_pairs_are_those_that_the_planner_does_not_check(robot: Robot) -> None:
    semantic, _ = trees(robot)
    rows = [(row.get("link1"), row.get("link2")) for row in semantic.findall("disable_collisions")]
    exported = {frozenset(row) for row in rows}
    assert len(exported) == len(rows), "a pair stands twice"
    scene = PlanningScene(obstacles=(), robot=robot)
    pairs = {frozenset(pair) for pair in itertools.combinations(collision_links(robot), 2)}
    assert exported == pairs - {frozenset(pair) for pair in scene.checked_pairs}


def test_pairs_of_two_arms_are_checked_but_for_the_bases() -> None:
    semantic, _ = trees(DUAL_PANDA)
    across = [
        {row.get("link1"), row.get("link2")}
        for row in semantic.findall("disable_collisions")
        if row.get("link1").partition("_")[0] != row.get("link2").partition("_")[0]
    ]
    assert across == [{"left_panda_link0", "right_panda_link0"}]


def test_no_pair_that_is_checked_touches_at_home() -> None:
    """A start posture in contact would make every plan of MoveIt fail."""
    semantic, _ = trees(DUAL_PANDA)
    allowed = {
        frozenset((row.get("link1"), row.get("link2")))
        for row in semantic.findall("disable_collisions")
    }
    checked = [
        pair
        for pair in itertools.combinations(collision_links(DUAL_PANDA), 2)
        if frozenset(pair) not in allowed
    ]
    engine = MujocoEngine(Pairs(DUAL_PANDA, tuple(checked)))
    assert engine.touching_pairs(DUAL_PANDA.home) == set()
    every = tuple(itertools.combinations(collision_links(DUAL_PANDA), 2))
    touching = MujocoEngine(Pairs(DUAL_PANDA, every)).touching_pairs(DUAL_PANDA.home)
    assert touching, "neighbours do touch: the engine can say so"
    assert touching <= allowed
