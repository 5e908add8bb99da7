"""Drive any plant by streamed joint targets, and keep its measurements."""

import itertools
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from minidual.config.root import Config
from minidual.control.commands import JointCommand
from minidual.control.controllers import JointTrajectoryController
from minidual.control.kernels import minimum_jerk
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.errors import ExitCode, MinidualError
from minidual.plant.lifecycle import Connection
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array
from minidual.skills.supervised import trial_supervisor

_MINIMUM_JERK_PEAK = 1.875  # peak over mean speed of a minimum-jerk motion
_MOVE_MIN_S = 0.6
_SPEED_RAD_S = 1.0
"""Joint speed of a move at full speed."""
_GIVEN_MAX_S = 1.0
_REST_MAX_S = 3.0
_STILL_RAD_S = 0.02


class DriveError(MinidualError):
    """The plant was not driven to the end: a reflex, or the arms were not given."""

    exit_code = ExitCode.ACCEPTANCE_FAILED


@dataclass(frozen=True, eq=False)
class Driven:
    """Measurements of a plant in T control steps.

    Attributes:
        t: (T,) [s] on the plant's clock.
        wall_s: (T,) [s] of a clock on the wall.
        reference: (T, n) [rad], the controllers' reference of the step.
        q, v, tau: (T, n) [rad], [rad/s], [Nm].
        stamps_s: (T, 2) of the arms' measurements.
        grip_n: (T, 2).
        fingers_m: (T, 2).
    """

    t: Array
    wall_s: Array
    reference: Array
    q: Array
    v: Array
    tau: Array
    stamps_s: Array
    grip_n: Array
    fingers_m: Array

    @property
    def errors(self) -> Array:
        """Reference minus measurement (T, n) [rad]."""
        return self.reference - self.q

    @property
    def rms_rad(self) -> float:
        """RMS of the error norm [rad]."""
        return float(np.sqrt(np.mean(np.sum(self.errors**2, axis=1))))


