"""Carry an object under object impedance: approach, grasp, squeeze, lift, carry, lower, release, retreat.

Everything the arms do rests on what is sensed: joints and fingers from their encoders, motor torques from the drives,
the object's pose and the contact forces through `sim/sensing.py`. The true state of the object is not read here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.config.control import CarryConfig
from minidual.config.seeds import stream
from minidual.control.gripper import Grippers
from minidual.control.joint_control import ComputedTorque
from minidual.control.object_estimate import HeldEstimate, RestingEstimate
from minidual.control.object_impedance import (
    HeldObject,
    ImpedanceGains,
    ObjectImpedance,
    ObjectState,
    SingularPostureError,
)
from minidual.control.object_path import ObjectPath, Waypoint
from minidual.control.reflexes import Reflex, ReflexError
from minidual.control.soft_stop import SoftStop, TorqueRate
from minidual.control.stack import Guard
from minidual.robot.constants import DOF_PER_ARM, FINGER_TRAVEL_M, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse
from minidual.sim.sensing import Reading, Sensors
from minidual.sim.world import World
from minidual.tasks.faults import FAULTS, CarryFault, FaultMonitor, Finding
from minidual.tasks.pace import joint_duration_s, object_duration_s
from minidual.tasks.reach import GraspUnreachableError, Quintic, approach_postures, grasp_posture
from minidual.tasks.rod_carry import RodTrial, level_part, tilt_rad

_OPEN, _CLOSED = np.ones(2), np.zeros(2)
_SQUEEZE_RAMP_S, _SQUEEZE_SETTLE_S = 0.3, 0.1
_LANDED_S = 0.1
_RELEASE_RAMP_S = 0.2
_OPENING_S = 0.3
_STOPPED_S = 0.5
_STOP_FREQUENCY_RAD_S = 8.0
_RETREAT_M = 0.10
_GRIPPED = 0.9
_EASED = 0.75
"""Share of the squeeze felt as the hands began to slip that is wanted from then on."""
_EASE_MARGIN = 1.1
"""Squeeze over what the task needs below which it is not eased: a grip that slips even then is lost."""


@dataclass(frozen=True)
class _Phase:
    name: str
    began_s: float


@dataclass(frozen=True)
class _Hold:
    """What is fixed when both hands have closed: the law, the object's path, and the roll it lay at."""

    law: ObjectImpedance
    path: ObjectPath
    estimate: HeldEstimate
    T_level_object: Array

    def desired(self, t_s: float) -> ObjectState:
        state = self.path.at(t_s)
        return ObjectState(state.T_world_object @ self.T_level_object, state.twist, state.acceleration)


