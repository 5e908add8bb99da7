"""Two arms of one model on a table, the models (pair.yaml), and the algebra of poses (4, 4) and rotations (3, 3).

`q` is (n,) [rad], left arm first; grippers are separate, (2,). The arm model fixes n. `T_a_b` is the pose (4, 4) of b
in a: `T_world_rod = T_world_tcp @ T_tcp_rod`. Twists and wrenches are [linear; angular] (6,), world-aligned by default.
Quaternions are wxyz. The world's origin is on the table top between the bases; x points away from them, left is +y.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.config.scene import RobotConfig
from minidual.registry import Registry, rows_beside

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


class HandModel(NamedTuple):
    """A parallel gripper; names have no side prefix.

    Attributes:
        urdf, srdf: As in ArmModel; used from `palm_link` outwards.
        travel_m: Per finger; the hand opens by twice that.
        finger_armature_kg: Reflected rotor inertia.
        pad_height_m: z of the soft pad in the finger's frame.
        camera_position_m: In the palm's frame.
        camera_tilt_rad: From the palm's z axis, about its y.
    """

    name: str
    urdf: str
    srdf: str | None
    finger_joints: tuple[str, str]
    finger_links: tuple[str, str]
    palm_link: str
    tcp_link: str
    travel_m: float
    finger_armature_kg: float
    pad_height_m: float
    camera_position_m: tuple[float, float, float]
    camera_tilt_rad: float


@dataclass(frozen=True, kw_only=True)
class ArmModel:
    """One arm with its hand; names without side prefix, limits per joint.

    Attributes:
        urdf: Absolute path or package://DISTRIBUTION/path.
        srdf: Pairs of links that never collide.
        never_touch: More such pairs.
        joints: Names, base first.
        mount_rpy_rad: Palm in the flange's frame.
        base_xy_m: Left base; the right one mirrors y. Both face +x.
        v_max, a_max, jerk_max: [rad/s] and its derivatives.
        tau_max, tau_rate_max: [Nm], [Nm/s].
        armature: Reflected rotor inertia [kg m^2].
        damping: [Nm s/rad].
        friction: Dry friction [Nm].
        postures: Named (left, right) [rad].
    """

    name: str
    urdf: str
    srdf: str | None
    never_touch: tuple[tuple[str, str], ...] = ()
    joints: tuple[str, ...]
    base_link: str
    flange_link: str
    mount_rpy_rad: tuple[float, float, float]
    base_xy_m: tuple[float, float]
    home: tuple[float, ...]
    q_lower: tuple[float, ...]
    q_upper: tuple[float, ...]
    v_max: tuple[float, ...]
    a_max: tuple[float, ...]
    jerk_max: tuple[float, ...]
    tau_max: tuple[float, ...]
    tau_rate_max: float = 1000.0  # the Panda's (Franka Control Interface documentation)
    armature: float = 0.1  # MuJoCo Menagerie's value for the Panda, the xArm7 and the UR5e
    damping: float = 0.1
    friction: float = 0.0
    hand: HandModel
    postures: Mapping[str, tuple[tuple[float, ...], ...]] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Raise ValueError for limits of wrong length."""
        for name in ("home", "q_lower", "q_upper", "v_max", "a_max", "jerk_max", "tau_max"):
            if (n := len(getattr(self, name))) != len(self.joints):
                raise ValueError(f"arm '{self.name}': {name} has {n} of {len(self.joints)} entries")


def _of_both(values: tuple[float, ...]) -> Array:
    array = np.array(values * 2, dtype=float)
    array.setflags(write=False)
    return array


class Robot:
    """Two arms of one model; limits are (n,), units as in ArmModel. Equal if the models are.

    Attributes:
        hand: Both arms' gripper.
        base_positions_m: Left and right base.
        dof_per_arm, dof: Joints per arm, and altogether.
        joint_names, finger_joint_names: In storage order.
        groups: Slices of q.
    """

    sides = SIDES
    """In storage order."""

    def __init__(self, arm: ArmModel) -> None:
        self.arm = arm
        self.hand = arm.hand
        (x, y) = arm.base_xy_m
        n = len(arm.joints)
        self.base_positions_m = (x, y, 0.0), (x, -y, 0.0)
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
        self.home, self.q_lower, self.q_upper = map(_of_both, (arm.home, arm.q_lower, arm.q_upper))
        self.v_max, self.a_max, self.jerk_max = map(_of_both, (arm.v_max, arm.a_max, arm.jerk_max))
        self.tau_max = _of_both(arm.tau_max)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self.arm == other.arm

    def __hash__(self) -> int:
        return hash(self.arm)

    def hand_links(self, side: str) -> tuple[str, str, str]:
        """Return palm and fingers."""
        first, second = self.hand.finger_links
        return f"{side}_{self.hand.palm_link}", f"{side}_{first}", f"{side}_{second}"

    def both(self, name: str) -> tuple[str, str]:
        """Prefix a name with each side."""
        left, right = (f"{side}_{name}" for side in SIDES)
        return left, right

    def joints_of(self, arm: int) -> slice:
        """Return the slice of arm 0 (left) or 1."""
        n = self.dof_per_arm
        return slice(arm * n, (arm + 1) * n)


def arms_of(group: str) -> tuple[int, ...]:
    """Return the indices of a group's arms."""
    return tuple(map(SIDES.index, GROUP_ARMS[group]))


def group_of(arms: Collection[str]) -> str:
    """Return the group of these arms."""
    return next(group for group, of in GROUP_ARMS.items() if set(of) == set(arms))


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


_ROWS = _frozen(rows_beside(__file__))
HANDS = {name: HandModel(name, **row) for name, row in _ROWS["hands"].items()}
ARM_MODELS: Registry[ArmModel] = Registry("arm", group="minidual.arms")
for _name, _row in _ROWS["arms"].items():
    _row["hand"] = HANDS[_row["hand"]]
    ARM_MODELS.add(_name, ArmModel(name=_name, **_row))
PANDA = ARM_MODELS["panda"]
PANDA_HAND = HANDS["panda_hand"]
DUAL_PANDA = Robot(PANDA)


def robot_from(config: RobotConfig) -> Robot:
    """Return the configured robot; UsageError for unknown arms."""
    return Robot(ARM_MODELS[config.arm])


_IDENTITY = np.eye(4)


def pose(rotation: Array, position: Array | tuple[float, float, float]) -> Array:
    """Return a pose."""
    T = _IDENTITY.copy()  # a fifth of the time of `np.eye`
    T[:3, :3] = rotation
    T[:3, 3] = position
    return T


def inverse(T: Array) -> Array:
    """Invert a pose."""
    R = T[:3, :3]
    return pose(R.T, -R.T @ T[:3, 3])


def rot_x(angle_rad: float) -> Array:
    """Rotate about x."""
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rot_z(angle_rad: float) -> Array:
    """Rotate about z."""
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
