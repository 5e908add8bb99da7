"""Two arms on a table, and the algebra of poses (4, 4) and rotations (3, 3).

`q` is (n,) [rad], left arm first; grippers are separate, (2,). The arm models (`models.py`) fix n.
`T_a_b` is the pose (4, 4) of b in a: `T_world_rod = T_world_tcp @ T_tcp_rod`. Twists and wrenches
are [linear; angular] (6,), world-aligned by default. Quaternions are wxyz. The world's origin is on
the table top between the bases; x points away from them, left is +y.
"""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from minidual.config.scene import RobotConfig
from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.robot.models import ARM_MODELS, PANDA, ArmModel

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

SIDES: tuple[str, str] = ("left", "right")
"""In storage order."""
GROUP_ARMS = Registry[tuple[str, ...]](
    "group",
    {"left_arm": ("left",), "right_arm": ("right",), "both_arms": SIDES},
)
"""Arms of each planning group."""
GRIPPERS_N = len(SIDES)


_EQUAL_OF_A_PAIR = ("hand", "damping", "friction")
"""Constants of an arm model that the controllers share between both arms."""


class Robot:
    """Two arms on a table; limits are (n,), units as in ArmModel. Equal if the models are.

    Args:
        arm: Model of the left arm, and of the right one if that has none of its own.
        right: Model of the right arm.

    Attributes:
        arms: Models of the left and right arm.
        name: Name of the model, or "LEFT+RIGHT" of two.
        arm: Model of the left arm.
        hand: Model of both grippers.
        base_positions_m: Of the left and right base.
        base_rpys_rad: Orientation of the left and right base.
        dofs: Joints of the left and right arm.
        dof: Joints of both arms, n.
        joint_names: In storage order.
        finger_joint_names: In storage order.
        tcp_names: Links of the left and right tool centre point.
        groups: Slices of q, by planning group.
        tau_rate_max: Rate of a motor torque [Nm/s] that every motor bears.

    Raises:
        UsageError: Two models differ in what must be equal.
    """

    sides = SIDES
    """In storage order."""

    def __init__(self, arm: ArmModel, right: ArmModel | None = None) -> None:
        self.arm = arm
        self.arms = (arm, arm if right is None else right)
        self.name = "+".join(dict.fromkeys(model.name for model in self.arms))
        self._check_pair()
        self.hand = arm.hand
        self.base_positions_m = self._base_positions_m()
        roll, pitch, yaw = self.arms[1].base_rpy_rad
        self.base_rpys_rad = (arm.base_rpy_rad, (-roll, pitch, -yaw))
        self.dofs = (len(arm.joints), len(self.arms[1].joints))
        self.dof = sum(self.dofs)
        sides = list(zip(SIDES, self.arms, strict=True))
        self.joint_names = tuple(f"{side}_{joint}" for side, own in sides for joint in own.joints)
        self.finger_joint_names = tuple(
            f"{side}_{joint}" for side in SIDES for joint in arm.hand.finger_joints
        )
        self.tcp_names = self.both(arm.hand.tcp_link)
        self.groups = {
            "left_arm": slice(0, self.dofs[0]),
            "right_arm": slice(self.dofs[0], self.dof),
            "both_arms": slice(0, self.dof),
        }
        self.home = self._of_both("home")
        self.q_lower = self._of_both("q_lower")
        self.q_upper = self._of_both("q_upper")
        self.v_max = self._of_both("v_max")
        self.a_max = self._of_both("a_max")
        self.jerk_max = self._of_both("jerk_max")
        self.tau_max = self._of_both("tau_max")
        self.tau_rate_max = min(model.tau_rate_max for model in self.arms)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self.arms == other.arms

    def __hash__(self) -> int:
        return hash(self.arms)

    def _check_pair(self) -> None:
        left, right = self.arms
        for name in _EQUAL_OF_A_PAIR:
            values = [getattr(arm, name) for arm in self.arms]
            if values[0] != values[1]:
                texts = [getattr(value, "name", value) for value in values]
                raise UsageError(
                    f"the arms '{left.name}' and '{right.name}' have different {name} "
                    f"({texts[0]} and {texts[1]}); a pair has one",
                )

    def _base_positions_m(self) -> tuple[tuple[float, float, float], ...]:
        left, right = self.arms
        x_m, y_m = left.base_xy_m
        x_right_m, y_right_m = right.base_xy_m
        return (x_m, y_m, left.base_height_m), (x_right_m, -y_right_m, right.base_height_m)

    def _of_both(self, name: str) -> Array:
        """Return a value of each joint of both arms (n,), read-only."""
        array = np.concatenate([np.array(getattr(arm, name), dtype=float) for arm in self.arms])
        array.setflags(write=False)
        return array

    @property
    def dof_per_arm(self) -> int:
        """Joints of one arm, where code needs equally many on both.

        Raises:
            UsageError: They have not.
        """
        left_n, right_n = self.dofs
        if left_n != right_n:
            raise UsageError(
                f"this needs two arms with equally many joints; '{self.name}' has {left_n} and "
                f"{right_n}",
                remedy="choose one arm for both sides: --set robot.right_arm=null",
            )
        return left_n

    @property
    def dof_most(self) -> int:
        """Joints of the arm that has more."""
        return max(self.dofs)

    @property
    def arm_of_joint(self) -> Indices:
        """Arm of each joint (n,), 0 left and 1 right."""
        return np.repeat(np.arange(len(SIDES)), self.dofs)

    def per_joint(self, of_arms: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return values of the two arms for each of their joints (n,)."""
        return np.repeat(np.asarray(of_arms), self.dofs)

    def by_arm(self, of_joints: Array) -> tuple[Array, Array]:
        """Return values of all joints (..., n) as those of the left and right arm."""
        left_n, _ = self.dofs
        return of_joints[..., :left_n], of_joints[..., left_n:]

    def hand_links(self, side: str) -> tuple[str, str, str]:
        """Return the names of palm and fingers."""
        first, second = self.hand.finger_links
        return f"{side}_{self.hand.palm_link}", f"{side}_{first}", f"{side}_{second}"

    def both(self, name: str) -> tuple[str, str]:
        """Return a name with the prefix of each side."""
        left, right = SIDES
        return f"{left}_{name}", f"{right}_{name}"

    @property
    def base_links(self) -> tuple[str, str]:
        """Links of the left and right base."""
        left, right = SIDES
        return f"{left}_{self.arms[0].base_link}", f"{right}_{self.arms[1].base_link}"

    def distinct_arms(self) -> list[tuple[tuple[str, ...], str, ArmModel]]:
        """Return the sides of each model, a prefix for names that it gives, and the model."""
        left, right = self.arms
        if left == right:
            return [(SIDES, "", left)]
        return [(SIDES[:1], "", left), (SIDES[1:], f"{SIDES[1]}_", right)]

    def joints_of(self, arm: int) -> slice:
        """Return the slice of q of arm 0 (left) or 1 (right)."""
        return self.groups[f"{SIDES[arm]}_arm"]


def arms_of(group: str) -> tuple[int, ...]:
    """Return the indices of a group's arms."""
    return tuple(SIDES.index(side) for side in GROUP_ARMS[group])


def group_of(arms: Collection[str]) -> str:
    """Return the group of exactly these arms."""
    return next(group for group, sides in GROUP_ARMS.items() if set(sides) == set(arms))


DUAL_PANDA = Robot(PANDA)


def slower_robot(robot: Robot, velocity_share: float, acceleration_share: float) -> Robot:
    """Return the same arms with a share of their velocity, and of their acceleration and jerk."""

    def slower(arm: ArmModel) -> ArmModel:
        return dataclasses.replace(
            arm,
            v_max=tuple(velocity_share * v for v in arm.v_max),
            a_max=tuple(acceleration_share * a for a in arm.a_max),
            jerk_max=tuple(acceleration_share * jerk for jerk in arm.jerk_max),
        )

    left, right = robot.arms
    return Robot(slower(left), None if right is left else slower(right))


def robot_from(config: RobotConfig) -> Robot:
    """Return the configured robot.

    Raises:
        UsageError: An arm is unknown, or the two cannot be a pair.
    """
    left = _with_packages(ARM_MODELS[config.arm], config.packages)
    if config.right_arm is None:
        return Robot(left)
    return Robot(left, _with_packages(ARM_MODELS[config.right_arm], config.packages))


def _with_packages(arm: ArmModel, folders: Mapping[str, str]) -> ArmModel:
    """Return an arm model that also knows these folders of packages."""
    if not folders:
        return arm
    return dataclasses.replace(arm, packages={**arm.packages, **folders})


_IDENTITY = np.eye(4)


def pose(rotation: Array, position: Array | tuple[float, float, float]) -> Array:
    """Return the pose (4, 4) of a rotation (3, 3) and a position (3,) [m]."""
    T = _IDENTITY.copy()  # a fifth of the time of `np.eye`
    T[:3, :3] = rotation
    T[:3, 3] = position
    return T


def inverse(T: Array) -> Array:
    """Return the inverse of a pose (4, 4)."""
    R = T[:3, :3]
    return pose(R.T, -R.T @ T[:3, 3])


def rot_x(angle_rad: float) -> Array:
    """Return the rotation (3, 3) about x."""
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rot_z(angle_rad: float) -> Array:
    """Return the rotation (3, 3) about z."""
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
