"""Faults of a carry, from encoders, motor torques and object sensors only."""

from minidual.config.control import CarryConfig
from minidual.config.scene import SceneConfig
from minidual.control.impedance import ObjectState
from minidual.plant.protocol import ObjectSensors, Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.carry_sensing import CarrySensing
from minidual.skills.faults import Fault, FaultMonitor, Order
from minidual.skills.squeeze import Squeeze
from minidual.tasks.task import tilt_rad

_GRIPPED = 0.9
"""Share of the requested pinch that counts as gripped."""
_MOVED_M = 0.0005
"""Motion of the hands between two poses that must show in the second."""
_COMPARE_S = 0.01
_CHECK_S = 0.004
_FORCES = {
    "the left hand's force": slice(3),
    "the right hand's force": slice(3, 6),
    "the pinch": slice(6, 8),
}
"""Parts of the readings that a force sensor gives together."""
_SETTLING = 0.2
"""Least gain of a pose while hands close: the held estimate counts the result as five samples."""


class CarryWatch:
    """Sensing and fault detection of one carry, also the object sensor of controller C.

    Of the plant it reads joints, fingers and torques.

    Args:
        plant: What is driven.
        kinematics: Of the arms.
        scene: With the object.
        config: Of the carry.
        sensors: Of the object.

    Attributes:
        sensing: Filtered readings and estimated motion.
        squeeze: Requested internal force.
        grip_limit_n: Internal force that friction carries, learnt at the onset of slip.
        shifted: Whether the untouched object was shifted, and followed.

    Raises:
        RuntimeError: The first reading has no pose.
    """

    def __init__(
        self,
        plant: Plant,
        kinematics: Kinematics,
        scene: SceneConfig,
        config: CarryConfig,
        sensors: ObjectSensors,
    ) -> None:
        self._plant = plant
        self._body = scene.object
        self._width_m = 2.0 * scene.object.half_width_m
        self._faults = config.faults
        self._gripped_n = _GRIPPED * config.impedance.pinch_n
        self.sensing = CarrySensing(plant, kinematics, config, sensors)
        self.squeeze = Squeeze(
            config.impedance.internal_force_n,
            scene.task.internal_force_min_n,
            config.faults.creep_m,
        )
        self._monitor = FaultMonitor(
            config.faults,
            dt_s=plant.dt,
            width_m=self._width_m,
            pinch_n=config.impedance.pinch_n,
            left_n=plant.robot.dofs[0],
        )
        self.grip_limit_n = self.squeeze.limit_n
        self.shifted = False
        self._forces_age_max_s = self.sensing.delay_s + config.faults.sensor_age_max_s
        self._pose_age_max_s = self._forces_age_max_s + self.sensing.period_s
        self._next_check_s = 0.0
        self._grippers_checked_s = 0.0
        self._last_pose = self._pose_bytes()
        self._compared = self.sensing.raw.tolist()
        self._compared_s = plant.time

    # Estimates ---------------------------------------------------------------------------------

    @property
    def T_world_object(self) -> Array:
        """Estimated object pose (4, 4)."""
        return self.sensing.T_world_object

    @property
    def estimate(self) -> ObjectState:
        """Estimated object motion."""
        return self.sensing.estimate

    @property
    def gripped(self) -> bool:
        """Whether both hands pinch enough."""
        return min(self.sensing.pinch.tolist()) > self._gripped_n

    @property
    def _gaps_m(self) -> tuple[float, float]:
        """Distance between each hand's fingers [m]."""
        left, right = self._plant.fingers.tolist()
        return 2.0 * left, 2.0 * right

    @property
    def squeeze_n(self) -> float:
        """Requested internal force [N]; reduced on slip."""
        return self.squeeze.request_n

    def read(self) -> tuple[ObjectState, float]:
        """See `ObjectSensor`."""
        return self.sensing.estimate, self.sensing.felt_n

    def lift(self) -> None:
        """From now on, keep the squeeze that the task needs, and count slip from here.

        On the table the squeeze was a test.
        """
        self._monitor.spread_m = None
        self.squeeze.lift()
        self.grip_limit_n = self.squeeze.limit_n

    # Checks ------------------------------------------------------------------------------------

    def sensors(self, *, moving: bool) -> Fault | None:
        """Check that poses and forces arrive and, while a held object moves, change."""
        now_s = self.sensing.now_s
        has_pose = self.sensing.reading.pose is not None
        if not has_pose and now_s < self._next_check_s:
            return None
        self._next_check_s = min(now_s + _CHECK_S, self._compared_s + _COMPARE_S)
        fault = self._silent_sensor()
        if has_pose:
            fault = self._frozen_pose(fault, moving=moving)
        if now_s - self._compared_s >= _COMPARE_S:
            fault = self._frozen_forces(fault, moving=moving)
        return fault

    def _silent_sensor(self) -> Fault | None:
        sensing = self.sensing
        pose_age_s = sensing.now_s - sensing.posed_s
        forces_age_s = sensing.now_s - sensing.forces_s
        fault = self._monitor.silent("pose", pose_age_s, self._pose_age_max_s)
        if fault is not None:
            return fault
        return self._monitor.silent("usable force", forces_age_s, self._forces_age_max_s)

    def _pose_bytes(self) -> bytes:
        pose = self.sensing.reading.pose
        return b"" if pose is None else pose.T_world_object.tobytes()

    def _frozen_pose(self, fault: Fault | None, *, moving: bool) -> Fault | None:
        """Return the earlier fault, or that of a pose that does not change with the hands."""
        pose = self._pose_bytes()
        same = pose == self._last_pose
        self._last_pose = pose
        held = self.sensing.held
        if fault is not None or held is None or not moving:
            return fault
        return self._monitor.frozen("the pose", same and held.moved_m > _MOVED_M, 2)

    def _frozen_forces(self, fault: Fault | None, *, moving: bool) -> Fault | None:
        """Return the earlier fault, or that of readings that stay the same to the bit."""
        raw = self.sensing.raw.tolist()
        same = [a == b for a, b in zip(raw, self._compared, strict=True)]
        self._compared = raw
        self._compared_s = self.sensing.now_s
        for name, part in _FORCES.items():
            if fault is None:
                fault = self._monitor.frozen(name, moving and any(same[part]), 3)
        return fault

    def resting(self, *, follow: bool) -> Fault | None:
        """Average a pose of the untouched object; check it, or `follow` where it was shifted."""
        sensing = self.sensing
        if sensing.reading.pose is None:
            return None
        T = sensing.reading.pose.T_world_object
        before = sensing.T_world_object
        sensing.resting.add(T)
        fault = self._monitor.resting(sensing.resting.innovation)
        if fault is None:
            return None
        is_on_table = abs(T[2, 3] - before[2, 3]) < self._faults.displaced_m
        if not (follow and is_on_table):
            return fault
        sensing.restart(T)
        self.shifted = True
        return None

    def closing(self, t_s: float) -> Fault | None:
        """Check closing hands after a time [s] of closing; follow the object."""
        pose = self.sensing.reading.pose
        if pose is not None:
            self.sensing.resting.add(pose.T_world_object, _SETTLING)
        return self._monitor.closing(self._gaps_m, self.sensing.pinch, t_s)

    def holding(self, *, steady: bool) -> Fault | None:
        """Check a held object, reducing the internal force on slip; `steady` checks it, too."""
        sensing = self.sensing
        held = sensing.held
        monitor = self._monitor
        if held is None:
            return None
        tilt = tilt_rad(held.state.T_world_object, self._body)
        spread_m = held.spread_m
        fault = monitor.holding(sensing.pinch.tolist(), self._gaps_m, spread_m, tilt)
        self.squeeze.update(spread_m, sensing.felt_n)
        self.grip_limit_n = self.squeeze.limit_n
        pose_fault = None
        if sensing.reading.pose is not None:
            pose_fault = monitor.held_pose(held.innovation)
        if fault is not None:
            return fault
        if pose_fault is not None or not steady:
            return pose_fault
        return monitor.squeezing(self.squeeze_n, sensing.felt_n)

    def grippers(self, order: Order) -> Fault | None:
        """Check every 4 ms that the hands follow their order."""
        now_s = self.sensing.now_s
        if now_s - self._grippers_checked_s < _CHECK_S:
            return None
        self._grippers_checked_s = now_s
        margin_m = self._faults.gap_margin_m
        if order is Order.OPEN:
            target_m = 2.0 * self._plant.robot.hand.travel_m - margin_m
        else:
            target_m = self._width_m + margin_m
        pinch_n = self.sensing.pinch.tolist()
        return self._monitor.grippers(now_s, order, self._gaps_m, pinch_n, target_m)

    def motors(self, commanded: Array) -> Fault | None:
        """Compare commanded torques (n,) [Nm] with applied ones."""
        return self._monitor.motors(commanded, self._plant.tau)
