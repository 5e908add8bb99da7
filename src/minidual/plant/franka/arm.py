"""The controller of one emulated arm: modes, motions, errors and the state that it sends; no network.

A motion runs as long as a command answers each state. What the controller refuses ends it by a
reflex: the arm brakes, holds, and says by the vendor's name why.
"""

from collections.abc import Sequence

import numpy as np

from minidual.plant.franka.desired_motion import ArmSample, DesiredMotion
from minidual.plant.franka.errors import ERRORS
from minidual.plant.franka.limits import (
    FciLimits,
    MeasuredState,
    PacketWatch,
    Thresholds,
    measured_errors,
)
from minidual.plant.franka.wire import (
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
        desired: The desired motion.
        packets: Commands in time.
        accelerating, nominal: Thresholds of contacts and collisions.
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
        self.desired = DesiredMotion(limits, q)
        self.packets = PacketWatch()
        self.nominal = Thresholds.default()
        self.accelerating = Thresholds.default()
        self.finished: MoveStatus | None = None
        self._waiting_ticks = 0
        self._commanded = False
        self._sample = ArmSample(
            q=q.copy(),
            v=np.zeros(JOINTS_N),
            T_base_hand=np.eye(4),
            jacobian=np.zeros((6, JOINTS_N)),
            gravity=np.zeros(JOINTS_N),
        )

    @property
    def is_braking(self) -> bool:
        """Whether the arm comes to rest after a motion that has ended."""
        return self.mode is not RobotMode.MOVE and not self.desired.is_still

    # Requests ----------------------------------------------------------------------------------

    def move(self, controller: int, generator: int) -> MoveStatus:
        """Start a motion, or say why not."""
        if self.mode is not RobotMode.IDLE or self.is_braking:
            return MoveStatus.NOT_POSSIBLE
        try:
            law = Controller(controller)
            source = Generator(generator)
        except ValueError:
            return MoveStatus.INVALID_ARGUMENT
        external = law is Controller.EXTERNAL
        if law is Controller.OTHER or (source is Generator.NONE and not external):
            return MoveStatus.INVALID_ARGUMENT
        self.desired.start(law, source, self._sample.T_base_hand)
        self.mode = RobotMode.MOVE
        self.last_errors = ()
        self.packets = PacketWatch()
        self._commanded = False
        self._waiting_ticks = 0
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
        self.desired.q = self._sample.q.copy()
        return RecoveryStatus.SUCCESS

    def set_thresholds(self, settings: Record) -> SetterStatus:
        """Set the collision thresholds."""
        accelerating = _thresholds(settings, "acceleration")
        nominal = _thresholds(settings, "nominal")
        if not (accelerating.valid() and nominal.valid()):
            return SetterStatus.INVALID_ARGUMENT
        if self.mode is RobotMode.MOVE:
            return SetterStatus.NOT_POSSIBLE
        self.accelerating = accelerating
        self.nominal = nominal
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

    # Every millisecond -------------------------------------------------------------------------

    def command(self, command: Record | None) -> None:
        """Take the command of this millisecond, None if none came in time."""
        if self.mode is not RobotMode.MOVE:
            self.desired.brake()
            return
        if command is None:
            self._lose()
            return
        self._commanded = True
        self.packets.tick(came=True)
        errors = self.desired.follow(command, self._sample)
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
        else:
            self.desired.bridge()

    def _finish(self) -> None:
        """End a motion that its client has finished: its target must be able to stand still."""
        errors = self.desired.stop_errors()
        if errors:
            self._reflex(errors)
            return
        self._end(MoveStatus.SUCCESS, RobotMode.IDLE)

    def _reflex(self, errors: list[str]) -> None:
        self.errors = tuple(errors)
        self._end(MoveStatus.REFLEX_ABORTED, RobotMode.REFLEX)

    def _end(self, status: MoveStatus, mode: RobotMode) -> None:
        self.desired.end(self._sample)
        self.last_errors = self.errors
        self.finished = status
        self.mode = mode

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
        self._sample = ArmSample(state.q, state.v, T_base_hand, jacobian, gravity)
        if self.mode in (RobotMode.REFLEX, RobotMode.USER_STOPPED):
            return
        errors = measured_errors(state, self.limits, self._walls)
        if errors:
            self._fault(errors)

    def feel(self, tau_ext: Array, wrench: Array) -> None:
        """Compare external torques (7,) and the hand's external wrench (6,) with the thresholds."""
        if self.mode is not RobotMode.MOVE:
            return
        moving = bool(np.abs(self.desired.a).max() > 0.1)
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
