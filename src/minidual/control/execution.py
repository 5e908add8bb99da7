"""Running timed commands, each with its own clock.

Braking slows the clock, so two hands that carry something keep their distance:

    q(s),  s' = r from 1 to 0,  v = q' r,  a = q'' r^2 + q' dr/dt

dr/dt is ramped, so the torques do not jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.control.command_checks import own_columns
from minidual.control.commands import ArbiterState, ObjectCommand, Refusal, TrajectoryCommand
from minidual.control.object_impedance import ObjectState
from minidual.robot.pair import Array, Robot

BRAKE_SHARE = 0.8
"""Share of the joints' acceleration limits."""
_BRAKE_SLOPE_MIN, _BRAKE_SLOPE_MAX = 2.0, 20.0
_OBJECT_BRAKE_SLOPE = 4.0
_BRAKE_RAMP_S = 0.03
_STOPPED_RATE = 1e-4
_LOOK_AHEAD_ROWS = 500


class _Clock:
    """Path time; its rate is 1 until braked."""

    def __init__(self, duration_s: float, dt_s: float) -> None:
        self.steps = max(1, int(np.ceil(duration_s / dt_s - 1e-6)))
        self.k = -1
        self.t_s = 0.0
        self.rate = 1.0
        self.slope = 0.0
        self._slope_max = 0.0
        self._dt, self._end_s = dt_s, duration_s

    @property
    def finished(self) -> bool:
        """Whether it ended or stopped."""
        return self.k >= self.steps or self.rate == 0.0

    @property
    def braking(self) -> bool:
        return self._slope_max > 0.0

    def brake(self, slope_max: float) -> None:
        """Reduce the rate to zero, by at most `slope_max` [1/s]."""
        self._slope_max = slope_max

    def step(self) -> None:
        """Advance one control step, first to time zero."""
        if self._slope_max > 0.0:
            rise = self.slope + self._slope_max * self._dt / _BRAKE_RAMP_S
            # On this curve slope and rate reach zero together, within the ramp time.
            fall = float(np.sqrt(2.0 * self.rate * self._slope_max / _BRAKE_RAMP_S))
            self.slope = min(rise, self._slope_max, fall)
            self.rate = max(0.0, self.rate - self.slope * self._dt)
            self.t_s = min(self.t_s + self.rate * self._dt, self._end_s)
            if self.rate < _STOPPED_RATE or self.t_s >= self._end_s:
                self.rate = self.slope = 0.0
        elif self.k < self.steps:
            self.k += 1
            self.t_s = min(self.k * self._dt, self._end_s)


class _Execution:
    def __init__(self, arms: tuple[int, ...], duration_s: float, dt_s: float) -> None:
        self.arms = arms
        self._clock = _Clock(duration_s, dt_s)

    @property
    def finished(self) -> bool:
        return self._clock.finished

    @property
    def braking(self) -> bool:
        return self._clock.braking


class TrajectoryExecution(_Execution):
    """A running trajectory.

    Attributes:
        joints: Slice of the driven joints.
        q, v, a: Their present reference.
    """

    def __init__(self, command: TrajectoryCommand, dt_s: float, robot: Robot) -> None:
        super().__init__(command.arms, command.motion.duration_s, dt_s)
        self.command = command
        self.joints = robot.groups[command.group]
        self._a_max = robot.a_max[self.joints]
        self._columns = own_columns(command, robot)
        times = np.minimum(np.arange(self._clock.steps + 1) * dt_s, command.motion.duration_s)
        self._q, self._v, self._a = (x[:, self._columns] for x in command.motion.sample_many(times))
        self.q, self.v, self.a = self._q[0], self._v[0], self._a[0]

    def brake(self) -> None:
        """Come to rest on the path."""
        clock = self._clock
        if clock.braking or clock.finished:
            return
        k = max(clock.k, 0)
        ahead = np.abs(self._v[k : k + _LOOK_AHEAD_ROWS]).max(axis=0)
        limit = float((BRAKE_SHARE * self._a_max / np.maximum(ahead, 1e-6)).min())
        clock.brake(float(np.clip(limit, _BRAKE_SLOPE_MIN, _BRAKE_SLOPE_MAX)))

    def step(self) -> None:
        """Advance one control step."""
        clock = self._clock
        clock.step()
        if not clock.braking:
            self.q, self.v, self.a = self._q[clock.k], self._v[clock.k], self._a[clock.k]
            return
        rows = self.command.motion.sample_many(np.array([clock.t_s]))
        q, v, a = (x[0, self._columns] for x in rows)
        self.q, self.v, self.a = q, v * clock.rate, a * clock.rate**2 - v * clock.slope


class ObjectExecution(_Execution):
    """A running object path."""

    def __init__(self, command: ObjectCommand, dt_s: float) -> None:
        super().__init__(command.arms, command.motion.duration_s, dt_s)
        self.command = command
        self.desired = command.motion.at(0.0)
        self.squeeze_n = command.squeeze_n(0.0)

    def brake(self) -> None:
        """Come to rest on the path, keeping that point's squeeze."""
        if not (self._clock.braking or self._clock.finished):
            self._clock.brake(_OBJECT_BRAKE_SLOPE)

    def step(self) -> None:
        """Advance one control step."""
        clock = self._clock
        clock.step()
        state = self.command.motion.at(clock.t_s)
        self.squeeze_n = self.command.squeeze_n(clock.t_s)
        if clock.braking:
            rate, slope = clock.rate, clock.slope
            state = ObjectState(
                state.T_world_object, state.twist * rate, state.acceleration * rate**2 - state.twist * slope
            )
        self.desired = state


Execution = TrajectoryExecution | ObjectExecution


@dataclass(frozen=True)
class ArbiterOutput:
    """The arbiter's output of one tick.

    Attributes:
        q_target: (n,) [rad], finite and within limits.
        gripper: (2,), 0 closed to 1 open.
        active_source: Source whose command passed.
        held_arms: Arms without a fresh command.
        switched_to: Mode confirmed now.
        executions: Their arms ignore `q_target`.
        halted: The arms must stop now.
    """

    q_target: Array
    gripper: Array
    state: ArbiterState
    active_source: str | None
    held_arms: tuple[str, ...]
    switched_to: str | None
    refusals: tuple[Refusal, ...]
    executions: tuple[Execution, ...] = ()
    halted: bool = False
