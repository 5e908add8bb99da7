"""Start, progress and end of the arbiter's timed commands."""

from collections.abc import Callable

import numpy as np

from minidual.control.command_checks import own_columns
from minidual.control.commands import Command, Reason, TimedCommand, TrajectoryCommand
from minidual.control.execution import Execution, ObjectExecution, TrajectoryExecution
from minidual.robot.pair import SIDES, Array, Robot


class Underway:
    """Running timed commands, at most one per arm; `admit` as in CommandArbiter."""

    def __init__(self, dt_s: float, robot: Robot, admit: Callable[[Command], Reason | None]) -> None:
        self._dt, self._robot, self.admit = dt_s, robot, admit
        self.executions: tuple[Execution, ...] = ()

    def begin(self, command: TimedCommand, posture: Array, start_bound_rad: float) -> Reason | None:
        """Begin a command, or return why not.

        A trajectory may start at most `start_bound_rad` from the measured posture (n,).
        """
        reason = self.busy(command.arms) or self.admit(command)
        if reason is None and isinstance(command, TrajectoryCommand):
            reason = self._far_start(command, posture, start_bound_rad)
        if reason is None:
            timed = isinstance(command, TrajectoryCommand)
            begun = TrajectoryExecution(command, self._dt, self._robot) if timed else ObjectExecution(command, self._dt)
            self.executions = (*self.executions, begun)
        return reason

    def busy(self, arms: tuple[int, ...]) -> Reason | None:
        """Return why these arms are busy, or None."""
        for execution in self.executions:
            shared = [SIDES[arm] for arm in arms if arm in execution.arms]
            if shared:
                kind = type(execution.command).__name__
                return "busy", f"a {kind} is under way on {' and '.join(shared)}; wait for its end, or hold"
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
                target[joints] = np.clip(execution.q, self._robot.q_lower[joints], self._robot.q_upper[joints])
        running = tuple(e for e in self.executions if not e.finished)
        ended = len(running) < len(self.executions)
        self.executions = running
        return target, ended

    def stopped(self) -> list[Reason]:
        """Return, once, why controllers have stopped commands."""
        reasons = [execution.why for execution in self.executions if execution.why is not None]
        for execution in self.executions:
            execution.why = None
        return reasons

    def brake(self) -> None:
        """Brake all along their paths."""
        for execution in self.executions:
            execution.brake()

    def _far_start(self, command: TrajectoryCommand, posture: Array, bound_rad: float) -> Reason | None:
        joints = self._robot.groups[command.group]
        away = command.motion.q[0, own_columns(command, self._robot)] - posture[joints]
        index = int(np.argmax(np.abs(away)))
        if abs(away[index]) <= bound_rad:
            return None
        name = self._robot.joint_names[joints][index]
        start = f"the trajectory starts {away[index]:+.3f} rad away from the arms at {name}"
        return "far_start", f"{start}; bound {bound_rad} rad"
