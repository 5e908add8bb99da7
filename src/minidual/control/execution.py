"""Running timed commands, each with its own clock.

Braking, slowing down and the speed override change the clock's rate r, so two hands that carry something keep their distance:

    q(s),  s' = r,  v = q' r,  a = q'' r^2 + q' dr/dt

dr/dt is ramped, so torques do not jump.
"""

from collections.abc import Callable

import numpy as np

from minidual.control.command_checks import OBJECT_MAX, own_columns
from minidual.control.commands import (
    Command,
    ObjectCommand,
    Reason,
    TimedCommand,
    TrajectoryCommand,
)
from minidual.control.gripper import CLOSE_BELOW, OPEN_ABOVE
from minidual.control.impedance import SQUEEZE_MAX_N, ObjectState
from minidual.control.kernels import adopt, within
from minidual.errors import UsageError
from minidual.robot.pair import SIDES, Array, Robot

BRAKE_SHARE = 0.8
"""Share of the joints' acceleration limits."""
_BRAKE_SLOPE_MIN = 2.0
_BRAKE_SLOPE_MAX = 20.0
_OBJECT_BRAKE_SLOPE = 4.0
_BRAKE_RAMP_S = 0.03
_PACE_SLOPE = 4.0
_PACE_S = 0.1
"""Largest change of the rate [1/s], and its time constant."""
_OVERRIDE_SLEW = 0.3
"""Change of the override [1/s]: plans leave a tenth of a_max."""
_TURN_PER_S = 8.0
_SHIFT_M_PER_S = 2.0
"""Largest rates of a pose's entries, of rotation and position; twice what is accepted."""
_STOPPED_RATE = 1e-4
START_RAD_PER_S = 0.5
_LOOK_AHEAD_ROWS = 500
_ROWS = 256
"""Sampled at once: all of a long trajectory would hold up the tick in which it starts."""


class _Execution[C: TimedCommand]:
    def __init__(self, command: C, dt_s: float) -> None:
        self.command = command
        self.arms = command.arms
        duration_s = command.motion.duration_s
        self._steps = max(1, int(np.ceil(duration_s / dt_s - 1e-6)))
        self._k = -1
        self._t_s = 0.0
        self.rate = 1.0
        self._slope = 0.0
        self._slope_max = 0.0
        self._dt = dt_s
        self._end_s = duration_s
        self.pace = 1.0
        """Wanted rate, above 0 to 1; reached smoothly."""
        self._paced = self.finished = False
        """finished: whether it ended or stopped."""
        self._speed = self._speed_now = 1.0
        self.why: Reason | None = None
        """Why a controller has stopped it, until the arbiter has told."""

    @property
    def braking(self) -> bool:
        """Whether it brakes or has braked."""
        return self._slope_max > 0.0

    def brake(self) -> None:
        """Come to rest on the path."""
        if not (self.braking or self.finished):
            self._slope_max = self._largest_slope()

    def stop(self, why: Reason) -> None:
        """Brake, and say why."""
        if not self.braking:
            self.why = why
            self.brake()

    def limit_speed(self, share: float) -> None:
        """Set the speed override, up to 1; reached slowly after the first step."""
        self._speed = share
        if not self._paced and self._k < 0:
            self._speed_now = self.rate = share

    def _largest_slope(self) -> float:
        return _OBJECT_BRAKE_SLOPE

    def step(self) -> None:
        """Advance one control step; the first goes to time zero."""
        self._paced = self._paced or self.pace < 1.0 or self._speed < 1.0 or self._slope_max > 0.0
        if not self._paced:
            if not self.finished:
                self._k = k = self._k + 1
                self.finished = k >= self._steps
                self._t_s = min(k * self._dt, self._end_s)
            return
        if self.braking:
            rise = self._slope + self._slope_max * self._dt / _BRAKE_RAMP_S
            # On this curve slope and rate reach zero together, within the ramp time.
            fall = float(np.sqrt(2.0 * self.rate * self._slope_max / _BRAKE_RAMP_S))
            self._slope = min(rise, self._slope_max, fall)
        else:
            slew = _OVERRIDE_SLEW * self._dt
            self._speed_now += within(self._speed - self._speed_now, -slew, slew)
            pace = min(self.pace, self._speed_now)
            change = _PACE_SLOPE * self._dt / _BRAKE_RAMP_S
            slope = within((self.rate - pace) / _PACE_S, -_PACE_SLOPE, _PACE_SLOPE)
            self._slope += within(slope - self._slope, -change, change)
        self.rate = within(self.rate - self._slope * self._dt, 0.0, 1.0)
        self._t_s = min(self._t_s + self.rate * self._dt, self._end_s)
        if self.rate < _STOPPED_RATE or self._t_s >= self._end_s:
            self.rate = 0.0
            self._slope = 0.0
            self.finished = True

    def _slowed(self, v: Array, a: Array) -> tuple[Array, Array]:
        return v * self.rate, a * self.rate**2 - v * self._slope


