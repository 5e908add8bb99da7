"""Two arms of one model on a table.

`q` is (n,) [rad], left arm first; grippers are separate, (2,). The arm model fixes n. `T_a_b` is the pose (4, 4) of b
in a: `T_world_rod = T_world_tcp @ T_tcp_rod`. Twists and wrenches are [linear; angular] (6,), world-aligned by default.
Quaternions are wxyz. The world's origin is on the table top between the bases; x points away from them, left is +y.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

SIDES: tuple[str, str] = ("left", "right")
"""In storage order."""


@dataclass(frozen=True)
class HandModel:
    """A parallel gripper; names have no side prefix.

    Attributes:
        urdf, srdf: As in ArmModel; used from `palm_link` outwards.
        travel_m: Per finger; the hand opens by twice that.
        force_max_n: Continuous, per finger.
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
    force_max_n: float
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
            if len(getattr(self, name)) != len(self.joints):
                raise ValueError(
                    f"arm '{self.name}': {name} has {len(getattr(self, name))} of {len(self.joints)} entries"
                )


def _of_both(name: str) -> cached_property[Array]:
    """Return a property (n,): the arm's values twice."""

    def values(robot: Robot) -> Array:
        array = np.array(getattr(robot.arm, name) * 2, dtype=float)
        array.setflags(write=False)
        return array

    return cached_property(values)


@dataclass(frozen=True)
class Robot:
    """Two arms of one model; limits are (n,), units as in ArmModel."""

    arm: ArmModel

    @property
    def hand(self) -> HandModel:
        """Both arms' gripper."""
        return self.arm.hand

    @property
    def base_positions_m(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Left and right base."""
        x, y = self.arm.base_xy_m
        return (x, y, 0.0), (x, -y, 0.0)

    sides = SIDES
    """In storage order."""

    @property
    def dof_per_arm(self) -> int:
        """Joints per arm."""
        return len(self.arm.joints)

    @property
    def dof(self) -> int:
        """Joints altogether."""
        return 2 * self.dof_per_arm

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """In storage order."""
        return tuple(f"{side}_{joint}" for side in SIDES for joint in self.arm.joints)

    @cached_property
    def finger_joint_names(self) -> tuple[str, ...]:
        """In storage order."""
        return tuple(f"{side}_{joint}" for side in SIDES for joint in self.hand.finger_joints)

    @cached_property
    def tcp_names(self) -> tuple[str, str]:
        """Tool centre points."""
        return self.both(self.hand.tcp_link)

    def hand_links(self, side: str) -> tuple[str, str, str]:
        """Return palm and fingers."""
        first, second = self.hand.finger_links
        return f"{side}_{self.hand.palm_link}", f"{side}_{first}", f"{side}_{second}"

    def both(self, name: str) -> tuple[str, str]:
        """Prefix a name with each side."""
        left, right = (f"{side}_{name}" for side in SIDES)
        return left, right

    @cached_property
    def groups(self) -> dict[str, slice]:
        """Slices of q."""
        n = self.dof_per_arm
        return {"left_arm": slice(0, n), "right_arm": slice(n, 2 * n), "both_arms": slice(0, 2 * n)}

    def joints_of(self, arm: int) -> slice:
        """Return the slice of arm 0 (left) or 1."""
        n = self.dof_per_arm
        return slice(arm * n, (arm + 1) * n)

    home = _of_both("home")
    q_lower = _of_both("q_lower")
    q_upper = _of_both("q_upper")
    v_max = _of_both("v_max")
    a_max = _of_both("a_max")
    jerk_max = _of_both("jerk_max")
    tau_max = _of_both("tau_max")
