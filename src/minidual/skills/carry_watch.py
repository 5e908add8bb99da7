"""Object estimate and fault detection of a carry, from encoders, motor torques and object sensors only."""

import math

import numpy as np

from minidual.config.control import CarryConfig
from minidual.control.impedance import ObjectState
from minidual.control.kernels import pressed, smooth
from minidual.control.object_estimate import HeldEstimate, RestingEstimate
from minidual.plant.protocol import ObjectSensors, Reading
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.faults import Fault, FaultMonitor
from minidual.tasks.task import tilt_rad

_GRIPPED = 0.9
_MOVED_M = 0.0005  # motion of the hands between two poses that the second must show
_COMPARE_S = 0.01
_CHECK_S = 0.004
_FORCES = {
    "the left hand's force": slice(3),
    "the right hand's force": slice(3, 6),
    "the pinch": slice(6, 8),
}
_SETTLING = 0.2  # least gain of a pose while hands close: the held estimate takes the result for five samples
_EASED = 0.75  # share of the force felt at slip onset, requested afterwards
_EASE_MARGIN = 1.25  # lower bound of that request in the air, relative to the task's need; on the table half of it


class CarryWatch:
    """Object sensing of one carry, also for controller C; of the world it reads joints, fingers and motor torques.

    Raises:
        RuntimeError: The first reading has no pose.
    """

    def __init__(
        self,
        world: World,
        kinematics: Kinematics,
        config: CarryConfig,
        sensors: ObjectSensors,
    ) -> None:
        self._world = world
        self._kinematics = kinematics
        self._config = config
        self._sensors = sensors
        self._body = world.scene.object
        self._width_m = 2.0 * world.scene.object.half_width_m
        faults = config.faults
        pinch_n = config.impedance.pinch_n
        self._monitor = FaultMonitor(faults, dt_s=world.dt, width_m=self._width_m, pinch_n=pinch_n)
        self._reading: Reading = sensors.sense()
        if self._reading.pose is None:
            raise RuntimeError("the first reading of the sensors holds a pose")
        self._now_s = self._sensed_s = self._posed_s = world.time
        self._raw = np.concatenate([self._reading.hand_forces.ravel(), self._reading.pinch])
        self._felt = np.nan_to_num(self._raw)
        self._pinch = self._felt[6:]  # a view
        self._period_s = 1.0 / config.sensing.pose_rate_hz  # of poses
        self._odd_n = 0
        self._forces_s = world.time
        self._gripped_s = 0.0
        self._check_s = 0.0
        self._odd_max_n = round(faults.persistence_s / world.dt)
        self._creep_m = faults.creep_m
        self._felt_max_s = sensors.delay_ticks * world.dt + faults.sensor_age_max_s
        self._posed_max_s = self._felt_max_s + self._period_s
        self._posed = self._reading.pose.T_world_object.tobytes()
        self._compared = (self._raw.tolist(), world.time)
        share = world.dt / (config.sensing.force_filter_s + world.dt)
        self._filter = self._raw, self._felt, share, faults.force_glitch_n
        self._resting = RestingEstimate(self._reading.pose.T_world_object)
        self._held: HeldEstimate | None = None
        self._spread_m: float | None = None
        self._felt_n = 0.0
        self._squeeze_n = config.impedance.internal_force_n
        self._least_n = 0.5 * _EASE_MARGIN * world.scene.task.internal_force_min_n
        self.grip_limit_n = math.inf
        """Internal force [N] that friction carries, learnt at slip onset."""
        self.shifted = False
        """Whether the untouched object was shifted, and followed."""

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
        return min(self._pinch.tolist()) > _GRIPPED * self._config.impedance.pinch_n

    @property
    def squeeze_n(self) -> float:
        """Requested internal force [N]; reduced on slip."""
        wanted_n = self._squeeze_n
        most_n = self.grip_limit_n
        return wanted_n if wanted_n < most_n else most_n

    @property
    def lost_arms(self) -> tuple[int, ...]:
        """Arms with lost motors."""
        return tuple(int(arm) for arm in np.flatnonzero(self._monitor.lost))

    def read(self) -> tuple[ObjectState, float]:
        """See `ObjectSensor`."""
        return self.estimate if self._held is None else self._held.state, self._felt_n

    # Updates -----------------------------------------------------------------------------------------------

    def sense(self) -> None:
        """Read and filter the sensors; call once a control step."""
        world = self._world
        held = self._held
        self._now_s = now_s = world.time
        if now_s > self._sensed_s:  # the constructor sensed the first step
            self._reading = self._sensors.sense()
        pose, hand_forces, pinch, stamp_s = self._reading
        if pose is not None:
            if np.isfinite(pose.T_world_object).all():
                self._posed_s = now_s - pose.age_ticks * world.dt
            else:
                pose = None
                self._reading = self._reading._replace(pose=None)
        T = (
            self._resting if held is None else held.update(world.q, world.v, *(pose or (None, 0)))
        ).T_world_object
        odd, self._felt_n = smooth(
            hand_forces,
            pinch,
            *self._filter,
            self._odd_n < self._odd_max_n,
            T,
        )
        self._odd_n = self._odd_n + 1 if odd else 0
        self._forces_s = stamp_s if odd < 2 else self._forces_s

    def take_hold(self) -> None:
        """From now on, estimate an object that follows the hands."""
        world = self._world
        sensing = self._config.sensing
        self._held = HeldEstimate(
            self._kinematics,
            world.q,
            self._resting.T_world_object,
            delay_ticks=self._sensors.delay_ticks,
            least_gain=self._period_s / max(sensing.grasp_memory_s, self._period_s),
        )
        self._held.update(world.q, world.v)
        self._felt_n = pressed(self._felt, self.T_world_object)

    def lift(self) -> None:
        """From now on, keep what the task needs of the squeeze, and count slip anew: on the table it was a test."""
        self._least_n = 2.0 * self._least_n
        self._monitor.spread_m = None
        self.grip_limit_n = max(self.grip_limit_n, self._least_n)

    def let_go(self) -> None:
        """From now on, estimate an object at rest."""
        self._resting = RestingEstimate(self.T_world_object)
        self._held = None

    # Faults ------------------------------------------------------------------------------------------------

    def sensors(self, *, moving: bool) -> Fault | None:
        """Check that poses and forces arrive and, while a held object moves, change."""
        now_s = self._now_s
        pose = self._reading.pose
        if pose is None and now_s < self._check_s:
            return None
        before, compared_s = self._compared
        self._check_s = min(now_s + _CHECK_S, compared_s + _COMPARE_S)
        posed_s = now_s - self._posed_s
        felt_s = now_s - self._forces_s
        compare = now_s - compared_s >= _COMPARE_S
        monitor = self._monitor
        held = self._held
        found = monitor.silent("pose", posed_s, self._posed_max_s)
        found = found or monitor.silent("usable force", felt_s, self._felt_max_s)
        if pose is not None:
            posed = pose.T_world_object.tobytes()
            same = posed == self._posed
            self._posed = posed
            if held is not None and moving:
                found = found or monitor.frozen("the pose", same and held.moved_m > _MOVED_M, 2)
        if compare:
            raw = self._raw.tolist()
            same = [a == b for a, b in zip(raw, before, strict=True)]
            self._compared = (raw, now_s)
            for name, part in _FORCES.items():
                found = found or monitor.frozen(name, moving and any(same[part]), 3)
        return found

    def resting(self, *, follow: bool) -> Fault | None:
        """Average a pose of the untouched object; check it, or `follow` where it was shifted."""
        if self._reading.pose is None:
            return None
        now = self._reading.pose.T_world_object
        before = self.T_world_object
        self._resting.add(now)
        found = self._monitor.resting(self._resting.innovation)
        if (
            found is not None
            and follow
            and abs(now[2, 3] - before[2, 3]) < self._config.faults.displaced_m
        ):
            found = None
            self._resting = RestingEstimate(now)
            self.shifted = True
        return found

    def closing(self, t_s: float) -> Fault | None:
        """Check closing hands; follow the object."""
        if self._reading.pose is not None:
            self._resting.add(self._reading.pose.T_world_object, _SETTLING)
        return self._monitor.closing(self._world.gaps_m, self._pinch, t_s)

    def holding(self, *, steady: bool) -> Fault | None:
        """Check a held object, reducing the internal force on slip; `steady` also checks that force."""
        estimate = self._held
        monitor = self._monitor
        if estimate is None:
            return None
        tilt = tilt_rad(estimate.state.T_world_object, self._body)
        spread_m = estimate.spread_m
        found = monitor.holding(self._pinch.tolist(), self._world.gaps_m, spread_m, tilt)
        if self._spread_m is None or abs(spread_m - self._spread_m) > self._creep_m:
            self._ease(spread_m)
        odd = None if self._reading.pose is None else monitor.held_pose(estimate.innovation)
        return found or odd or (monitor.squeezing(self.squeeze_n, self._felt_n) if steady else None)

    def grippers(self, told: str) -> Fault | None:
        """Check every 4 ms the motion of hands that are told to "open", to "close", or neither ("")."""
        now_s = self._now_s
        if now_s - self._gripped_s < _CHECK_S:
            return None
        self._gripped_s = now_s
        margin_m = self._config.faults.gap_margin_m
        target_m = (
            2.0 * self._world.robot.hand.travel_m - margin_m
            if told == "open"
            else self._width_m + margin_m
        )
        return self._monitor.grippers(
            now_s,
            told,
            self._world.gaps_m,
            self._pinch.tolist(),
            target_m,
        )

    def motors(self, told: Array) -> Fault | None:
        """Compare commanded torques (n,) [Nm] with applied ones."""
        return self._monitor.motors(told, self._world.tau)

    def _ease(self, spread_m: float) -> None:
        """Reduce the internal force when the hands begin to slip; in the air to no less than the task needs.

        The force felt then is what friction carries, 2 mu times the pinch.
        """
        if self._spread_m is not None:
            wanted_n = self.squeeze_n
            self.grip_limit_n = max(
                min(wanted_n, self._least_n),
                min(wanted_n, _EASED * self._felt_n),
            )
        self._spread_m = spread_m
