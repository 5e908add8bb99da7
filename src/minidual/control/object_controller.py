"""Controller C: both arms around one object, commanded by paths of the object and by the squeeze on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from minidual.control.command_checks import Fault
from minidual.control.commands import Command, ObjectCommand
from minidual.control.controllers import Controller
from minidual.control.execution import ArbiterOutput, ObjectExecution
from minidual.control.object_impedance import HeldObject, ImpedanceGains, ObjectImpedance, ObjectState, bounded
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.poses import rotation_log

SQUEEZE_RATE_N_PER_S = 200.0
"""The squeeze follows what is wanted no faster."""
_START_M, _START_RAD = 0.02, 0.1
"""How far from the object its path may start."""


class ObjectSensor(Protocol):
    """What tells controller C of the object in the hands."""

    @property
    def grip_limit_n(self) -> float:
        """Largest internal force [N] that the hands' friction carries, as far as it is known; else infinite."""
        ...

    def read(self) -> tuple[ObjectState, float]:
        """Return the object's state (its acceleration is not used) and the measured internal force [N]."""
        ...


class ObjectImpedanceController(Controller):
    """Both arms around one object: its path is followed as by a damped spring, its squeeze is servoed.

    Args:
        kinematics: Dynamics.
        dt_s: Control step.
        sensor: Tells of the object; without one it cannot be activated.
        drives: Says whether it is active; by default it never is.
    """

    name = "object_impedance"

    def __init__(
        self,
        kinematics: Kinematics,
        dt_s: float,
        sensor: ObjectSensor | None,
        *,
        drives: Callable[[], bool] = lambda: False,
    ) -> None:
        self._kinematics, self._sensor, self._drives = kinematics, sensor, drives
        self._squeeze_step = SQUEEZE_RATE_N_PER_S * dt_s
        self.forget()

    def forget(self) -> None:
        """Hold nothing: it must be told again what is held. Only for when it does not drive."""
        self._law: ObjectImpedance | None = None
        self._execution: ObjectExecution | None = None
        self._desired: ObjectState | None = None
        self._squeeze = self._squeeze_wanted = 0.0
        self._reference = np.zeros(self._kinematics.robot.dof)

    def configure(self, held: HeldObject, gains: ImpedanceGains | None = None) -> None:
        """Tell it what is held and how stiffly; it cannot be activated before.

        Raises:
            UsageError: It drives: a law that has not taken over cannot stand in for the one that has.
        """
        if self._drives():
            raise UsageError(
                f"what is held cannot change while controller {self.name} drives",
                remedy="switch to other controllers first",
            )
        self._law = ObjectImpedance(self._kinematics, held, ImpedanceGains() if gains is None else gains)

    def find_fault(self, command: Command) -> Fault | None:
        """Take object paths that start where the object is."""
        if not isinstance(command, ObjectCommand):
            return ("wrong_controller", f"controller {self.name} takes object paths, no {type(command).__name__}")
        measured, _ = self._ready_sensor().read()
        T, T_start = measured.T_world_object, command.motion.at(0.0).T_world_object
        away_m = float(np.linalg.norm(T_start[:3, 3] - T[:3, 3]))
        away_rad = float(np.linalg.norm(rotation_log(T_start[:3, :3] @ T[:3, :3].T)))
        if away_m <= _START_M and away_rad <= _START_RAD:
            return None
        detail = (
            f"the path starts {1e3 * away_m:.0f} mm, {away_rad:.3f} rad away from the object; bounds {_START_M} m, "
            f"{_START_RAD} rad"
        )
        return "far_start", detail

    def not_ready(self) -> str:
        """Return why it cannot be activated, or an empty string."""
        if self._law is None:
            return "it has not been told what is held"
        return "" if self._sensor is not None else "no sensor tells it of an object"

    def activate(self, q: Array, v: Array) -> None:
        """Hold the object where it is, pressed as it is."""
        law = self._ready_law()
        law.engage(q)
        measured, internal_force = self._ready_sensor().read()
        self._desired = ObjectState(measured.T_world_object)
        ceiling = law.gains.force_ceiling_n
        self._squeeze = self._squeeze_wanted = float(np.clip(internal_force, 0.0, ceiling))
        self._execution = None
        self._reference = np.array(q, dtype=float)

    def follow(self, output: ArbiterOutput) -> None:
        """Take an object path that has begun."""
        for execution in output.executions:
            if isinstance(execution, ObjectExecution):
                self._execution = execution

    def update(self, q: Array, v: Array) -> Array:
        """Run one control step."""
        law = self._ready_law()
        if self._execution is not None:
            self._desired, self._squeeze_wanted = self._execution.desired, self._execution.squeeze_n
            if self._execution.finished:
                self._execution = None
        step = self._squeeze_wanted - self._squeeze
        step = bounded(step, -self._squeeze_step, self._squeeze_step)
        # More than friction carries makes the hands slip: a grip that has begun to is eased at once.
        sensor = self._ready_sensor()
        self._squeeze = min(self._squeeze + step, sensor.grip_limit_n)
        measured, internal_force = sensor.read()
        self._reference = q
        desired = measured if self._desired is None else self._desired
        return law.torque(
            q, v, measured, desired, internal_force_n=self._squeeze, measured_internal_force_n=internal_force
        )

    @property
    def desired(self) -> ObjectState | None:
        """Object as wanted in the last step, or None before it was first activated."""
        return self._desired

    @property
    def reference(self) -> Array:
        """Measured joints (n,) [rad]: an impedance has no joint reference."""
        return self._reference

    def _ready_law(self) -> ObjectImpedance:
        if self._law is None:
            raise UsageError(f"controller {self.name} is not ready: {self.not_ready()}")
        return self._law

    def _ready_sensor(self) -> ObjectSensor:
        if self._sensor is None:
            raise UsageError(f"controller {self.name} is not ready: {self.not_ready()}")
        return self._sensor
