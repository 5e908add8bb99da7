"""Joint control without arbiter and supervisor, for measurements and the Gymnasium environment."""

from minidual.control.gripper import Grippers
from minidual.control.joint_control import ComputedTorque
from minidual.control.reference import ReferenceFilter
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array


class JointLoop[P: Plant]:
    """Drives a world from joint and gripper targets."""

    def __init__(self, world: P, kinematics: Kinematics) -> None:
        self.world = world
        self.controller = ComputedTorque(kinematics)
        self.reference = ReferenceFilter(world.dt, kinematics.robot)
        self.grippers = Grippers(world)
        self.reset()

    def reset(self) -> None:
        """Start at the measured posture, hands open."""
        self.reference.reset(self.world.q)
        self.grippers.reset()

    def step(self, q_target: Array, gripper: Array) -> None:
        """Run one control and physics step."""
        self.follow(*self.reference.step(q_target), gripper)

    def follow(self, q_ref: Array, v_ref: Array, a_ref: Array, gripper: Array) -> None:
        """Run one step on a smooth reference."""
        world = self.world
        tau = self.controller.torque(world.q, world.v, q_ref, v_ref, a_ref)
        world.command(tau, self.grippers.step(gripper))
        world.step()