class TrajectoryExecution(_Execution[TrajectoryCommand]):
    """A running trajectory.

    Attributes:
        joints: Slice of the driven joints.
        q, v, a: Reference.
        left: Start offset [rad] that has not faded.
    """

    left: Array | float = 0.0

    def __init__(self, command: TrajectoryCommand, dt_s: float, robot: Robot) -> None:
        super().__init__(command, dt_s)
        self.joints = robot.groups[command.group]
        self._a_max = robot.a_max[self.joints]
        self._columns = own_columns(command, robot)
        self._fill(0)
        self.q = self._q[0]
        self.v = self._v[0]
        self.a = self._a[0]

    def _fill(self, k: int, rows_n: int = _ROWS) -> None:
        times = np.minimum(np.arange(k, k + rows_n) * self._dt, self._end_s)
        self._q, self._v, self._a = (
            x[:, self._columns] for x in self.command.motion.sample_many(times)
        )

    def _largest_slope(self) -> float:
        now = round(self._t_s / self._dt)
        self._fill(now, _LOOK_AHEAD_ROWS)  # braking, it never comes back to these rows
        ahead = np.abs(self._v).max(axis=0)
        limit = float((BRAKE_SHARE * self._a_max / np.maximum(ahead, 1e-6)).min())
        return float(np.clip(limit, _BRAKE_SLOPE_MIN, _BRAKE_SLOPE_MAX))

    def step(self) -> None:
        """Advance one control step."""
        super().step()
        if not self._paced:
            row = self._k % _ROWS
            if row == 0:
                self._fill(self._k)
            self.q = self._q[row]
            self.v = self._v[row]
            self.a = self._a[row]
            return
        self.q, v, a = (x[self._columns] for x in self.command.motion.sample(self._t_s))
        self.v, self.a = self._slowed(v, a)


class ObjectExecution(_Execution[ObjectCommand]):
    """A running object path."""

    def __init__(self, command: ObjectCommand, dt_s: float) -> None:
        super().__init__(command, dt_s)
        self._at = command.motion.at
        self._squeeze_n = command.squeeze_n
        self._largest = np.array([_TURN_PER_S * dt_s, _SHIFT_M_PER_S * dt_s, *OBJECT_MAX])
        self.desired = self._own = self._at(0.0).copied()  # overwritten in each step
        self.squeeze_n = self._squeeze_n(0.0)

    def step(self) -> None:
        """Advance one control step; the squeeze follows path time."""
        super().step()
        squeeze_n = self._squeeze_n(self._t_s)
        if not -1e-6 <= squeeze_n <= SQUEEZE_MAX_N + 1e-6:
            squeeze = f"the path's squeeze is {squeeze_n} N at {self._t_s:.3f} s"
            raise UsageError(f"{squeeze}; 0 to {SQUEEZE_MAX_N} N")
        if not adopt(*self._at(self._t_s), self._largest, *self._own):
            fault = f"the object path jumps, or is too fast or too sharp, at {self._t_s:.3f} s"
            raise UsageError(fault, remedy="check its poses and their motion; none may be NaN")
        self.squeeze_n = squeeze_n
        if self._paced:
            self.desired = ObjectState(self._own[0], *self._slowed(*self._own[1:]))


