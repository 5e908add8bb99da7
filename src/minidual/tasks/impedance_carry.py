"""Carry the rod under object impedance: approach, grasp, squeeze, lift, carry, lower, release, retreat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.config.control import CarryConfig
from minidual.control.gripper import Grippers
from minidual.control.joint_control import ComputedTorque
from minidual.control.object_impedance import HeldObject, ImpedanceGains, ObjectImpedance, ObjectState
from minidual.control.object_path import ObjectPath, Waypoint
from minidual.robot.constants import Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse
from minidual.sim.world import World
from minidual.tasks.reach import Quintic, approach_postures, grasp_posture
from minidual.tasks.rod_carry import RodTrial, level_part, tilt_rad

_OPEN, _CLOSED = np.ones(2), np.zeros(2)
_GRASP_TIMEOUT_S = 1.5
_SQUEEZE_RAMP_S = 0.4
_RELEASE_RAMP_S = 0.25
_ABORT_TILT_RAD = 0.35


@dataclass(frozen=True)
class _Phase:
    name: str
    began_s: float


@dataclass(frozen=True)
class _Hold:
    """What is fixed when both hands have closed: the law, the object's path, and the roll it lay at."""

    law: ObjectImpedance
    path: ObjectPath
    T_level_rod: Array

    def desired(self, t_s: float) -> ObjectState:
        state = self.path.at(t_s)
        return ObjectState(state.T_world_object @ self.T_level_rod, state.twist, state.acceleration)


