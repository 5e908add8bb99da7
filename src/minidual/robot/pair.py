"""Two arms of one model on a table, and the algebra of poses (4, 4) and rotations (3, 3).

`q` is (n,) [rad], left arm first; grippers are separate, (2,). The arm model (`models.py`) fixes n.
`T_a_b` is the pose (4, 4) of b in a: `T_world_rod = T_world_tcp @ T_tcp_rod`. Twists and wrenches
are [linear; angular] (6,), world-aligned by default. Quaternions are wxyz. The world's origin is on
the table top between the bases; x points away from them, left is +y.
"""

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from minidual.config.scene import RobotConfig
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


def _of_both(values: tuple[float, ...]) -> Array:
    """Return one arm's values for both arms, read-only."""
    array = np.array(values * 2, dtype=float)
    array.setflags(write=False)
    return array


class Robot:
    """Two arms of one model; limits are (n,), units as in ArmModel. Equal if the models are.

    Attributes:
        arm: Model of both arms.
        hand: Model of both grippers.
        base_positions_m: Of the left and right base.
        dof_per_arm: Joints of one arm.
        dof: Joints of both arms, n.
        joint_names: In storage order.
        finger_joint_names: In storage order.
        tcp_names: Links of the left and right tool centre point.
        groups: Slices of q, by planning group.
    """

    sides = SIDES
    """In storage order."""

    def __init__(self, arm: ArmModel) -> None:
        self.arm = arm
        self.hand = arm.hand
        x_m, y_m = arm.base_xy_m
        self.base_positions_m = ((x_m, y_m, 0.0), (x_m, -y_m, 0.0))
        n = len(arm.joints)
        self.dof_per_arm = n
        self.dof = 2 * n
        self.joint_names = tuple(f"{side}_{joint}" for side in SIDES for joint in arm.joints)
        self.finger_joint_names = tuple(
            f"{side}_{joint}" for side in SIDES for joint in arm.hand.finger_joints
        )
        self.tcp_names = self.both(arm.hand.tcp_link)
        self.groups = {
            "left_arm": slice(0, n),
            "right_arm": slice(n, 2 * n),
            "both_arms": slice(0, 2 * n),
        }
        self.home = _of_both(arm.home)
        self.q_lower = _of_both(arm.q_lower)
        self.q_upper = _of_both(arm.q_upper)
        self.v_max = _of_both(arm.v_max)
        self.a_max = _of_both(arm.a_max)
        self.jerk_max = _of_both(arm.jerk_max)
        self.tau_max = _of_both(arm.tau_max)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self.arm == other.arm

    def __hash__(self) -> int:
        return hash(self.arm)

    def hand_links(self, side: str) -> tuple[str, str, str]:
        """Return the names of palm and fingers."""
        first, second = self.hand.finger_links
        return f"{side}_{self.hand.palm_link}", f"{side}_{first}", f"{side}_{second}"

    def both(self, name: str) -> tuple[str, str]:
        """Return a name with the prefix of each side."""
        left, right = SIDES
        return f"{left}_{name}", f"{right}_{name}"

    def joints_of(self, arm: int) -> slice:
        """Return the slice of q of arm 0 (left) or 1 (right)."""
        n = self.dof_per_arm
        return slice(arm * n, (arm + 1) * n)


def arms_of(group: str) -> tuple[int, ...]:
    """Return the indices of a group's arms."""
    return tuple(SIDES.index(side) for side in GROUP_ARMS[group])


def group_of(arms: Collection[str]) -> str:
    """Return the group of exactly these arms."""
    return next(group for group, sides in GROUP_ARMS.items() if set(sides) == set(arms))


DUAL_PANDA = Robot(PANDA)


def robot_from(config: RobotConfig) -> Robot:
    """Return the configured robot.

    Raises:
        UsageError: The arm is unknown.
    """
    return Robot(ARM_MODELS[config.arm])


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