class ImpedanceCarry:
    """One trial under object impedance; call `step` until `done`.

    Args:
        world: The plant, already reset. Joints, fingers and motors are read from it, the object never.
        kinematics: Workspace.
        config: Speeds, gains, sensing, limits.
        trial: Start and goal. The start is not read: the object is found by its sensor.
        sensors: What senses the object; by default, the configured sensors on the trial's own stream of `seed`.
        seed: The run's seed.
        supervisor: Guards the motors; its reflex is a fault.
    """

    name = "impedance"

    def __init__(
        self, world: World, kinematics: Kinematics, config: CarryConfig, trial: RodTrial, *,
        sensors: Sensors | None = None, seed: int = 0, supervisor: Guard | None = None,
    ) -> None:  # fmt: skip
        self.world, self._config, self._trial = world, config, trial
        self._kinematics, self._scene = kinematics, world.scene
        if sensors is None:
            sensors = Sensors(world, config.sensing, stream(seed, f"sensing/{trial.purpose}", trial.index))
        self._sensors = sensors
        self._joint = ComputedTorque(kinematics)
        pinch = config.impedance.pinch_n
        self._grippers = Grippers(world.scene, world.dt, pinch_force_n=pinch)
        self._monitor = FaultMonitor(
            config.faults, dt_s=world.dt, width_m=2.0 * world.scene.rod.half_width_m, pinch_n=pinch
        )
        self._reading = sensors.sense()
        if self._reading.pose is None:
            raise RuntimeError("the first reading of the sensors holds a pose")
        self._sensed_s = world.time
        self._forces, self._pinch = self._reading.hand_forces.copy(), self._reading.pinch.copy()
        self._filter_share = world.dt / (config.sensing.force_filter_s + world.dt)
        self._resting = RestingEstimate(self._reading.pose.T_world_object)
        self._q_over, unreachable = world.q, ""
        try:
            self._q_over, _ = approach_postures(world.scene, level_part(self._resting.T_world_object))
        except GraspUnreachableError as error:
            unreachable = error.message
        self._motion: Quintic | SoftStop = self._travel(world.q, self._q_over)
        self._rate = TorqueRate(kinematics.gravity(world.q), world.dt)
        self._supervisor = supervisor
        if supervisor is not None:
            supervisor.reset()
        self._reflex: Reflex | None = None
        self._opening = _OPEN
        self._told: Array | None = None
        self._dead: Array | None = None
        self._stop_opens = False
        self._phase = _Phase("approach", world.time)
        self._squeeze_n = config.impedance.internal_force_n
        self._spread_m: float | None = None
        self._hold: _Hold | None = None
        self._desired: ObjectState | None = None
        self.fault: CarryFault | None = None
        if unreachable:
            self._heed(("unreachable", unreachable))

    @property
    def phase(self) -> str:
        """Name of the phase the trial is in."""
        return self._phase.name

    @property
    def done(self) -> bool:
        """Return whether the cycle is over, aborted or not."""
        return self._phase.name == "done"

    @property
    def aborted(self) -> str | None:
        """Why the trial stopped itself, or None."""
        return None if self.fault is None else self.fault.text

    @property
    def estimate(self) -> ObjectState:
        """Where the controller believes the object to be."""
        return ObjectState(self._resting.T_world_object) if self._hold is None else self._hold.estimate.state

    @property
    def squeeze_n(self) -> float:
        """Internal force that is wanted once the squeeze is complete [N]; it falls when the hands slip."""
        return self._squeeze_n

    @property
    def desired(self) -> ObjectState | None:
        """Where the object should be in this step, or None while it is not carried under impedance."""
        return None if self._hold is None else self._desired

    def step(self) -> None:
        """Run one control and physics step."""
        world = self.world
        self._sense()
        if self._reflex is not None:
            self._heed(("reflex", self._reflex.text))
        if self._told is not None and (self.fault is None or self.fault.name == "lost_arm"):
            self._heed_motors(self._monitor.motors(self._told, world.tau))
        getattr(self, f"_{self._phase.name}")(world.time - self._phase.began_s)
        world.step()

    # What is common to all phases -----------------------------------------------------------------------

    def _sense(self) -> None:
        """Take in what the sensors deliver and filter the forces."""
        if self.world.time > self._sensed_s:  # the constructor has sensed the first step already
            self._reading = self._sensors.sense()
        reading: Reading = self._reading
        share = self._filter_share
        self._forces += share * (reading.hand_forces - self._forces)
        self._pinch += share * (reading.pinch - self._pinch)
        if self._phase.name in ("approach", "descend") and reading.pose is not None:
            self._resting.add(reading.pose.T_world_object)
            self._heed(self._monitor.resting(self._resting.innovation))

    def _command(self, tau: Array, opening: Array) -> None:
        """Send torques, their change bounded and guarded by the supervisor, and finger targets."""
        if self._dead is not None:
            tau = np.where(self._dead, 0.0, tau)
        tau = self._rate.limit(tau)  # between torques within the motors' limits, so within them too
        self._told, self._opening = self._guarded(tau), opening
        self.world.command(self._told, self._grippers.step(opening))

    def _guarded(self, tau: Array) -> Array:
        """Return what the supervisor lets through; what it stops the arms for is heeded from the next step on."""
        if self._supervisor is None:
            return tau
        world = self.world
        try:
            allowed = self._supervisor.guard(world.time, world.q, world.v, tau)
        except ReflexError as error:
            self._reflex, allowed = error.reflex, error.tau
        return allowed if self._dead is None else np.where(self._dead, tau, allowed)

    def _enter(self, name: str) -> None:
        self._phase = _Phase(name, self.world.time)

    def _heed(self, finding: Finding) -> None:
        """Stop softly if something was found: the arms come to rest where they are."""
        if finding is None or self.fault is not None:
            return
        name, detail = finding
        world = self.world
        self.fault = CarryFault(name, world.time, detail)
        # A reflex is not about the object: the hands stay as they are commanded.
        self._stop_opens = FAULTS[name].opens_hands if name != "reflex" else self._opening is _OPEN
        # Two hands that still hold one object must not fight each other over it: a soft hold.
        self._joint = ComputedTorque(self._kinematics, natural_frequency_rad_s=_STOP_FREQUENCY_RAD_S)
        self._motion = SoftStop(world.q, world.v, deceleration_share=self._config.faults.deceleration_share)
        self._hold = None
        self._enter("stop")

    def _heed_motors(self, finding: Finding) -> None:
        """Stop for motors that are gone, and tell them nothing more; the other arm may be lost while this one stops."""
        if finding is None:
            return
        self._heed(finding)
        # A drive that comes back must not find a torque waiting.
        self._dead = np.repeat(self._monitor.lost, DOF_PER_ARM)

    def _travel(self, q0: Array, q1: Array) -> Quintic:
        return Quintic(q0, q1, joint_duration_s(q0, q1, self._config.pace))

    # Phases in joint space -------------------------------------------------------------------------------

    def _joints(self, t: float, opening: Array) -> bool:
        world = self.world
        self._command(self._joint.torque(world.q, world.v, *self._motion.at(t)), opening)
        return t >= self._motion.duration_s

    def _approach(self, t: float) -> None:
        if self._joints(t, _OPEN):
            # By now the object has been seen a hundred times: the grasp is placed by the mean.
            q_grasp = self._grasp(self._q_over)
            if q_grasp is not None:
                self._motion = self._travel(self._q_over, q_grasp)
                self._enter("descend")

    def _grasp(self, q_near: Array, *, above_m: float = 0.0) -> Array | None:
        """Return the posture (14,) with the hands at or over their grasps; None, and a soft stop, where there is none."""
        level = level_part(self._resting.T_world_object)
        try:
            return grasp_posture(self._scene, level, q_near, above_m=above_m)
        except GraspUnreachableError as error:
            self._heed(("unreachable", error.message))
            return None

    def _descend(self, t: float) -> None:
        if self._joints(t, _OPEN):
            self._motion = Quintic(*[self._motion.at(t)[0]] * 2, 1.0)
            self._enter("close")

    def _close(self, t: float) -> None:
        self._joints(t, _CLOSED)
        # The lift is gated on what the fingers feel, not on a clock.
        if float(self._pinch.min()) > _GRIPPED * self._config.impedance.pinch_n:
            self._engage()
        else:
            self._heed(self._monitor.closing(self._gaps_m(), self._pinch, t))

    def _open(self, t: float) -> None:
        if self._joints(t, _OPEN):
            q = self.world.q
            q_above = self._grasp(q, above_m=_RETREAT_M)
            if q_above is not None:
                self._motion = self._travel(q, q_above)
                self._enter("retreat")

    def _retreat(self, t: float) -> None:
        if self._joints(t, _OPEN):
            self._enter("done")

    def _stop(self, t: float) -> None:
        self._joints(t, _OPEN if self._stop_opens else _CLOSED)
        if t > self._motion.duration_s + _STOPPED_S:
            self._enter("done")

    def _done(self, t: float) -> None:
        self._joints(self._motion.duration_s, _CLOSED if self.fault and not self._stop_opens else _OPEN)

    def _gaps_m(self) -> Array:
        """Return the gap between the fingers of each hand (2,) [m], from their encoders."""
        return 2.0 * FINGER_TRAVEL_M * self.world.gripper

    # Phases under object impedance -----------------------------------------------------------------------

    def _engage(self) -> None:
        """Both hands have closed: fix the law, plan the path, begin to squeeze."""
        world, impedance, sensing = self.world, self._config.impedance, self._config.sensing
        T_object = self._resting.T_world_object
        try:
            path = self._plan(T_object)
        except GraspUnreachableError as error:
            self._heed(("unreachable", error.message))
            return
        grasp = tuple(inverse(T_object) @ T for T in self._kinematics.tcp_poses(world.q))
        rod = self._scene.rod
        held = HeldObject(rod.mass_kg, np.diag(rod.inertia_kg_m2), grasp, np.array([0.0, 1.0, 0.0]))  # type: ignore[arg-type]
        gains = ImpedanceGains(
            stiffness=(impedance.stiffness_n_per_m,) * 3 + (impedance.stiffness_nm_per_rad,) * 3,
            damping_ratio=impedance.damping_ratio,
            internal_force_n=impedance.internal_force_n,
            force_gain=impedance.force_gain,
            force_correction_max_n=impedance.force_correction_max_n,
        )
        law = ObjectImpedance(self._kinematics, held, gains)
        law.engage(world.q)
        period = 1.0 / sensing.pose_rate_hz if sensing.pose_rate_hz > 0.0 else world.dt
        estimate = HeldEstimate(
            self._kinematics, world.q, T_object, delay_ticks=self._sensors.delay_ticks,
            least_gain=period / max(sensing.grasp_memory_s, period),
        )  # fmt: skip
        self._hold = _Hold(law, path, estimate, inverse(level_part(T_object)) @ T_object)
        self._enter("squeeze")

    def _plan(self, T_object: Array) -> ObjectPath:
        """Return the path from where the object lies to the goal, each segment as fast as the limits allow."""
        config, scene = self._config, self._scene
        x, y, z = T_object[:3, 3]
        level = level_part(T_object)
        yaw = float(np.arctan2(level[1, 0], level[0, 0]))
        gx, gy, goal_yaw = self._trial.goal
        high = z + scene.task.lift_height_m
        place, q = Waypoint((x, y, z), yaw, 0.0), self.world.q
        rest, landing = scene.rod.rest_height_m, config.pace.landing_m
        ends = [
            ((x, y, high), yaw, config.lift_s),
            ((gx, gy, high), goal_yaw, config.transport_s),
            ((gx, gy, rest + landing), goal_yaw, config.lower_s),
        ]
        if landing > 0.0:
            ends.append(((gx, gy, rest), goal_yaw, config.pace.landing_s))
        start, waypoints = place, []
        for xyz, direction, fixed_s in ends:
            end = Waypoint(xyz, direction, 0.0)
            planned_s, q = object_duration_s(scene, place, end, q, config.pace)
            waypoints.append(Waypoint(xyz, direction, planned_s if fixed_s is None else fixed_s))
            place = end
        return ObjectPath(start, waypoints)

    @property
    def _held(self) -> _Hold:
        if self._hold is None:
            raise RuntimeError(f"phase '{self.phase}' needs the object in both hands")
        return self._hold

    def _impedance(self, t_path: float, squeeze_n: float, *, steady: bool = False) -> bool:
        """Run the law for one step; return whether the object is still held."""
        world, hold, sample = self.world, self._held, self._reading.pose
        if sample is None:
            state = hold.estimate.update(world.q, world.v, None)
        else:
            state = hold.estimate.update(world.q, world.v, sample.T_world_object, sample.age_ticks)
        axis = state.T_world_object[:3, 1]
        felt = min(-float(axis @ self._forces[0]), float(axis @ self._forces[1]))
        self._desired = hold.desired(t_path)
        try:
            tau = hold.law.torque(
                world.q, world.v, state, self._desired,
                internal_force_n=squeeze_n, measured_internal_force_n=felt,
            )  # fmt: skip
        except SingularPostureError as error:
            self._heed(("singular", error.message))
            self._stop(0.0)  # the motors need a command in this step too
            return False
        self._command(tau, _CLOSED)
        if self._phase.name != "unload":
            self._watch(state, squeeze_n, felt, fresh=sample is not None, steady=steady)
        return self.fault is None

    def _watch(
        self, state: ObjectState, squeeze_n: float, felt_n: float, *, fresh: bool, steady: bool
    ) -> None:
        estimate, monitor = self._held.estimate, self._monitor
        self._heed(
            monitor.holding(self._pinch, self._gaps_m(), estimate.spread_m, tilt_rad(state.T_world_object))
        )
        self._ease(estimate.spread_m, felt_n)
        if fresh:
            self._heed(monitor.held_pose(estimate.innovation))
        if steady:
            self._heed(monitor.squeezing(squeeze_n, felt_n))

    def _ease(self, spread_m: float, felt_n: float) -> None:
        """Want less squeeze when the hands begin to slip along the object: it is smoother than expected.

        The squeeze is carried by friction, at most 2 mu times the pinch. What was felt as they began to slip is that
        limit; three quarters of it holds with a margin. The squeeze rises while the object still lies on the table, so
        a smooth one shows there.
        """
        if self._spread_m is None:
            self._spread_m = spread_m
        if abs(spread_m - self._spread_m) > self._config.faults.creep_m:
            least = _EASE_MARGIN * self._scene.task.internal_force_min_n
            self._squeeze_n = max(min(self._squeeze_n, least), min(self._squeeze_n, _EASED * felt_n))
            self._spread_m = spread_m

    def _squeeze(self, t: float) -> None:
        full = self._squeeze_n
        if (
            self._impedance(0.0, full * min(1.0, t / _SQUEEZE_RAMP_S))
            and t > _SQUEEZE_RAMP_S + _SQUEEZE_SETTLE_S
        ):
            self._enter("carry")

    def _carry(self, t: float) -> None:
        full, duration = self._squeeze_n, self._held.path.duration_s
        if self._impedance(t, full, steady=True) and t > duration + _LANDED_S:
            self._enter("unload")

    def _unload(self, t: float) -> None:
        remaining = max(0.0, 1.0 - t / _RELEASE_RAMP_S)
        full = self._squeeze_n
        if self._impedance(self._held.path.duration_s, full * remaining) and t > _RELEASE_RAMP_S:
            self._resting = RestingEstimate(self.estimate.T_world_object)
            self._hold = None
            q = self.world.q
            self._motion = Quintic(q, q, _OPENING_S)
            self._enter("open")