class PlantDrive:
    """A control stack on a plant, one source that streams targets, and a log.

    Args:
        connection: Open.
        config: Arbiter, supervisor and rate of the targets.
        speed: Share of full speed, 0.1 to 1.
        source: Of the arbiter, that streams the targets.

    Attributes:
        stack: For stops and recovery.
        speed: As given; moves are as much slower.
    """

    def __init__(
        self,
        connection: Connection,
        config: Config,
        speed: float = 1.0,
        source: str = "policy",
    ) -> None:
        plant = connection.plant
        self.connection = connection
        self.plant = plant
        self.robot = plant.robot
        self.speed = speed
        self._source = source
        supervisor = trial_supervisor(config.supervisor, plant.dt, plant.robot)
        self.stack = ControlStack(
            plant,
            Kinematics(plant.robot),
            config.arbiter,
            rate_hz=config.teleop.rate_hz,
            supervisor=supervisor,
        )
        self.stack.speed_override = speed
        self.openings = np.array(self.stack.grippers.openings, dtype=float)
        self._target = self.stack.measurement.q.copy()
        self._sequence = itertools.count(1)
        self._rows: list[tuple[object, ...]] = []

    @property
    def q(self) -> Array:
        """Measured posture (n,) [rad]."""
        return self.stack.measurement.q

    def begin(self) -> None:
        """Take the arms.

        Raises:
            DriveError: They are not given.
        """
        self.stack.request(self._source)
        self._target = self.stack.measurement.q.copy()
        end_s = self.plant.time + _GIVEN_MAX_S
        while self.stack.source != self._source:
            if self.plant.time > end_s:
                raise DriveError(f"the arms were not given: the arbiter is {self.stack.state}")
            self.stack.step()

    def step(self, target: Array | None = None) -> None:
        """Run one control step with a target (n,) [rad], by default the last one; keep a row.

        Raises:
            ReflexError: Once, of a reflex.
            DriveError: The source has lost the arms.
        """
        if target is not None:
            self._target = np.asarray(target, dtype=float)
        if self.stack.source == self._source and self.stack.tick_next:
            command = JointCommand(
                self._target.copy(),
                self.openings.copy(),
                self.plant.time,
                next(self._sequence),
            )
            self.stack.propose(self._source, command)
        self.stack.step()
        self._keep()

    def _keep(self) -> None:
        plant = self.plant
        self._rows.append(
            (
                plant.time,
                time.perf_counter(),
                np.array(self.stack.manager.reference),
                plant.q,
                plant.v,
                plant.tau,
                self.connection.stamps_s,
                plant.grip,
                plant.fingers,
            ),
        )

    def take(self) -> Driven:
        """Return the rows since the last call, and forget them."""
        rows = self._rows
        self._rows = []
        columns = [np.array(column, dtype=float) for column in zip(*rows, strict=True)]
        return Driven(*columns)

    def move(self, goal: Array, *, seconds: float = 0.0) -> Driven:
        """Move to a posture (n,) on a minimum-jerk line, and stay there for some seconds.

        Raises:
            ReflexError, DriveError: See `step`.
        """
        self.take_rows()
        start = self._target.copy()
        goal = np.asarray(goal, dtype=float)
        turn_rad = float(np.abs(goal - start).max())
        peak_rad_s = self.speed * _SPEED_RAD_S
        duration_s = max(_MOVE_MIN_S, _MINIMUM_JERK_PEAK * turn_rad / peak_rad_s)
        for k in range(1, round(duration_s / self.plant.dt) + 1):
            blend = minimum_jerk(min(1.0, k * self.plant.dt / duration_s))[0]
            self.step(start + blend * (goal - start))
        self.hold(seconds)
        return self.take()

    def hold(self, seconds: float) -> None:
        """Keep the last target for some seconds."""
        for _ in range(round(seconds / self.plant.dt)):
            self.step()

    def settle(self) -> None:
        """Keep the last target until all joints rest.

        Raises:
            DriveError: They do not come to rest.
        """
        end_s = self.plant.time + _REST_MAX_S
        while not self._is_still:
            if self.plant.time > end_s:
                raise DriveError(f"{_moving(self.plant)} {_REST_MAX_S:g} s after its motion")
            self.step()

    @property
    def _is_still(self) -> bool:
        return float(np.abs(self.plant.v).max()) < _STILL_RAD_S

    def follow(self, targets: Array) -> Driven:
        """Stream targets (T, n) [rad], one a control step.

        Raises:
            ReflexError, DriveError: See `step`.
        """
        self.take_rows()
        for target in targets:
            self.step(target)
        return self.take()

    def soften(self, share: float) -> None:
        """Lower the stiffness of the joints to a share, in our controllers or in the plant's own."""
        plants_own = getattr(self.plant, "soften", None)
        if plants_own is not None:
            plants_own(share)
            return
        for group in self.robot.groups:
            law = self.stack.manager[group]
            if isinstance(law, JointTrajectoryController):
                law.soften(share)

    def take_rows(self) -> None:
        """Forget the rows kept so far."""
        self._rows = []

    def stop_and_rest(self, reason: str) -> float:
        """Press the stack's emergency stop; return the time until all joints rest [s], or NaN."""
        self.stack.supervisor.estop(reason)
        began_s = self.plant.time
        while self.plant.time < began_s + _REST_MAX_S:
            with suppress(ReflexError):
                self.stack.step()
            self._keep()
            if self._is_still and self.stack.reflex is not None:
                return float(self.plant.time - began_s)
        return float("nan")

    def recover(self) -> None:
        """Clear a reflex, of the plant's controllers too, and take the arms again.

        Raises:
            UsageError: The arms move, or the plant still reports a fault.
            DriveError: The arms are not given.
        """
        self.connection.recover()
        self.stack.recover()
        self.begin()


def come_to_rest(plant: Plant) -> None:
    """Brake the arms of a plant, whatever drove them before, and wait until they rest.

    Raises:
        DriveError: They do not come to rest.
    """
    plant.brake(tuple(range(len(SIDES))))
    for _ in range(round(_REST_MAX_S / plant.dt)):
        if float(np.abs(plant.v).max()) < _STILL_RAD_S:
            plant.brake(())
            return
        plant.step()
    raise DriveError(f"{_moving(plant)} {_REST_MAX_S:g} s after it was braked")


def _moving(plant: Plant) -> str:
    speeds = np.abs(plant.v)
    joint = int(speeds.argmax())
    name = plant.robot.joint_names[joint]
    return f"joint {name} still moves at {speeds[joint]:.3f} rad/s (bound {_STILL_RAD_S}),"


def swing(home: Array, amplitudes: Array, frequency_hz: float, times_s: Sequence[float]) -> Array:
    """Return targets (T, n) [rad] that swing about home from rest: home + A (1 - cos w t) / 2."""
    phase = 2.0 * np.pi * frequency_hz * np.asarray(times_s)[:, None]
    return home + 0.5 * amplitudes * (1.0 - np.cos(phase))
