"""Impedance controllers: C, both arms and one object by object paths and squeeze; one hand."""

from typing import Protocol

import numpy as np

from minidual.config.control import ImpedanceConfig
from minidual.control.arbiter import ArbiterOutput
from minidual.control.commands import Command, ObjectCommand, Reason
from minidual.control.controllers import Controller, JointTrajectoryController
from minidual.control.execution import ObjectExecution
from minidual.control.gripper import GRAVITY_M_PER_S2
from minidual.control.hand_impedance import HandImpedance
from minidual.control.impedance import (
    SQUEEZE_MAX_N,
    HeldObject,
    ObjectImpedance,
    ObjectState,
    towards,
)
from minidual.control.kernels import apart, within
from minidual.control.payload import LOAD_MAX_N, Payload
from minidual.errors import DataError, UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, inverse

SQUEEZE_RATE_N_PER_S = 200.0
"""Largest squeeze rate; the grip limit acts at once."""
_START = (0.02, 0.1)
_CONTINUES = (0.001, 0.01)
OFF_PATH = (0.04, 0.15)
"""Largest distance [m] and angle [rad] between an object and a path where it starts, between a path and the end of the
last one that it continues, and between an object and its path on the way."""
SLOW_AT, _STOP_AT = np.array([[35.0, 0.1], [60.0, 0.02]])
"""Condition number of a hand's Jacobian [m, rad], and distance [rad] of a joint from its limit, where paths towards a
singularity or a limit slow down and stop. Carries stay below 28 and above 0.19 rad."""
_AHEAD_S = 0.2
_PACE_MIN = 0.1
_NEARER = 1e-4
_SPEED_SHARE = 0.9
"""_AHEAD_S: how far a path looks ahead; it slows down within 0.25 s."""
_IN_HAND = 0.04, 0.5
"""Largest distance [m] and angle [rad] by which an object may move in a hand; it turns between two pads."""
_FORGET_S = 0.5
"""How long the object's twist may differ from the motion of its pose, by as much as it may move in a hand."""
_BACK_TO_M = 0.01
_BACK_M_PER_S = 0.1
"""A path that left the object behind draws its end back to within this distance, at this speed."""


class ObjectSensor(Protocol):
    """Object measurements for controller C."""

    grip_limit_n: float
    """Largest internal force that friction carries, or infinite."""

    def read(self) -> tuple[ObjectState, float]:
        """Return the object's state and the measured internal force [N]."""
        ...