class ImpedanceCarry:
    """One trial under object impedance; call `step` until `done`.

    Args:
        world: The plant, already reset.
        kinematics: Workspace.
        config: Speeds and gains.
        trial: Start and goal.
    """

    name = "impedance"

    def __init__(self, world: World, kinematics: Kinematics, config: CarryConfig, trial: RodTrial) -> None:
        self.world, self._config, self._trial = world, config, trial
        self._kinematics = kinematics
        scene = world.scene
        self._scene = scene
        self._joint = ComputedTorque(kinematics)
        self._grippers = Grippers(scene, world.dt, pinch_force_n=config.impedance.pinch_n)
        level = level_part(world.T_world_rod)
        self._q_over, self._q_grasp = approach_postures(scene, level)
        self._motion = Quintic(world.q, self._q_over, 1.2)
        self._phase = _Phase("approach", world.time)
        self._hold: _Hold | None = None
        self.aborted: str | None = None

    @property
    def phase(self) -> str:
        """Name of the phase the trial is in."""
        return self._phase.name

    @property
    def done(self) -> bool:
        """Return whether the cycle is over, aborted or not."""
        return self._phase.name == "done"

    def _enter(self, name: str) -> None:
        self._phase = _Phase(name, self.world.time)

    def _abort(self, reason: str) -> None:
        """Stop softly: hold the posture and open the hands; the rod is lost, the arms are not."""
        self.aborted = f"{reason} at {self.world.time:.2f} s"
        self._motion = Quintic(self.world.q, self.world.q, 1.0)
        self._hold = None
        self._enter("aborted")

    def step(self) -> None:
        """Run one control and physics step."""
        t = self.world.time - self._phase.began_s
        getattr(self, f"_{self._phase.name}")(t)
        self.world.step()

    # Phases in joint space -------------------------------------------------------------------------------

    def _joints(self, t: float, gripper: Array) -> bool:
        world = self.world
        tau = self._joint.torque(world.q, world.v, *self._motion.at(t))
        world.command(tau, self._grippers.step(gripper))
        return t >= self._motion.duration_s

    def _approach(self, t: float) -> None:
        if self._joints(t, _OPEN):
            self._motion = Quintic(self._motion.q1, self._q_grasp, 0.7)
            self._enter("descend")

    def _descend(self, t: float) -> None:
        if self._joints(t, _OPEN):
            self._motion = Quintic(self._motion.q1, self._motion.q1, 1.0)
            self._enter("close")

    def _close(self, t: float) -> None:
        self._joints(t, _CLOSED)
        # The lift is gated on what the fingers feel, not on a clock.
        if float(self.world.pinch_forces().min()) > 0.9 * self._config.impedance.pinch_n:
            self._engage()
        elif t > _GRASP_TIMEOUT_S:
            self._abort(
                f"missed grasp: pinch {self.world.pinch_forces().round(1).tolist()} N after {_GRASP_TIMEOUT_S} s"
            )

    def _open(self, t: float) -> None:
        if self._joints(t, _OPEN):
            q_away = grasp_posture(
                self._scene, level_part(self.world.T_world_rod), self.world.q, above_m=0.10
            )
            self._motion = Quintic(self.world.q, q_away, 0.8)
            self._enter("retreat")

    def _retreat(self, t: float) -> None:
        if self._joints(t, _OPEN):
            self._enter("done")

    def _aborted(self, t: float) -> None:
        if self._joints(t, _OPEN):
            self._enter("done")

    def _done(self, t: float) -> None:
        self._joints(self._motion.duration_s, _OPEN)

    # Phases under object impedance -----------------------------------------------------------------------

    def _engage(self) -> None:
        world, impedance = self.world, self._config.impedance
        T_world_rod = world.T_world_rod
        grasp = tuple(inverse(T_world_rod) @ T for T in self._kinematics.tcp_poses(world.q))
        rod = self._scene.rod
        across = rod.mass_kg * (3 * rod.radius_m**2 + rod.length_m**2) / 12.0
        along = 0.5 * rod.mass_kg * rod.radius_m**2
        held = HeldObject(rod.mass_kg, np.diag([across, along, across]), grasp, np.array([0.0, 1.0, 0.0]))  # type: ignore[arg-type]
        gains = ImpedanceGains(
            stiffness=(impedance.stiffness_n_per_m,) * 3 + (impedance.stiffness_nm_per_rad,) * 3,
            damping_ratio=impedance.damping_ratio,
            internal_force_n=impedance.internal_force_n,
            force_gain=impedance.force_gain,
            force_correction_max_n=impedance.force_correction_max_n,
        )
        law = ObjectImpedance(self._kinematics, held, gains)
        law.engage(world.q)
        x, y, z = T_world_rod[:3, 3]
        level = level_part(T_world_rod)
        yaw = float(np.arctan2(level[1, 0], level[0, 0]))
        gx, gy, gyaw = self._trial.goal
        high = z + self._scene.task.lift_height_m
        c = self._config
        path = ObjectPath(
            Waypoint((x, y, z), yaw, 0.0),
            [
                Waypoint((x, y, high), yaw, c.lift_s),
                Waypoint((gx, gy, high), gyaw, c.transport_s),
                Waypoint((gx, gy, rod.radius_m), gyaw, c.lower_s),
            ],
        )
        self._hold = _Hold(law, path, inverse(level) @ T_world_rod)  # a cylinder may have rolled
        self._enter("squeeze")

    @property
    def _held(self) -> _Hold:
        if self._hold is None:
            raise RuntimeError(f"phase '{self.phase}' needs the rod in both hands")
        return self._hold

    def _impedance(self, t_path: float, squeeze_n: float) -> None:
        world, hold = self.world, self._held
        measured = ObjectState(world.T_world_rod, world.rod_twist)
        tau = hold.law.torque(
            world.q, world.v, measured, hold.desired(t_path),
            internal_force_n=squeeze_n, measured_internal_force_n=world.internal_force(),
        )  # fmt: skip
        world.command(tau, self._grippers.step(_CLOSED))
        if tilt_rad(measured.T_world_object) > _ABORT_TILT_RAD:
            self._abort(f"rod tilted {np.degrees(tilt_rad(measured.T_world_object)):.0f} deg")
        elif self._phase.name == "carry" and float(world.pinch_forces().max()) == 0.0:
            self._abort("rod lost: no contact at either hand")

    def _squeeze(self, t: float) -> None:
        self._impedance(0.0, self._config.impedance.internal_force_n * min(1.0, t / _SQUEEZE_RAMP_S))
        if t > _SQUEEZE_RAMP_S + 0.1 and not self.aborted:
            self._enter("carry")

    def _carry(self, t: float) -> None:
        duration = self._held.path.duration_s
        self._impedance(t, self._config.impedance.internal_force_n)
        if t > duration + 0.15 and not self.aborted:
            self._enter("unload")

    def _unload(self, t: float) -> None:
        remaining = max(0.0, 1.0 - t / _RELEASE_RAMP_S)
        self._impedance(self._held.path.duration_s, self._config.impedance.internal_force_n * remaining)
        if t > _RELEASE_RAMP_S and not self.aborted:
            self._motion = Quintic(self.world.q, self.world.q, 0.45)
            self._enter("open")
