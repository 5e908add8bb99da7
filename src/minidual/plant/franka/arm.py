"""The controller of one emulated arm: modes, motions, errors and the state that it sends; no network.

A motion runs as long as a command answers each state. What the controller refuses ends it by a
reflex: the arm brakes, holds, and says by the vendor's name why.
"""

from collections.abc import Sequence

import numpy as np

from minidual.plant.franka.cartesian_limits import CartesianMotion
from minidual.plant.franka.errors import ERRORS
from minidual.plant.franka.limits import (
    DT_S,
    FciLimits,
    JointMotion,
    MeasuredState,
    PacketWatch,
    Thresholds,
    TorqueCommands,
    measured_errors,
)
from minidual.plant.franka.wire import (
    IDLE_GENERATOR,
    JOINTS_N,
    Controller,
    Generator,
    MoveStatus,
    Record,
    RecoveryStatus,
    RobotMode,
    SetterStatus,
    StopStatus,
)
from minidual.robot.pair import Array

_START_PATIENCE_TICKS = 500
"""A motion whose first command does not come within this time ends as one that lost packets."""
_STILL_RAD_S = 1e-3
_BRAKE_SHARE = 0.9
_PINV_DAMPING = 1e-3
_CARTESIAN = (Generator.CARTESIAN_POSITION, Generator.CARTESIAN_VELOCITY)


