"""Named postures."""

import numpy as np

from minidual.collision.errors import OutOfLimitsError
from minidual.config.scene import SemanticsConfig
from minidual.errors import ConfigError, UsageError, check_name
from minidual.motion.checks import goal_joints
from minidual.robot.pair import DUAL_PANDA, GROUP_ARMS, SIDES, Array, Robot

ArmJoints = tuple[float, ...]


class NamedStates(dict[str, dict[str, Array]]):
    """Postures {arm: joints [rad]} of arm model and configuration, by name.

    Raises:
        ConfigError: A state does not fit the robot.
    """

    def __init__(self, config: SemanticsConfig | None = None, robot: Robot = DUAL_PANDA) -> None:
        super().__init__()
        self.robot = robot
        left_arm, right_arm = robot.arms
        self._add("home", left_arm.home, right_arm.home)
        for name, (left, right) in left_arm.postures.items():
            if left_arm == right_arm:
                self._add(name, left, right)
            elif name in right_arm.postures:
                self._add(name, left, right_arm.postures[name][1])
        for name, state in (config or SemanticsConfig()).states.items():
            self._add(name, state.left_rad, state.right_rad)

    def _add(self, name: str, left: ArmJoints | None, right: ArmJoints | None) -> None:
        state: dict[str, Array] = {}
        for side, joints in zip(SIDES, (left, right), strict=True):
            if joints is not None:
                state[side] = self._arm_joints(f"semantics.states.{name}.{side}_rad", side, joints)
        if not state:
            raise ConfigError(f"semantics.states.{name}: it gives neither left_rad nor right_rad")
        self[name] = state

    def _arm_joints(self, where: str, side: str, joints: ArmJoints) -> Array:
        """Return the checked joints of an arm (n,)."""
        robot = self.robot
        group = f"{side}_arm"
        joints_n = robot.dofs[SIDES.index(side)]
        if len(joints) != joints_n:
            raise ConfigError(f"{where}: {len(joints)} values; the arm has {joints_n} joints")
        try:
            q = goal_joints(group, robot.home, np.array(joints), robot, where)
        except OutOfLimitsError as error:
            raise ConfigError(error.message) from error
        return q[robot.groups[group]]

    def joints(self, name: str, group: str, q_others: Array) -> Array:
        """Return a state as q (n,); arms outside the group from `q_others` (n,).

        Raises:
            UsageError: Unknown state, or it lacks an arm of the group.
        """
        check_name("named state", name, self)
        q = np.array(q_others, dtype=float)
        for arm in GROUP_ARMS[group]:
            if arm not in self[name]:
                raise UsageError(
                    f"the state '{name}' says nothing about the {arm} arm, which {group} moves",
                    remedy=f"give semantics.states.{name}.{arm}_rad, or plan for another group",
                )
            q[self.robot.groups[f"{arm}_arm"]] = self[name][arm]
        return q
