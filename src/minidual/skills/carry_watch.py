"""What a carry knows of the object from sensed quantities, and what it finds wrong.

    sense()    once a control step: take in what arrives, filter the forces, move the estimate on
    read()     what controller C is told of the object
    others     findings (skills/faults.py), each for the phases in which it applies

The true state is not read: joints and fingers come from encoders, motor torques from the drives, pose and contact
forces through `plant/sensing.py`.
"""

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
from minidual.skills.faults import FaultMonitor, Finding
from minidual.tasks.rod_carry import tilt_rad

_GRIPPED = 0.9
_EASED = 0.75
"""Share of the squeeze felt as the hands began to slip that is wanted from then on."""
_EASE_MARGIN = 1.1
"""Squeeze over what the task needs below which it is not eased: a grip that slips even then is lost."""


class CarryWatch:
    """The senses of one carry; the object sensor of its controller C.

    Args:
        world: Joints and fingers are read from it, the object never.
        kinematics: Workspace.
        config: Sensing, gains, limits of the faults.
        sensors: What senses the object.

    Raises:
        RuntimeError: The first reading of the sensors holds no pose.
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
        """Largest squeeze [N] that friction carries, as learnt from hands that began to slip."""

    # What is known -----------------------------------------------------------------------------------------

    @property
    def T_world_object(self) -> Array:
        """Pose (4, 4) at which the object is believed to be."""
        return self.estimate.T_world_object

    @property
    def estimate(self) -> ObjectState:
        """How the object is believed to move."""
        return ObjectState(self._resting.T_world_object) if self._held is None else self._held.state

    @property
    def held(self) -> bool:
        """Whether the object is taken to move with the hands."""
        return self._held is not None

    @property
    def gripped(self) -> bool:
        """Whether both hands feel the pinch that a lift needs."""
        return float(self._pinch.min()) > _GRIPPED * self._config.impedance.pinch_n

    @property
    def squeeze_n(self) -> float:
        """Internal force [N] that is wanted once the squeeze is complete; it falls when the hands slip."""
        return min(self._config.impedance.internal_force_n, self.grip_limit_n)

    @property
    def lost_arms(self) -> tuple[int, ...]:
        """Arms whose motors were found not to give what they were told."""
        return tuple(int(arm) for arm in np.flatnonzero(self._monitor.lost))

    def read(self) -> tuple[ObjectState, float]:
        """Return the object's state and the internal force that is felt [N], as of the last `sense`."""
        return self.estimate, self._felt_n

    # What happens ------------------------------------------------------------------------------------------

    def sense(self) -> None:
        """Take in what the sensors deliver at this control step."""
        world = self._world
        if world.time > self._sensed_s:  # the constructor has sensed the first step already
            self._reading = self._sensors.sense()
        reading, share = self._reading, self._filter_share
        self._forces += share * (reading.hand_forces - self._forces)
        self._pinch += share * (reading.pinch - self._pinch)
        if self._held is not None:
            if reading.pose is None:
                self._held.update(world.q, world.v, None)
            else:
                self._held.update(world.q, world.v, reading.pose.T_world_object, reading.pose.age_ticks)
            self._feel()

    def take_hold(self) -> None:
        """Believe from now on that the object moves with the hands."""
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
        """Believe from now on that the object lies where it is."""
        self._resting = RestingEstimate(self.T_world_object)
        self._held = None

    # What is found wrong -----------------------------------------------------------------------------------

    def resting(self) -> Finding:
        """Take a fresh pose into the mean of an object that nobody has touched, and judge it."""
        if self._reading.pose is None:
            return None
        self._resting.add(self._reading.pose.T_world_object)
        return self._monitor.resting(self._resting.innovation)

    def closing(self, t_s: float) -> Finding:
        """Judge hands that have been closing for a time [s]."""
        return self._monitor.closing(self._gaps_m(), self._pinch, t_s)

    def holding(self, *, steady: bool) -> Finding:
        """Judge a held object, and ease the squeeze when the hands begin to slip; `steady`: it is complete."""
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
        return next((finding for finding in found if finding is not None), None)

    def motors(self, told: Array, applied: Array) -> Finding:
        """Compare torques (n,) [Nm] told and given in the last step."""
        return self._monitor.motors(told, applied)

    def _gaps_m(self) -> Array:
        """Return the gap between the fingers of each hand (2,) [m], from their encoders."""
        return 2.0 * self._world.robot.hand.travel_m * self._world.gripper

    def _feel(self) -> None:
        """Find the internal force: the smaller of the hands' forces towards each other along the object."""
        left, right = self._forces.dot(self.T_world_object[:3, 1]).tolist()
        self._felt_n = float(np.minimum(-left, right))  # Python's min would drop a NaN of the right hand

    def _ease(self, spread_m: float) -> None:
        """Want less squeeze when the hands begin to slip along the object: it is smoother than expected.

        The squeeze is carried by friction, at most 2 mu times the pinch. What was felt as they began to slip is that
        limit; three quarters of it holds with a margin. The squeeze rises while the object still lies on the table, so
        a smooth one shows there.
        """
        if self._spread_m is None:
            self._spread_m = spread_m
        if abs(spread_m - self._spread_m) > self._config.faults.creep_m:
            wanted = self.squeeze_n
            least = _EASE_MARGIN * self._world.scene.task.internal_force_min_n
            self.grip_limit_n = max(min(wanted, least), min(wanted, _EASED * self._felt_n))
            self._spread_m = spread_m
