"""Two arms of one model on one table: every name, limit and posture that depends on the arm.

Storage order is fixed: `q` is (n,), the left arm's joints, then the right arm's, in radians; the two grippers are kept
apart as (2,). Nothing outside `minidual.robot` may assume how many joints an arm has.

Frames. `T_world_tcp` is the pose of the tool centre point in the world, so inner names cancel:
`T_world_rod = T_world_tcp @ T_tcp_rod`. A pose is a (4, 4) homogeneous matrix. Twists and wrenches are
[linear; angular] (6,), in world-aligned axes unless a name says otherwise. Quaternions are wxyz. The world's origin lies on
the table top (z = 0) between the bases; x points away from the bases, left is +y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

SIDES: tuple[str, str] = ("left", "right")
"""Prefixes of the arms, in storage order."""


@dataclass(frozen=True)
class HandModel:
    """A parallel gripper.

    Attributes:
        name: For messages.
        urdf, srdf: Descriptions that hold it, as in ArmModel; everything from `palm_link` outwards is taken.
        finger_joints: Names of the two finger joints, without the arm's prefix.
        finger_links: Names of the two finger links.
        palm_link: Name of the link that carries them.
        tcp_link: Name of the tool centre point's link.
        travel_m: Travel of one finger from the middle plane; the hand opens to twice that.
        force_max_n: Continuous force of one finger.
        finger_armature_kg: Reflected rotor inertia of each finger.
        pad_height_m: z of the collision box in the finger's frame that is the soft pad.
        camera_position_m: Wrist camera in the palm's frame.
        camera_tilt_rad: Angle between the camera's view and the palm's z axis, about the palm's y.
    """

    name: str
    urdf: str
    srdf: str | None
    finger_joints: tuple[str, str]
    finger_links: tuple[str, str]
    palm_link: str
    tcp_link: str
    travel_m: float
    force_max_n: float
    finger_armature_kg: float
    pad_height_m: float
    camera_position_m: tuple[float, float, float]
    camera_tilt_rad: float


@dataclass(frozen=True)
class Posture:
    """A named posture of both arms.

    Attributes:
        left, right: Joint positions of each arm [rad].
        description: What it is for.
    """

    left: tuple[float, ...]
    right: tuple[float, ...]
    description: str


@dataclass(frozen=True)
class ArmModel:
    """One arm with its hand. Limits are tuples with one entry a joint; each row of the table says where they come from.

    Attributes:
        name: Row of the table of arms.
        urdf: Description: an absolute path, or package://DISTRIBUTION/path within an installed distribution. Meshes are
            package:// addresses or relative to the file.
        srdf: Pairs of links that never collide, found in the same way; None for none.
        never_touch: More such pairs, without the side's prefix; planning leaves them out too.
        joints: Joint names, base first, without the side's prefix.
        base_link: Name of the link that stands on the table.
        flange_link: Name of the link that carries the hand; only the links from base to flange are taken.
        mount_rpy_rad: Orientation of the hand's palm in the flange's frame, roll, pitch, yaw.
        base_xy_m: Where the left base stands; the right one mirrors it in y. Both face +x.
        home: Home posture [rad].
        q_lower, q_upper: Position limits [rad].
        v_max: Velocity limits [rad/s].
        a_max: Acceleration limits [rad/s^2].
        jerk_max: Jerk limits [rad/s^3].
        tau_max: Torque limits [Nm].
        tau_rate_max: Torque rate limit of every joint [Nm/s].
        armature: Reflected rotor inertia of every joint [kg m^2].
        damping: Viscous friction of every joint [Nm s/rad].
        friction: Dry friction of every joint [Nm].
        hand: The gripper.
        postures: More postures by name, as (name, posture) pairs.
    """

    name: str
    urdf: str
    srdf: str | None
    never_touch: tuple[tuple[str, str], ...]
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
    tau_rate_max: float
    armature: float
    damping: float
    friction: float
    hand: HandModel
    postures: tuple[tuple[str, Posture], ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError where a row has not one entry a joint."""
        for name in ("home", "q_lower", "q_upper", "v_max", "a_max", "jerk_max", "tau_max"):
            if len(getattr(self, name)) != len(self.joints):
                raise ValueError(
                    f"arm '{self.name}': {name} has {len(getattr(self, name))} of {len(self.joints)} entries"
                )


