"""Object estimate of a carry, from encoders and object sensors only."""

from typing import NamedTuple

import numpy as np

from minidual.config.control import CarryConfig
from minidual.control.impedance import ObjectState
from minidual.plant.protocol import ObjectSensors, Plant, Reading
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.object_estimate import HeldEstimate, RestingEstimate
from minidual.skills.object_kernels import pressed, smooth


class _ForceFilter(NamedTuple):
    """Arguments of `smooth`: hand forces (6,) and pinches (2,), each array (8,) [N]."""

    raw: Array
    felt: Array
    share: float
    glitch_n: float


class CarrySensing:
    """Filtered readings and estimated motion of the object.

    Of the plant it reads time and joints.

    Attributes:
        reading: Last reading; a pose that is not finite is None.
        raw: Last hand forces (6,) and pinches (2,) [N], unfiltered.
        pinch: Filtered pinches (2,) [N].
        felt_n: Filtered internal force.
        now_s: Time of the last call of `sense`.
        posed_s: Sampling time of the last usable pose.
        forces_s: Sampling time of the last usable forces.
        resting: Estimate of the object at rest.
        held: Estimate of the held object; None while no hand holds it.

    Raises:
        RuntimeError: The first reading has no pose.
    """

    def __init__(
        self,
        plant: Plant,
        kinematics: Kinematics,
        config: CarryConfig,
        sensors: ObjectSensors,
    ) -> None:
        self._plant = plant
        self._kinematics = kinematics
        self._sensors = sensors
        self._period_s = 1.0 / config.sensing.pose_rate_hz
        self._memory_s = config.sensing.grasp_memory_s
        self.reading: Reading = sensors.sense()
        if self.reading.pose is None:
            raise RuntimeError("the first reading of the sensors holds a pose")
        now_s = plant.time
        self.now_s = now_s
        self.posed_s = now_s
        self.forces_s = now_s
        self._sensed_s = now_s
        self.raw = np.concatenate([self.reading.hand_forces.ravel(), self.reading.pinch])
        felt = np.nan_to_num(self.raw)
        self.pinch = felt[6:]  # a view
        self.felt_n = 0.0
        share = plant.dt / (config.sensing.force_filter_s + plant.dt)
        self._filter = _ForceFilter(self.raw, felt, share, config.faults.force_glitch_n)
        self._glitches = 0
        self._glitches_max = round(config.faults.persistence_s / plant.dt)
        self.resting = RestingEstimate(self.reading.pose.T_world_object)
        self.held: HeldEstimate | None = None

    @property
    def delay_s(self) -> float:
        """Age of an arriving pose [s]."""
        return self._sensors.delay_ticks * self._plant.dt

    @property
    def period_s(self) -> float:
        """Time between two poses [s]."""
        return self._period_s

    @property
    def T_world_object(self) -> Array:
        """Estimated object pose (4, 4)."""
        if self.held is None:
            return self.resting.T_world_object
        return self.held.state.T_world_object

    @property
    def estimate(self) -> ObjectState:
        """Estimated object motion."""
        if self.held is None:
            return ObjectState(self.resting.T_world_object)
        return self.held.state

    def sense(self) -> None:
        """Read and filter the sensors; to be called once a control step."""
        self.now_s = self._plant.time
        if self.now_s > self._sensed_s:  # the constructor sensed the first step
            self.reading = self._sensors.sense()
        self._take_pose()
        self._take_forces()

    def _take_pose(self) -> None:
        """Drop a pose that is not finite; update the estimate of a held object."""
        plant = self._plant
        pose = self.reading.pose
        if pose is not None:
            if np.isfinite(pose.T_world_object).all():
                sampled_s = self.now_s - pose.age_ticks * plant.dt
                self.posed_s = max(self.posed_s, sampled_s)  # the first poses may be from before
            else:
                pose = None
                self.reading = self.reading._replace(pose=None)
        if self.held is None:
            return
        if pose is None:
            self.held.update(plant.q, plant.v)
        else:
            self.held.update(plant.q, plant.v, pose.T_world_object, pose.age_ticks)

    def _take_forces(self) -> None:
        """Filter forces and pinches; glitches are left out until they last."""
        reading = self.reading
        patient = self._glitches < self._glitches_max
        oddness, self.felt_n = smooth(
            reading.hand_forces,
            reading.pinch,
            *self._filter,
            patient,
            self.T_world_object,
        )
        is_glitch = oddness > 0
        is_finite = oddness < 2
        self._glitches = self._glitches + 1 if is_glitch else 0
        if is_finite:
            self.forces_s = reading.stamp_s

    def take_hold(self) -> None:
        """From now on, estimate an object that follows the hands."""
        plant = self._plant
        self.held = HeldEstimate(
            self._kinematics,
            plant.q,
            self.resting.T_world_object,
            delay_ticks=self._sensors.delay_ticks,
            least_gain=self._period_s / max(self._memory_s, self._period_s),
        )
        self.held.update(plant.q, plant.v)
        self.felt_n = pressed(self._filter.felt, self.T_world_object)

    def let_go(self) -> None:
        """From now on, estimate an object at rest."""
        self.resting = RestingEstimate(self.T_world_object)
        self.held = None

    def restart(self, T_world_object: Array) -> None:
        """Forget the poses of a resting object before this one (4, 4)."""
        self.resting = RestingEstimate(T_world_object)
