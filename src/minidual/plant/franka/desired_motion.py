"""The desired motion of one emulated arm: it follows a motion's commands, or brakes."""

from dataclasses import dataclass

import numpy as np

from minidual.plant.franka.cartesian_limits import CartesianMotion
from minidual.plant.franka.limits import DT_S, FciLimits, JointMotion, TorqueCommands
from minidual.plant.franka.wire import (
    IDLE_GENERATOR,
    JOINTS_N,
    Controller,
    Generator,
    Record,
)
from minidual.robot.pair import Array

_STILL_RAD_S = 1e-3
_BRAKE_SHARE = 0.9
_PINV_DAMPING = 1e-3
_CARTESIAN = (Generator.CARTESIAN_POSITION, Generator.CARTESIAN_VELOCITY)


@dataclass(frozen=True)
class ArmSample:
    """The last measurement of the arm, against which commands are checked.

    Attributes:
        q, v: (7,) [rad], [rad/s].
        T_base_hand: Pose (4, 4) of the hand in the base.
        jacobian: Of the hand (6, 7), in the base's axes.
        gravity: Torques (7,) that hold the posture [Nm].
    """

    q: Array
    v: Array
    T_base_hand: Array
    jacobian: Array
    gravity: Array


class DesiredMotion:
    """Desired posture and torques of one arm; one command, gap or brake a millisecond.

    Args:
        limits: Of the arm.
        q: Posture (7,) at the start.

    Attributes:
        controller, generator: Of the motion that runs; None where none does.
        q, v, a: Desired posture and motion (7,).
        tau: Desired torques (7,) of an external controller [Nm].
    """

    def __init__(self, limits: FciLimits, q: Array) -> None:
        self._limits = limits
        self.controller: Controller | None = None
        self.generator: Generator | None = None
        self.q = q.copy()
        self.v = np.zeros(JOINTS_N)
        self.a = np.zeros(JOINTS_N)
        self.tau = np.zeros(JOINTS_N)
        self._joint: JointMotion | None = None
        self._pose: CartesianMotion | None = None
        self._torques = TorqueCommands(limits)

    @property
    def is_still(self) -> bool:
        """Whether no joint moves."""
        return bool(np.abs(self.v).max() <= _STILL_RAD_S)

    @property
    def by_torque(self) -> bool:
        """Whether an external controller gives the torques."""
        return self.controller is Controller.EXTERNAL

    @property
    def generator_code(self) -> int:
        """Code of the generator in the state."""
        return IDLE_GENERATOR if self.generator is None else int(self.generator) + 1

    def start(self, controller: Controller, generator: Generator, T_base_hand: Array) -> None:
        """Start a motion at rest, from the desired posture and a pose (4, 4) of the hand."""
        self.controller = controller
        self.generator = generator
        self.v = np.zeros(JOINTS_N)
        self.a = np.zeros(JOINTS_N)
        self._torques = TorqueCommands(self._limits)
        after_poses = generator in _CARTESIAN
        prefix = "cartesian_motion_generator" if after_poses else "joint_motion_generator"
        self._joint = JointMotion(self._limits, self.q, prefix)
        self._pose = None
        if after_poses:
            self._pose = CartesianMotion(self._limits, T_base_hand, self.q[2])

    def follow(self, command: Record, sample: ArmSample) -> list[str]:
        """Check and follow a command; return the errors."""
        if self.by_torque:
            return self._follow_torque(np.array(command["tau_J_d"], dtype=float), sample)
        joint = self._joint
        if joint is None:
            return []
        if self.generator is Generator.JOINT_POSITION:
            errors = joint.target(np.array(command["q_c"], dtype=float))
        elif self.generator is Generator.JOINT_VELOCITY:
            errors = joint.velocity(np.array(command["dq_c"], dtype=float))
        else:
            errors = self._follow_pose(command, joint, sample.jacobian)
        if not errors:
            self._adopt(joint)
        return errors

    def _follow_torque(self, tau: Array, sample: ArmSample) -> list[str]:
        errors = self._torques.command(tau, sample.gravity, sample.v)
        if not errors:
            self.tau = tau
            self.q = sample.q.copy()
        return errors

    def _follow_pose(self, command: Record, joint: JointMotion, jacobian: Array) -> list[str]:
        """Check a pose or a twist, and the joint velocities that follow from it."""
        motion = self._pose
        if motion is None:
            return []
        if command["valid_elbow"]:
            position, sign = (float(value) for value in command["elbow_c"])
            errors = motion.elbow(position, sign, float(np.sign(self.q[3])))
            if errors:
                return errors
        if self.generator is Generator.CARTESIAN_POSITION:
            pose = np.array(command["O_T_EE_c"], dtype=float).reshape(4, 4).T
            errors = motion.target(pose)
        else:
            errors = motion.velocity(np.array(command["O_dP_EE_c"], dtype=float))
        if errors:
            return errors
        square = jacobian @ jacobian.T + _PINV_DAMPING**2 * np.eye(6)
        return joint.velocity(jacobian.T @ np.linalg.solve(square, motion.twist))

    def bridge(self) -> None:
        """Move on without a command."""
        if self._joint is not None and not self.by_torque:
            self._joint.extrapolate()
            self._adopt(self._joint)

    def stop_errors(self) -> list[str]:
        """Return the errors of standing still from this millisecond on."""
        if self._joint is None or self.by_torque or not self._joint.v.any():
            return []
        return self._joint.target(self._joint.q)

    def end(self, sample: ArmSample) -> None:
        """End the motion; `brake` brings the rest of its velocity to zero."""
        if self.by_torque:
            self.q = sample.q.copy()
            self.v = sample.v.copy()
        self.controller = None
        self.generator = None
        self.tau = np.zeros(JOINTS_N)

    def brake(self) -> None:
        """Bring the desired motion to rest."""
        if not self.v.any():
            self.a = np.zeros(JOINTS_N)
            return
        limits = self._limits
        change = _BRAKE_SHARE * limits.a_max * DT_S
        v = self.v - np.clip(self.v, -change, change)
        self.a = (v - self.v) / DT_S
        self.v = v
        self.q = np.clip(self.q + v * DT_S, limits.q_lower, limits.q_upper)

    def _adopt(self, motion: JointMotion) -> None:
        self.q = motion.q.copy()
        self.v = motion.v.copy()
        self.a = motion.a.copy()