class ArmController:
    """One arm's controller; `command`, then `sense`, once a millisecond.

    Args:
        limits: Of the arm.
        q: Measured posture (7,) at the start.
        walls: Range of x, y and z of the hand in the base's frame [m]; none if empty.

    Attributes:
        mode: What it does.
        errors: Names of the present errors.
        last_errors: Names of the errors of the last motion.
        controller, generator: Of the motion; None where there is none.
        q, v, a: Desired posture and motion (7,).
        tau: Desired torques (7,) of an external controller [Nm].
        packets: Commands in time.
        thresholds: Of contacts and collisions, nominal and while accelerating.
        finished: How the last motion ended, until `take_finished`.
    """

    def __init__(
        self,
        limits: FciLimits,
        q: Array,
        walls: Sequence[tuple[float, float]] = (),
    ) -> None:
        self.limits = limits
        self._walls = walls
        self.mode = RobotMode.IDLE
        self.errors: tuple[str, ...] = ()
        self.last_errors: tuple[str, ...] = ()
        self.controller: Controller | None = None
        self.generator: Generator | None = None
        self.q = q.copy()
        self.v = np.zeros(JOINTS_N)
        self.a = np.zeros(JOINTS_N)
        self.tau = np.zeros(JOINTS_N)
        self.packets = PacketWatch()
        self.nominal = Thresholds.default()
        self.accelerating = Thresholds.default()
        self.finished: MoveStatus | None = None
        self._joint: JointMotion | None = None
        self._pose: CartesianMotion | None = None
        self._torques = TorqueCommands(limits)
        self._waiting_ticks = 0
        self._commanded = False
        self._jacobian = np.zeros((6, JOINTS_N))
        self._T_base_hand = np.eye(4)
        self._gravity = np.zeros(JOINTS_N)
        self._measured_q = q.copy()
        self._measured_v = np.zeros(JOINTS_N)

    # Requests ----------------------------------------------------------------------------------

    def move(self, controller: int, generator: int) -> MoveStatus:
        """Start a motion, or say why not."""
        if self.mode is not RobotMode.IDLE or np.abs(self.v).max() > _STILL_RAD_S:
            return MoveStatus.NOT_POSSIBLE
        try:
            law = Controller(controller)
            source = Generator(generator)
        except ValueError:
            return MoveStatus.INVALID_ARGUMENT
        external = law is Controller.EXTERNAL
        if law is Controller.OTHER or (source is Generator.NONE and not external):
            return MoveStatus.INVALID_ARGUMENT
        self.controller, self.generator = law, source
        self.mode = RobotMode.MOVE
        self.last_errors = ()
        self.packets = PacketWatch()
        self._commanded = False
        self._waiting_ticks = 0
        self.v = np.zeros(JOINTS_N)
        self.a = np.zeros(JOINTS_N)
        self._torques = TorqueCommands(self.limits)
        after_poses = source in _CARTESIAN
        prefix = "cartesian_motion_generator" if after_poses else "joint_motion_generator"
        self._joint = JointMotion(self.limits, self.q, prefix)
        self._pose = None
        if after_poses:
            self._pose = CartesianMotion(self.limits, self._T_base_hand, self.q[2])
        return MoveStatus.MOTION_STARTED

    def stop(self) -> StopStatus:
        """End the motion: the arm brakes and holds."""
        if self.mode is RobotMode.MOVE:
            self._end(MoveStatus.PREEMPTED, RobotMode.IDLE)
        return StopStatus.SUCCESS

    def recover(self) -> RecoveryStatus:
        """Clear the errors, unless a person has to."""
        if self.mode is RobotMode.USER_STOPPED:
            return RecoveryStatus.EMERGENCY_ABORTED
        if self.mode is RobotMode.MOVE:
            return RecoveryStatus.NOT_POSSIBLE
        if "joint_position_limits_violation" in self.errors:
            return RecoveryStatus.MANUAL_RECOVERY_REQUIRED
        self.errors = ()
        self.mode = RobotMode.IDLE
        self.q = self._measured_q.copy()
        return RecoveryStatus.SUCCESS

    def set_thresholds(self, settings: Record) -> SetterStatus:
        """Set the collision thresholds."""
        accelerating = _thresholds(settings, "acceleration")
        nominal = _thresholds(settings, "nominal")
        if not (accelerating.valid() and nominal.valid()):
            return SetterStatus.INVALID_ARGUMENT
        if self.mode is RobotMode.MOVE:
            return SetterStatus.NOT_POSSIBLE
        self.accelerating, self.nominal = accelerating, nominal
        return SetterStatus.SUCCESS

    def user_stop(self, *, pressed: bool) -> None:
        """Press or release the stop button."""
        if pressed and self.mode is RobotMode.MOVE:
            self._end(MoveStatus.EMERGENCY_ABORTED, RobotMode.USER_STOPPED)
        elif pressed:
            self.mode = RobotMode.USER_STOPPED
        elif self.mode is RobotMode.USER_STOPPED:
            self.mode = RobotMode.IDLE

    def disconnected(self) -> None:
        """The client is gone: a motion ends as one that lost its packets."""
        if self.mode is RobotMode.MOVE:
            self._reflex(["communication_constraints_violation"])

    def take_finished(self) -> MoveStatus | None:
        """Return how the last motion ended, once."""
        finished = self.finished
        self.finished = None
        return finished

    @property
    def by_torque(self) -> bool:
        """Whether an external controller gives the torques."""
        return self.mode is RobotMode.MOVE and self.controller is Controller.EXTERNAL

    @property
    def generator_code(self) -> int:
        """What the state says of the generator."""
        if self.mode is not RobotMode.MOVE or self.generator is None:
            return IDLE_GENERATOR
        return int(self.generator) + 1

    # Every millisecond -------------------------------------------------------------------------

    def command(self, command: Record | None) -> None:
        """Take the command of this millisecond, None if none came in time."""
        if self.mode is not RobotMode.MOVE:
            self._brake()
            return
        if command is None:
            self._lose()
            return
        self._commanded = True
        self.packets.tick(came=True)
        errors = self._apply(command)
        if errors:
            self._reflex(errors)
            return
        if command["motion_generation_finished"] or command["torque_command_finished"]:
            self._finish()

    def _lose(self) -> None:
        """Bridge a command that did not come."""
        if not self._commanded:
            self._waiting_ticks += 1
            if self._waiting_ticks < _START_PATIENCE_TICKS:
                return
        errors = self.packets.tick(came=False)
        if errors:
            self._reflex(errors)
        elif self._joint is not None and not self.by_torque:
            self._joint.extrapolate()
            self._adopt(self._joint)

    def _apply(self, command: Record) -> list[str]:
        """Check and follow a command; return the errors."""
        if self.by_torque:
            tau = np.array(command["tau_J_d"], dtype=float)
            errors = self._torques.command(tau, self._gravity, self._measured_v)
            if not errors:
                self.tau = tau
                self.q = self._measured_q.copy()
            return errors
        joint = self._joint
        if joint is None:
            return []
        if self.generator is Generator.JOINT_POSITION:
            errors = joint.target(np.array(command["q_c"], dtype=float))
        elif self.generator is Generator.JOINT_VELOCITY:
            errors = joint.velocity(np.array(command["dq_c"], dtype=float))
        else:
            errors = self._apply_pose(command, joint)
        if not errors:
            self._adopt(joint)
        return errors

    def _apply_pose(self, command: Record, joint: JointMotion) -> list[str]:
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
        J = self._jacobian
        square = J @ J.T + _PINV_DAMPING**2 * np.eye(6)
        return joint.velocity(J.T @ np.linalg.solve(square, motion.twist))

    def _adopt(self, motion: JointMotion) -> None:
        self.q, self.v, self.a = motion.q.copy(), motion.v.copy(), motion.a.copy()

    def _finish(self) -> None:
        """End a motion that its client has finished: its target must be able to stand still."""
        if self._joint is not None and not self.by_torque:
            errors = self._joint.target(self._joint.q) if self._joint.v.any() else []
            if errors:
                self._reflex(errors)
                return
        self._end(MoveStatus.SUCCESS, RobotMode.IDLE)

    def _reflex(self, errors: list[str]) -> None:
        self.errors = tuple(errors)
        self._end(MoveStatus.REFLEX_ABORTED, RobotMode.REFLEX)

    def _end(self, status: MoveStatus, mode: RobotMode) -> None:
        if self.by_torque:
            self.q, self.v = self._measured_q.copy(), self._measured_v.copy()
        self.last_errors = self.errors
        self.finished = status
        self.mode = mode
        self.controller = None
        self.generator = None
        self.tau = np.zeros(JOINTS_N)

    def _brake(self) -> None:
        """Bring the desired motion to rest."""
        if not self.v.any():
            self.a = np.zeros(JOINTS_N)
            return
        change = _BRAKE_SHARE * self.limits.a_max * DT_S
        v = self.v - np.clip(self.v, -change, change)
        self.a = (v - self.v) / DT_S
        self.v = v
        self.q = np.clip(self.q + v * DT_S, self.limits.q_lower, self.limits.q_upper)

    def sense(
        self,
        state: MeasuredState,
        T_base_hand: Array,
        jacobian: Array,
        gravity: Array,
    ) -> None:
        """Take what the arm measures after a millisecond.

        Args:
            state: Posture, motion, torques.
            T_base_hand: Pose (4, 4) of the hand in the base.
            jacobian: Of the hand (6, 7), in the base's axes.
            gravity: Torques (7,) that hold the posture [Nm].
        """
        self._measured_q, self._measured_v = state.q, state.v
        self._T_base_hand, self._jacobian, self._gravity = T_base_hand, jacobian, gravity
        if self.mode in (RobotMode.REFLEX, RobotMode.USER_STOPPED):
            return
        errors = measured_errors(state, self.limits, self._walls)
        if errors:
            self._fault(errors)

    def feel(self, tau_ext: Array, wrench: Array) -> None:
        """Compare external torques (7,) and the hand's external wrench (6,) with the thresholds."""
        if self.mode is not RobotMode.MOVE:
            return
        moving = bool(np.abs(self.a).max() > 0.1)
        thresholds = self.accelerating if moving else self.nominal
        errors = thresholds.collisions(tau_ext, wrench)
        if errors:
            self._fault(errors)

    def _fault(self, errors: list[str]) -> None:
        if self.mode is RobotMode.MOVE:
            self._reflex(errors)
        else:
            self.errors = tuple(errors)
            self.mode = RobotMode.REFLEX

    def flags(self, names: tuple[str, ...]) -> Array:
        """Return flags (41,) of errors by name."""
        return np.array([error.name in names for error in ERRORS])


def _thresholds(settings: Record, kind: str) -> Thresholds:
    return Thresholds(
        *(
            np.array(settings[f"{bound}_{quantity}_{kind}"], dtype=float)
            for quantity, bound in (
                ("torque", "lower"),
                ("torque", "upper"),
                ("force", "lower"),
                ("force", "upper"),
            )
        ),
    )
