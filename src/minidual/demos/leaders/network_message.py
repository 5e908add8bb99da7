"""Messages between a program that leads and the network leader: JSON, one a datagram or frame."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from minidual.config.base import StrictModel
from minidual.demos.leader import LeaderSample
from minidual.demos.station import Button
from minidual.robot.pair import Array, Robot, pose

VERSION = 1
_Number = Annotated[float, Field(ge=-1e6, le=1e6)]
_Opening = Annotated[float, Field(ge=0.0, le=1.0)]


class HandPose(StrictModel):
    """Pose of a hand's centre point in the world."""

    position_m: tuple[_Number, _Number, _Number]
    quaternion_wxyz: tuple[_Number, _Number, _Number, _Number]

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if np.linalg.norm(self.quaternion_wxyz) < 0.5:
            raise ValueError("quaternion_wxyz is no rotation: its norm is below 0.5")
        return self

    def matrix(self) -> Array:
        """Return T_world_tcp (4, 4)."""
        w, x, y, z = self.quaternion_wxyz
        return pose(Rotation.from_quat((x, y, z, w)).as_matrix(), self.position_m)


class TargetMessage(StrictModel):
    """A message of a program. Without joints and hands it asks for the state only.

    Attributes:
        version: Of the message.
        sender: Name of a run of the program: a new one begins with a new sequence.
        sequence: Grows with each message; older ones are dropped.
        stamp_s: Time by the program's own clock.
        q: Joints [rad], left arm first.
        names: Names of the joints in `q`, if it has another order.
        hands: Left and right hand.
        openings: 0 closed to 1 open.
        clutch: Whether the leader moves without the arms.
        pressed: Buttons.
    """

    version: Literal[1]
    sender: str = Field(default="", max_length=64)
    sequence: int = Field(ge=0, lt=2**63)
    stamp_s: float = Field(ge=-1e12, le=1e12)
    q: tuple[_Number, ...] | None = Field(default=None, max_length=64)
    names: tuple[str, ...] | None = Field(default=None, max_length=64)
    hands: tuple[HandPose, HandPose] | None = None
    openings: tuple[_Opening, _Opening] = (1.0, 1.0)
    clutch: bool = False
    pressed: tuple[Button, ...] = Field(default=(), max_length=8)

    @model_validator(mode="after")
    def _one_target(self) -> Self:
        if self.q is not None and self.hands is not None:
            raise ValueError("q and hands exclude each other")
        return self

    def sample(self, robot: Robot) -> LeaderSample | None:
        """Return the reading; None without a target.

        Raises:
            ValueError: Other joints than the robot's.
        """
        openings = np.array(self.openings)
        if self.q is not None:
            q = joints_in_order(robot, self.q, self.names)
            return LeaderSample(openings, q=q, pressed=self.pressed, clutch=self.clutch)
        if self.hands is not None:
            Ts = [hand.matrix() for hand in self.hands]
            return LeaderSample(openings, Ts_world_tcp=Ts, pressed=self.pressed, clutch=self.clutch)
        return None


def joints_in_order(
    robot: Robot,
    values: tuple[float, ...],
    names: tuple[str, ...] | None,
) -> Array:
    """Return values of joints in the robot's order (n,).

    Raises:
        ValueError: Other joints than the robot's.
    """
    if names is None:
        names = robot.joint_names
    if len(values) != robot.dof or sorted(names) != sorted(robot.joint_names):
        raise ValueError(f"q needs the {robot.dof} joints {', '.join(robot.joint_names)}")
    by_name = dict(zip(names, values, strict=True))
    return np.array([by_name[name] for name in robot.joint_names])


class StateMessage(StrictModel):
    """The answer to a message: where the arms are.

    Attributes:
        version: Of the message.
        sequence: Of the message that is answered; its sender measures the round trip by it.
        stamp_s: Simulated time.
        names: Of the joints.
        q: Measured joints [rad].
        openings: 0 closed to 1 open.
        external_nm: Torques that nothing but a contact explains.
    """

    version: Literal[1] = VERSION
    sequence: int
    stamp_s: float
    names: tuple[str, ...]
    q: tuple[float, ...]
    openings: tuple[float, ...]
    external_nm: tuple[float, ...]
