"""Groups, named states and end effectors, held to what the robot really is."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from minidual.collision.errors import OutOfLimitsError
from minidual.config.semantics import ChainConfig, NamedStateConfig, SemanticsConfig
from minidual.errors import ConfigError, UsageError, unknown_name
from minidual.motion.goals import check_joints
from minidual.robot.constants import ARMS, DOF_PER_ARM, GROUPS, HOME, JOINT_NAMES, Array
from minidual.robot.description import dual_panda_urdf


@dataclass(frozen=True)
class EndEffector:
    """A hand.

    Attributes:
        name: As configured, for example "left_hand".
        arm: "left" or "right".
        parent_link: Link that carries it.
        tcp_link: Frame that pose goals are given for.
    """

    name: str
    arm: str
    parent_link: str
    tcp_link: str


class Semantics:
    """What the configuration says about the robot, checked against the robot.

    Raises:
        ConfigError: A group, chain, end effector or state that does not fit the robot; with dotted path and numbers.
    """

    def __init__(self, config: SemanticsConfig | None = None) -> None:
        self.config = config or SemanticsConfig()
        self.groups = _checked_groups(self.config)
        self.end_effectors = _checked_end_effectors(self.config)
        self._states = {name: _checked_state(name, s) for name, s in self.config.states.items()}

    @property
    def state_names(self) -> tuple[str, ...]:
        """Every named state."""
        return tuple(self._states)

    def describe(self, name: str) -> str:
        """Return what a state is for."""
        self._require(name)
        return self.config.states[name].description

    def arms_of(self, name: str) -> tuple[str, ...]:
        """Return the arms that a state speaks of."""
        return tuple(self._require(name))

    def state(self, name: str, group: str, q_others: Array) -> Array:
        """Return a named state as q (14,); arms outside the group stay where `q_others` (14,) has them.

        Raises:
            UsageError: No such state, or it says nothing about an arm of the group.
        """
        parts = self._require(name)
        q = np.array(q_others, dtype=float)
        arms = ARMS if group == "both_arms" else (group.removesuffix("_arm"),)
        for arm in arms:
            if arm not in parts:
                raise UsageError(
                    f"the state '{name}' says nothing about the {arm} arm, which {group} moves",
                    remedy=f"give semantics.states.{name}.{arm}_rad, or plan for another group",
                )
            q[GROUPS[f"{arm}_arm"]] = parts[arm]
        return q

    def _require(self, name: str) -> Mapping[str, Array]:
        if name not in self._states:
            raise unknown_name("named state", name, self._states)
        return self._states[name]


def _checked_groups(config: SemanticsConfig) -> dict[str, tuple[str, ...]]:
    """Return the joints of every group, walked along its chains."""
    if set(config.groups) != set(GROUPS):
        raise ConfigError(f"semantics.groups names {', '.join(config.groups)}; the planner has {', '.join(GROUPS)}")
    groups = {}
    for name, group in config.groups.items():
        joints = tuple(joint for chain in group.chains for joint in _chain_joints(name, chain))
        expected = JOINT_NAMES[GROUPS[name]]
        if joints != expected:
            raise ConfigError(
                f"semantics.groups.{name}: its chains hold {len(joints)} joints ({', '.join(joints)}); "
                f"the planner's group has {len(expected)} ({expected[0]} to {expected[-1]})"
            )
        groups[name] = joints
    return groups


def _chain_joints(group: str, chain: ChainConfig) -> list[str]:
    """Return the arm joints between two links, from the base out."""
    parents, links = _tree()
    for link in (chain.base_link, chain.tip_link):
        if link not in links:
            error = unknown_name("link", link, links)
            raise ConfigError(f"semantics.groups.{group}: {error.message}", remedy=error.remedy)
    joints: list[str] = []
    link = chain.tip_link
    while link != chain.base_link:
        if link not in parents:
            raise ConfigError(f"semantics.groups.{group}: {chain.tip_link} does not hang on {chain.base_link}")
        joint, link = parents[link]
        if joint in JOINT_NAMES:
            joints.append(joint)
    return joints[::-1]


@cache
def _tree() -> tuple[dict[str, tuple[str, str]], tuple[str, ...]]:
    """Return {link: (joint above it, parent link)} and every link of the robot."""
    root = ET.fromstring(dual_panda_urdf())
    links = tuple(link.attrib["name"] for link in root.findall("link"))
    parents = {}
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            parents[child.attrib["link"]] = (joint.attrib["name"], parent.attrib["link"])
    return parents, links


def link_names() -> tuple[str, ...]:
    """Return every link of the robot: the frames that goals and attached objects may name."""
    return _tree()[1]


def _checked_end_effectors(config: SemanticsConfig) -> dict[str, EndEffector]:
    parents, links = _tree()
    hands = {}
    for name, hand in config.end_effectors.items():
        where = f"semantics.end_effectors.{name}"
        if hand.group not in GROUPS or hand.group == "both_arms":
            raise ConfigError(f"{where}: group '{hand.group}'; a hand belongs to left_arm or right_arm")
        for link in (hand.parent_link, hand.tcp_link):
            if link not in links:
                error = unknown_name("link", link, links)
                raise ConfigError(f"{where}: {error.message}", remedy=error.remedy)
        arm = hand.group.removesuffix("_arm")
        if hand.tcp_link != f"{arm}_panda_hand_tcp":
            raise ConfigError(f"{where}: tcp_link {hand.tcp_link}; inverse kinematics goes to {arm}_panda_hand_tcp")
        above = hand.tcp_link
        while above != hand.parent_link and above in parents:
            above = parents[above][1]
        if above != hand.parent_link:
            raise ConfigError(f"{where}: {hand.tcp_link} does not hang on {hand.parent_link}")
        hands[name] = EndEffector(name, arm, hand.parent_link, hand.tcp_link)
    return hands


def _checked_state(name: str, state: NamedStateConfig) -> dict[str, Array]:
    parts = {}
    given = {arm: joints for arm in ARMS if (joints := getattr(state, f"{arm}_rad")) is not None}
    if not given:
        raise ConfigError(f"semantics.states.{name}: it gives neither left_rad nor right_rad")
    for arm, joints in given.items():
        where = f"semantics.states.{name}.{arm}_rad"
        if len(joints) != DOF_PER_ARM:
            raise ConfigError(f"{where}: {len(joints)} values; an arm has {DOF_PER_ARM} joints")
        q = np.array(HOME)
        q[GROUPS[f"{arm}_arm"]] = joints
        try:
            parts[arm] = check_joints(q, where)[GROUPS[f"{arm}_arm"]]
        except OutOfLimitsError as error:
            raise ConfigError(error.message) from error
    return parts
