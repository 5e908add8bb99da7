"""Object estimate and fault detection of a carry, from encoders, motor torques and object sensors only."""

from __future__ import annotations

import math

import numpy as np

from minidual.config.control import CarryConfig
from minidual.control.object_estimate import HeldEstimate, RestingEstimate
from minidual.control.object_impedance import ObjectState
from minidual.plant.protocol import ObjectSensors, Reading
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.faults import Fault, FaultMonitor
from minidual.tasks.rod_carry import tilt_rad

_GRIPPED = 0.9
_EASED = 0.75
"""Share of the force felt at slip onset, requested afterwards."""
_EASE_MARGIN = 1.1
"""Lower bound of that request, relative to the task's need."""


class CarryWatch:
    """Object sensing of one carry, also for controller C; of the world it reads joints, fingers and motor torques.

    Raises:
        RuntimeError: The first reading has no pose.
    """

    def __init__(self, world: World, kinematics: Kinematics, config: CarryConfig, sensors: ObjectSensors) -> None:
        self._world, self._kinematics, self._config, self._sensors = world, kinematics, config, sensors
        self._monitor = FaultMonitor(
            config.faults,
            dt_s=world.dt,
            width_m=2.0 * world.scene.object.half_width_m,
            pinch_n=config.impedance.pinch_n,
        )
        self._reading: Reading = sensors.sense()
        if self._reading.pose is None:
            raise RuntimeError("the first reading of the sensors holds a pose")
        self._sensed_s = world.time
        self._forces, self._pinch = self._reading.hand_forces.copy(), self._reading.pinch.copy()
        self._filter_share = world.dt / (config.sensing.force_filter_s + world.dt)
        self._resting = RestingEstimate(self._reading.pose.T_world_object)
        self._held: HeldEstimate | None = None
        self._spread_m: float | None = None
        self._felt_n = 0.0
        self.grip_limit_n = math.inf
        """Internal force [N] that friction carries, learnt at slip onset."""

    # Estimates ---------------------------------------------------------------------------------------------

    @property
    def T_world_object(self) -> Array:
        """Estimated object pose (4, 4)."""
        return self.estimate.T_world_object

    @property
    def estimate(self) -> ObjectState:
        """Estimated object motion."""
        return ObjectState(self._resting.T_world_object) if self._held is None else self._held.state

    @property
    def gripped(self) -> bool:
        """Whether both hands pinch enough."""
        return float(self._pinch.min()) > _GRIPPED * self._config.impedance.pinch_n

    @property
    def squeeze_n(self) -> float:
        """Requested internal force [N]; reduced on slip."""
        return min(self._config.impedance.internal_force_n, self.grip_limit_n)

    @property
    def lost_arms(self) -> tuple[int, ...]:
        """Arms with lost motors."""
        return tuple(int(arm) for arm in np.flatnonzero(self._monitor.lost))

    def read(self) -> tuple[ObjectState, float]:
        """Return the object's state and measured internal force [N]."""
        return self.estimate, self._felt_n

    # Updates -----------------------------------------------------------------------------------------------

    def sense(self) -> None:
        """Read and filter the sensors; call once a control step."""
        world = self._world
        if world.time > self._sensed_s:  # the constructor sensed the first step
            self._reading = self._sensors.sense()
        reading, share = self._reading, self._filter_share
        self._forces += share * (reading.hand_forces - self._forces)
        self._pinch += share * (reading.pinch - self._pinch)
        if self._held is not None:
            pose = reading.pose
            sample = (None, 0) if pose is None else (pose.T_world_object, pose.age_ticks)
            self._held.update(world.q, world.v, *sample)
            self._feel()

    def take_hold(self) -> None:
        """From now on, estimate an object that follows the hands."""
        world, sensing = self._world, self._config.sensing
        period = 1.0 / sensing.pose_rate_hz if sensing.pose_rate_hz > 0.0 else world.dt
        self._held = HeldEstimate(
            self._kinematics,
            world.q,
            self._resting.T_world_object,
            delay_ticks=self._sensors.delay_ticks,
            least_gain=period / max(sensing.grasp_memory_s, period),
        )
        self._held.update(world.q, world.v, None)
        self._feel()

    def let_go(self) -> None:
        """From now on, estimate an object at rest."""
        self._resting = RestingEstimate(self.T_world_object)
        self._held = None

    # Faults ------------------------------------------------------------------------------------------------

    def resting(self) -> Fault | None:
        """Average a pose of the untouched object; check it."""
        if self._reading.pose is None:
            return None
        self._resting.add(self._reading.pose.T_world_object)
        return self._monitor.resting(self._resting.innovation)

    def closing(self, t_s: float) -> Fault | None:
        """Check closing hands."""
        return self._monitor.closing(self._gaps_m(), self._pinch, t_s)

    def holding(self, *, steady: bool) -> Fault | None:
        """Check a held object, reducing the internal force on slip; `steady` also checks that force."""
        estimate, monitor = self._held, self._monitor
        if estimate is None:
            return None
        tilt = tilt_rad(estimate.state.T_world_object)
        found = [monitor.holding(self._pinch, self._gaps_m(), estimate.spread_m, tilt)]
        self._ease(estimate.spread_m)
        if self._reading.pose is not None:
            found.append(monitor.held_pose(estimate.innovation))
        if steady:
            found.append(monitor.squeezing(self.squeeze_n, self._felt_n))
        return next((fault for fault in found if fault is not None), None)

    def motors(self, told: Array) -> Fault | None:
        """Compare commanded torques (n,) [Nm] with the applied ones."""
        return self._monitor.motors(told, self._world.tau)

    def _gaps_m(self) -> Array:
        return 2.0 * self._world.robot.hand.travel_m * self._world.gripper

    def _feel(self) -> None:
        """Measure the internal force."""
        left, right = self._forces.dot(self.T_world_object[:3, 1]).tolist()
        self._felt_n = float(np.minimum(-left, right))  # Python's min could drop a NaN

    def _ease(self, spread_m: float) -> None:
        """Reduce the internal force when the hands begin to slip.

        The force felt then is what friction carries, 2 mu times the pinch. It rises on the table, so low
        friction shows there.
        """
        if self._spread_m is None:
            self._spread_m = spread_m
        if abs(spread_m - self._spread_m) > self._config.faults.creep_m:
            wanted = self.squeeze_n
            least = _EASE_MARGIN * self._world.scene.task.internal_force_min_n
            self.grip_limit_n = max(min(wanted, least), min(wanted, _EASED * self._felt_n))
            self._spread_m = spread_m
