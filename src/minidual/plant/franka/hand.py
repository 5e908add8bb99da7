"""The controller of one emulated hand: moves and grasps to a width, with a force."""

from enum import StrEnum

from minidual.plant.franka.wire import HandStatus, Record
from minidual.plant.servo import HandServo

_SETTLED_M = 1e-5
_SETTLED_TICKS = 80
_HOMING_SPEED_M_PER_S = 0.05
_MOVE_FORCE_N = 70.0


class HandWork(StrEnum):
    """Activities of a hand."""

    IDLE = "idle"
    MOVING = "moving"
    GRASPING = "grasping"
    OPENING = "opening"
    """Homing measures the largest width, then goes back."""


class HandController:
    """One hand; `tick` once a millisecond, after the fingers were moved.

    Attributes:
        is_grasped: Whether the last grasp holds an object of the wanted width.
        max_width_m: As homing has found it.
        finished: How the last command ended, until `take_finished`.
    """

    def __init__(self, servo: HandServo, travel_m: float) -> None:
        self._servo = servo
        self._travel_m = travel_m
        self._work = HandWork.IDLE
        self._goal_m = 0.0
        self._epsilon_m = (0.0, 0.0)
        self._settled = 0
        self._last_m = 0.0
        self._back_m = 0.0
        self.max_width_m = 2.0 * travel_m
        self.is_grasped = False
        self.finished: HandStatus | None = None

    def move(self, request: Record) -> HandStatus | None:
        """Go to a width; return a refusal, or None."""
        width_m = float(request["width"])
        if not 0.0 <= width_m <= self.max_width_m + 1e-6 or not request["speed"] > 0.0:
            return HandStatus.FAIL
        self._begin(HandWork.MOVING, width_m, float(request["speed"]), _MOVE_FORCE_N)
        return None

    def grasp(self, request: Record) -> HandStatus | None:
        """Close to a width with a force; return a refusal, or None."""
        width_m = float(request["width"])
        speed = float(request["speed"])
        force_n = float(request["force"])
        if not 0.0 <= width_m <= self.max_width_m + 1e-6 or not (speed > 0.0 and force_n > 0.0):
            return HandStatus.FAIL
        self._epsilon_m = (float(request["epsilon_inner"]), float(request["epsilon_outer"]))
        self._begin(HandWork.GRASPING, width_m, speed, force_n)
        self._servo.move(0.0, speed, force_n)  # it goes on pressing where the object is wider
        return None

    def home(self) -> None:
        """Open fully to measure the largest width, and go back."""
        self._back_m = self._last_m
        self._begin(HandWork.OPENING, 2.0 * self._travel_m, _HOMING_SPEED_M_PER_S, _MOVE_FORCE_N)

    def stop(self) -> None:
        """Stay where the fingers are."""
        if self._work is not HandWork.IDLE:
            self.finished = HandStatus.ABORTED
        self._work = HandWork.IDLE
        self._servo.move(0.5 * self._last_m, _HOMING_SPEED_M_PER_S, _MOVE_FORCE_N)

    def take_finished(self) -> HandStatus | None:
        """Return how the last command ended, once."""
        finished = self.finished
        self.finished = None
        return finished

    def _begin(self, work: HandWork, width_m: float, speed: float, force_n: float) -> None:
        self._work = work
        self._goal_m = width_m
        self._settled = 0
        self.is_grasped = False
        self._servo.move(0.5 * width_m, speed, force_n)

    def tick(self, width_m: float, grip_n: float) -> None:
        """Take the measured width [m] and closing force [N]."""
        still = abs(width_m - self._last_m) < _SETTLED_M
        self._settled = self._settled + 1 if still else 0
        self._last_m = width_m
        if self.is_grasped and grip_n < 1.0:
            self.is_grasped = False  # the object is gone
        if self._work is HandWork.IDLE or self._settled < _SETTLED_TICKS:
            return
        if self._work is HandWork.OPENING:
            self.max_width_m = width_m
            self._begin(HandWork.MOVING, self._back_m, _HOMING_SPEED_M_PER_S, _MOVE_FORCE_N)
            return
        if self._work is HandWork.GRASPING:
            inner_m, outer_m = self._epsilon_m
            fits = self._goal_m - inner_m < width_m < self._goal_m + outer_m
            self.is_grasped = fits and grip_n > 1.0
            self.finished = HandStatus.SUCCESS if self.is_grasped else HandStatus.UNSUCCESSFUL
        else:
            self.finished = HandStatus.SUCCESS
        self._work = HandWork.IDLE