class ObjectImpedanceController(Controller):
    """Object impedance along a path; `sensor` is required for activation."""

    name = "object_impedance"
    compliant = True
    takes = (ObjectCommand,)

    def __init__(self, kinematics: Kinematics, dt_s: float, sensor: ObjectSensor | None) -> None:
        self._kinematics = kinematics
        self._sensor = sensor
        self._squeeze_step = SQUEEZE_RATE_N_PER_S * dt_s
        self._dt_s = dt_s
        self._updates = 0
        kind = np.repeat([0, 1], [len(SIDES), kinematics.robot.dof])
        self._slow_at = SLOW_AT[kind]
        self._room = (_STOP_AT - SLOW_AT)[kind]
        self.forget()

    def forget(self) -> None:
        """Clear the configuration; call only while inactive."""
        self._next: ObjectImpedance | None = None
        self._law: ObjectImpedance | None = None
        self._execution: ObjectExecution | None = None
        self.desired: ObjectState | None = None
        self._squeeze = self._squeeze_wanted = 0.0
        self._near: Array | None = None
        self._way = np.zeros(6)
        self.reference = np.zeros(self._kinematics.robot.dof)

    def configure(self, held: HeldObject, gains: ImpedanceConfig | None = None) -> None:
        """Set object and gains of the next activation.

        Raises:
            UsageError: A mass that the hands cannot bear.
        """
        most_kg = 2.0 * LOAD_MAX_N / GRAVITY_M_PER_S2
        if not 0.0 <= held.mass_kg <= most_kg:
            raise UsageError(
                f"two hands cannot hold {held.mass_kg} kg; they hold 0 to {most_kg:.2f} kg",
            )
        self._next = ObjectImpedance(self._kinematics, held, gains or ImpedanceConfig())

    def refuses(self, command: Command) -> Reason | None:
        """Refuse all but object paths starting at the object."""
        if not isinstance(command, ObjectCommand):
            return super().refuses(command)
        start = command.motion.at(0.0)
        bounds = OFF_PATH if self._continues(start) else _START
        far = self._away(start, bounds)
        return ("far_start", f"the path starts {far}") if far else None

    def _continues(self, start: ObjectState) -> bool:
        """Return whether a path starts where the last one has ended, so that the spring is not stretched further."""
        if self.desired is None:
            return False
        away_m, away_rad = apart(start.T_world_object, self.desired.T_world_object, self._way)
        return away_m < _CONTINUES[0] and away_rad < _CONTINUES[1]

    def _away(
        self,
        wanted: ObjectState,
        bounds: tuple[float, float],
        what: str = "the object",
    ) -> str:
        """Return how far off the object is, if it is beyond the bounds [m, rad]; NaN is."""
        away_m, away_rad = apart(
            self._ready()[1].read()[0].T_world_object,
            wanted.T_world_object,
            self._way,
        )
        if away_m <= bounds[0] and away_rad <= bounds[1]:
            return ""
        return f"{1e3 * away_m:.0f} mm, {away_rad:.3f} rad away from {what}; bounds {bounds[0]} m, {bounds[1]} rad"

    def not_ready(self) -> str:
        """See `Controller`."""
        if self._next is None:
            return "it has not been told what is held"
        return "" if self._sensor is not None else "no sensor tells it of an object"

    def activate(self, q: Array, v: Array) -> None:
        """Hold the object at its pose and squeeze."""
        if self._next is not None:
            self._next.engage(q)
        self._law = self._next
        measured, internal_force = self._ready()[1].read()
        self.desired = ObjectState(measured.T_world_object.copy())
        self._T_tcp_objects = [
            inverse(T) @ self.desired.T_world_object for T in self._kinematics.tcp_poses(q)
        ]
        self._T_seen = self.desired.T_world_object
        self._back = False
        self._updates = 0
        self._twists, self._off = np.zeros((2, 6))
        self._squeeze = self._squeeze_wanted = float(np.clip(internal_force, 0.0, SQUEEZE_MAX_N))
        self._execution = None
        self.reference = np.array(q, dtype=float)
        self._v = v

    @property
    def load(self) -> Array:
        """External torque (n,) [Nm] of the object, last commanded."""
        return -self._ready()[0].push

    @property
    def mass_kg(self) -> float:
        """Mass that each hand bears."""
        return 0.5 * self._ready()[0].held.mass_kg

    def follow(self, output: ArbiterOutput) -> None:
        """Take a begun object path; slow it down towards singularities and joint limits, stop it if left behind."""
        for execution in output.executions:
            if isinstance(execution, ObjectExecution):
                if execution is not self._execution:
                    self._near = None
                    self._back = False
                self._execution = execution
        for arm, T in enumerate(self._kinematics.tcp_poses(self.reference)):
            held = ObjectState(T @ self._T_tcp_objects[arm])
            far = self._away(held, _IN_HAND, f"where the {SIDES[arm]} hand holds it")
            if far:
                raise DataError(
                    f"the object is {far}",
                    remedy="look at what measures its pose, and at the grasp",
                )
        steps = self._updates
        self._updates = 0
        if steps:
            self._compare_motion(steps)
        if self._execution is not None:
            self._give_room(self._execution, max(1, steps))
            far = self._away(self._execution.desired, OFF_PATH)
            if far:
                self._execution.stop(("off_path", f"the path is {far}"))
                self._back = True

    def _compare_motion(self, steps: int) -> None:
        T = self._ready()[1].read()[0].T_world_object
        before = self._T_seen
        span_s = steps * self._dt_s
        apart(T, before, self._way)
        self._T_seen = T.copy()
        self._off += (
            self._dt_s * self._twists - self._way - min(1.0, span_s / _FORGET_S) * self._off
        )
        self._twists[:] = 0.0
        off_m, off_rad = np.linalg.norm(self._off.reshape(2, 3), axis=1).tolist()
        if not (off_m <= _IN_HAND[0] and off_rad <= _IN_HAND[1]):
            off = f"{1e3 * off_m:.0f} mm, {off_rad:.2f} rad in {_FORGET_S} s; bounds {_IN_HAND[0]} m, {_IN_HAND[1]} rad"
            raise DataError(
                f"the object's twist is off the motion of its pose: {off}",
                remedy="look at its sensor",
            )

    def _give_room(self, execution: ObjectExecution, steps: int) -> None:
        robot = self._kinematics.robot
        q = self.reference
        hands = [
            J[:, robot.joints_of(arm)] for arm, J in enumerate(self._kinematics.tcp_jacobians(q))
        ]
        squares = np.linalg.eigvalsh([J @ J.T for J in hands])
        condition = np.sqrt(squares[:, -1] / np.maximum(squares[:, 0], 1e-12))
        margin = np.minimum(q - robot.q_lower, robot.q_upper - q)
        values = np.concatenate([condition, margin])
        share = float((np.abs(self._v) / robot.v_max).max())
        # the share of full speed at the full rate
        near = np.append(
            (values - self._slow_at) / self._room,
            share / max(execution.rate, _PACE_MIN),
        )
        nearer = np.zeros_like(near) if self._near is None else near - self._near
        self._near = near
        *ahead, share = near + _AHEAD_S / (self._dt_s * steps) * np.maximum(nearer, 0.0)
        nearing = np.where(nearer[:-1] > _NEARER, ahead, 0.0)
        worst = int(nearing.argmax())
        execution.pace = max(
            _PACE_MIN,
            min(1.0 - float(nearing[worst]), _SPEED_SHARE / max(share, _SPEED_SHARE)),
        )
        if nearing[worst] >= 1.0 and worst < len(condition):
            what = f"the {SIDES[worst]} hand's Jacobian has condition number {values[worst]:.0f}"
            execution.stop(
                ("singular", f"{what}; paths towards a singularity stop before {_STOP_AT[0]:.0f}"),
            )
        elif nearing[worst] >= 1.0:
            what = f"{robot.joint_names[worst - len(condition)]} is {values[worst]:.3f} rad from its limit"
            execution.stop(
                ("joint_limit", f"{what}; paths towards it stop before {_STOP_AT[1]} rad"),
            )

    def update(self, q: Array, v: Array) -> Array:
        """See `Controller`."""
        (law, sensor) = self._ready()
        execution = self._execution
        if execution is not None:
            self.desired = execution.desired
            self._squeeze_wanted = execution.squeeze_n
            if execution.finished:
                self._execution = None
        if self._squeeze != self._squeeze_wanted:
            self._squeeze += within(
                self._squeeze_wanted - self._squeeze,
                -self._squeeze_step,
                self._squeeze_step,
            )
        # The hands slip above the friction limit: reduce the squeeze at once.
        if self._squeeze > sensor.grip_limit_n:
            self._squeeze = sensor.grip_limit_n
        measured, felt_n = sensor.read()
        self._twists += measured.twist
        self.reference = q
        self._v = v
        desired = self.desired or measured
        self._updates = self._updates + 1
        if self._back and execution is None:
            ahead = desired.T_world_object
            there = measured.T_world_object
            ahead_m = apart(ahead, there, self._way)[0]
            step = _BACK_M_PER_S * self._dt_s / max(ahead_m, _BACK_TO_M)
            self._back = ahead_m > _BACK_TO_M
            self.desired = desired = ObjectState(towards(ahead, there, step)[0])
        return law.torque(q, v, measured, desired, wanted_n=self._squeeze, felt_n=felt_n)

    def _ready(self) -> tuple[ObjectImpedance, ObjectSensor]:
        if self._law is None or self._sensor is None:
            raise UsageError(f"controller {self.name} is not ready: {self.not_ready()}")
        return self._law, self._sensor


class HandImpedanceController(JointTrajectoryController):
    """Does what `left_arm` or `right_arm` does, by impedance."""

    compliant = True

    def __init__(self, arm: int, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        super().__init__(f"{SIDES[arm]}_arm", kinematics, dt_s, payload)
        self.name = f"{SIDES[arm]}_hand"
        self._servo = self.law = HandImpedance(kinematics, arm, dt_s)

    def activate(self, q: Array, v: Array) -> None:
        """Start the reference at the measurement."""
        super().activate(q, v)
        self.law.engage(q)

    def follow(self, output: ArbiterOutput) -> None:
        """See `JointTrajectoryController`; holds learn nothing: it would add to a spring of bounded force."""
        super().follow(output)
        self._holds = False