Execution = TrajectoryExecution | ObjectExecution


class Underway:
    """Running timed commands, at most one per arm; `admit` as in CommandArbiter."""

    def __init__(
        self,
        dt_s: float,
        robot: Robot,
        admit: Callable[[Command], Reason | None],
    ) -> None:
        self._dt = dt_s
        self._robot = robot
        self.admit = admit
        self.executions: tuple[Execution, ...] = ()

    def begin(
        self,
        command: TimedCommand,
        posture: Array,
        v: Array,
        far_rad: float,
        gripper: Array,
    ) -> Reason | None:
        """Begin a command, or return why not.

        A trajectory may start at most `far_rad` from the measured posture (n,), on arms that hardly move. An
        object path must not open hands whose openings (2,) are closed.
        """
        reason = self.busy(command.arms) or self.admit(command)
        if reason is not None:
            return reason
        if isinstance(command, TrajectoryCommand):
            reason = self._far_start(command, posture, far_rad) or self._moving(command, v)
            if reason is not None:
                return reason
            begun: Execution = TrajectoryExecution(command, self._dt, self._robot)
        else:
            opens = (gripper < CLOSE_BELOW) & (command.gripper > OPEN_ABOVE)
            if opens.any():
                detail = f"gripper {command.gripper} would open the hands that hold the object"
                return "gripper_out_of_range", detail
            begun = ObjectExecution(command, self._dt)
        self.executions = (*self.executions, begun)
        return None

    def busy(self, arms: tuple[int, ...]) -> Reason | None:
        """Return why these arms are busy, or None."""
        for execution in self.executions:
            shared = [SIDES[arm] for arm in arms if arm in execution.arms]
            if shared:
                running = (
                    f"a {type(execution.command).__name__} is under way on {' and '.join(shared)}"
                )
                return "busy", f"{running}; wait for its end, or hold"
        return None

    @property
    def braking(self) -> bool:
        """Whether a command is braking."""
        return any(execution.braking for execution in self.executions)

    def follow(self, target: Array) -> tuple[Array, bool]:
        """Return the target (n,) updated on trajectories, and whether any ended."""
        target = target.copy()
        for execution in self.executions:
            if isinstance(execution, TrajectoryExecution):
                joints = execution.joints
                q = execution.q + execution.left * execution.braking  # braked, it fades no further
                target[joints] = np.clip(
                    q,
                    self._robot.q_lower[joints],
                    self._robot.q_upper[joints],
                )
        running = tuple(e for e in self.executions if not e.finished)
        ended = len(running) < len(self.executions)
        self.executions = running
        return target, ended

    def brake(self) -> None:
        """Brake all along their paths."""
        for execution in self.executions:
            execution.brake()

    def _moving(self, command: TrajectoryCommand, v: Array) -> Reason | None:
        fastest = float(np.abs(v[self._robot.groups[command.group]]).max())
        if fastest <= START_RAD_PER_S:
            return None
        moves = f"a trajectory starts at rest, and a joint moves at {fastest:.2f} rad/s"
        return "not_still", f"{moves}; bound {START_RAD_PER_S} rad/s"

    def _far_start(
        self,
        command: TrajectoryCommand,
        posture: Array,
        bound_rad: float,
    ) -> Reason | None:
        joints = self._robot.groups[command.group]
        away = command.motion.q[0, own_columns(command, self._robot)] - posture[joints]
        index = int(np.argmax(np.abs(away)))
        if abs(away[index]) <= bound_rad:
            return None
        name = self._robot.joint_names[joints][index]
        start = f"the trajectory starts {away[index]:+.3f} rad away from the arms at {name}"
        return "far_start", f"{start}; bound {bound_rad} rad"