@dataclass(frozen=True)
class Robot:
    """Two arms of one model.

    Attributes:
        arm: The model of both.
    """

    arm: ArmModel

    def _both(self, values: tuple[float, ...]) -> Array:
        array = np.array(values + values, dtype=float)
        array.setflags(write=False)
        return array

    @property
    def hand(self) -> HandModel:
        """Return the gripper of both arms."""
        return self.arm.hand

    @property
    def base_positions_m(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return where each base stands in the world, left then right; both face +x."""
        x, y = self.arm.base_xy_m
        return (x, y, 0.0), (x, -y, 0.0)

    @property
    def sides(self) -> tuple[str, str]:
        """Return the prefixes of the arms, in storage order."""
        return SIDES

    @property
    def dof_per_arm(self) -> int:
        """Return the number of joints of one arm."""
        return len(self.arm.joints)

    @property
    def dof(self) -> int:
        """Return the number of joints of both arms."""
        return 2 * self.dof_per_arm

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in storage order."""
        return tuple(f"{side}_{joint}" for side in SIDES for joint in self.arm.joints)

    @cached_property
    def finger_joint_names(self) -> tuple[str, ...]:
        """Names of the four finger joints, in storage order."""
        return tuple(f"{side}_{joint}" for side in SIDES for joint in self.hand.finger_joints)

    @cached_property
    def tcp_names(self) -> tuple[str, str]:
        """Names of the tool centre points."""
        return self.both(self.hand.tcp_link)

    @cached_property
    def palm_names(self) -> tuple[str, str]:
        """Names of the links that carry the fingers."""
        return self.both(self.hand.palm_link)

    def hand_links(self, side: str) -> tuple[str, str, str]:
        """Return the links of one hand that can touch something: palm and both fingers."""
        first, second = self.hand.finger_links
        return f"{side}_{self.hand.palm_link}", f"{side}_{first}", f"{side}_{second}"

    def both(self, name: str) -> tuple[str, str]:
        """Return an arm's own name with the prefix of each side."""
        left, right = (f"{side}_{name}" for side in SIDES)
        return left, right

    @cached_property
    def groups(self) -> dict[str, slice]:
        """Planning and control groups: the joints each one owns, as a slice of q."""
        n = self.dof_per_arm
        return {"left_arm": slice(0, n), "right_arm": slice(n, 2 * n), "both_arms": slice(0, 2 * n)}

    def joints_of(self, arm: int) -> slice:
        """Return the slice of q of an arm, 0 left or 1 right."""
        n = self.dof_per_arm
        return slice(arm * n, (arm + 1) * n)

    @cached_property
    def home(self) -> Array:
        """Home posture (n,) [rad]."""
        return self._both(self.arm.home)

    @cached_property
    def q_lower(self) -> Array:
        """Lower position limits (n,) [rad]."""
        return self._both(self.arm.q_lower)

    @cached_property
    def q_upper(self) -> Array:
        """Upper position limits (n,) [rad]."""
        return self._both(self.arm.q_upper)

    @cached_property
    def v_max(self) -> Array:
        """Velocity limits (n,) [rad/s]."""
        return self._both(self.arm.v_max)

    @cached_property
    def a_max(self) -> Array:
        """Acceleration limits (n,) [rad/s^2]."""
        return self._both(self.arm.a_max)

    @cached_property
    def jerk_max(self) -> Array:
        """Jerk limits (n,) [rad/s^3]."""
        return self._both(self.arm.jerk_max)

    @cached_property
    def tau_max(self) -> Array:
        """Torque limits (n,) [Nm]."""
        return self._both(self.arm.tau_max)
