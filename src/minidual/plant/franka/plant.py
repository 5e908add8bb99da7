"""Two Franka arms as a plant: joint targets out, stamped states in, errors by name."""

import time
from typing import ClassVar

import numpy as np

from minidual.errors import UsageError
from minidual.plant.connect import PlantRequest
from minidual.plant.franka.link import ArmLink, HandLink, client_library
from minidual.plant.franka.twin import EmulatorTwin
from minidual.plant.franka.wire import JOINTS_N
from minidual.plant.lifecycle import ArmHealth, CommandKind, Sent
from minidual.robot.pair import SIDES, Array, slower_robot

_POLL_S = 0.0005
_POLL_EMULATOR_S = 0.002
"""Between two looks for a new state; an emulator needs the processor that looking takes."""
_SILENT_S = 0.06
_SILENT_EMULATOR_S = 10.0
"""So long a step waits for the next state; an emulator on a busy machine is slower."""
_TOGETHER_S = 0.002
_READ_AGAIN = 4
"""States farther apart are read again so often: a busy machine lets time pass between two looks."""
_SKEW_GAIN = 1e-4
"""Share of the difference of the controllers' clocks that a step takes for drift."""
WHY_NO_TORQUE = (
    "controller C and other torque laws need their own loop at 1 kHz: Python streamed only 366 to "
    "421 Hz, with stalls up to 0.98 s. A torque law would have to run inside the vendor's C++ loop; "
    "use controllers A or B"
)


class FrankaPlant:
    """Two arms with hands behind the vendor's controllers.

    The plant's clock is the left controller's; a step ends when both have measured again. A
    controller that falls silent leaves its stamp behind, and the supervisor stops both arms.

    Attributes:
        robot: The arms, with the share of their velocity and acceleration that may be used: what
            plans and brakes within it can be followed.
    """

    kinds = (CommandKind.POSITION,)
    kind = CommandKind.POSITION
    why_not: ClassVar[dict[CommandKind, str]] = {CommandKind.TORQUE: WHY_NO_TORQUE}

    def __init__(self, request: PlantRequest) -> None:
        self._arms_model = request.robot
        self.braking_share = request.config.acceleration_share
        self.robot = slower_robot(
            request.robot,
            request.config.velocity_share,
            request.config.acceleration_share,
        )
        self.hosts = request.hosts
        self.grip_max_n = request.config.grip_n  # hands close with this force, no other
        self._scene = request.scene
        self._twin: EmulatorTwin | None = None
        self.dt = 1.0 / request.config.rate_hz
        self._config = request.config
        self._arms: list[ArmLink] = []
        self._hands: list[HandLink] = []
        self.place = "hardware"
        self.time = 0.0
        self._skew_s = 0.0
        self.sent: Sent | None = None
        self._silent_s = _SILENT_S
        self._poll_s = _POLL_S

    def connect(self) -> None:
        """Connect both arms, then both hands.

        Raises:
            UsageError: There are not two different hosts, or the arms have not seven joints.
            EnvironmentMissingError: The library is missing, or a controller does not answer.
        """
        if len(set(self.hosts)) != len(SIDES):
            raise UsageError(
                f"plant 'franka' needs the addresses of two controllers, left and right, not "
                f"{', '.join(self.hosts) or 'none'}",
                remedy="--plant franka://LEFT,RIGHT",
            )
        if self.robot.dof_per_arm != JOINTS_N:
            raise UsageError(
                f"plant 'franka' drives arms with {JOINTS_N} joints; '{self.robot.arm.name}' has "
                f"{self.robot.dof_per_arm}",
                remedy="--set robot.arm=panda",
            )
        client_library()
        try:
            for index, host in enumerate(self.hosts):
                self._arms.append(ArmLink(host, self._arms_model, index, self._config))
            for host in self.hosts:
                travel_m = self.robot.hand.travel_m
                self._hands.append(HandLink(host, travel_m, self._config.grip_n))
        except Exception:
            self.close()
            raise
        if any(arm.emulated for arm in self._arms):
            self.place = "emulator"
            self._silent_s = _SILENT_EMULATOR_S
            self._poll_s = _POLL_EMULATOR_S
        self._compare_clocks()
        self.time = self._arms[0].time_s

    def twin(self) -> EmulatorTwin | None:
        """Return the emulator's world, None on hardware; from now on steps refresh it."""
        if self._twin is None and self.place == "emulator":
            self._twin = EmulatorTwin(self.hosts[0], self._scene, self._arms_model)
        return self._twin

    def activate(self, kind: CommandKind) -> None:
        """Clear errors of an earlier motion."""
        if any(arm.fault for arm in self._arms):
            self.recover()

    # Measurements ------------------------------------------------------------------------------

    @property
    def stamps_s(self) -> Array:
        """Times (2,) [s] of the arms' states, on the plant's clock."""
        left, right = self._arms
        return np.array([left.time_s, right.time_s - self._skew_s])

    @property
    def stamp_s(self) -> float:
        """See `Plant`: of the older state."""
        return float(self.stamps_s.min())

    @property
    def healths(self) -> list[ArmHealth]:
        """Health of each arm and its hand."""
        healths: list[ArmHealth] = []
        for side, arm, hand in zip(SIDES, self._arms, self._hands, strict=True):
            faults = [arm.fault] if arm.fault else []
            if hand.fault:
                faults.append(f"hand: {hand.fault}")
            healths.append(ArmHealth(side, tuple(faults)))
        return healths

    @property
    def health(self) -> str:
        """See `Plant`."""
        return "; ".join(
            f"{health.arm} arm: {fault}" for health in self.healths for fault in health.faults
        )

    @property
    def q(self) -> Array:
        """See `Plant`."""
        return np.concatenate([arm.q for arm in self._arms])

    @property
    def v(self) -> Array:
        """See `Plant`."""
        return np.concatenate([arm.v for arm in self._arms])

    @property
    def tau(self) -> Array:
        """Measured torques (n,) [Nm], on the links' side."""
        return np.concatenate([arm.tau for arm in self._arms])

    @property
    def fingers(self) -> Array:
        """See `Plant`."""
        return np.array([hand.finger_m for hand in self._hands])

    @property
    def grip(self) -> Array:
        """The set force of hands that report a grasp, else 0 (2,) [N]: the hands measure none."""
        return np.array([hand.grip_n for hand in self._hands])

    @property
    def success_rates(self) -> list[float]:
        """Share of each arm's last 100 commands that its controller got in time."""
        return [arm.success_rate for arm in self._arms]

    def _compare_clocks(self) -> None:
        """Measure by how much the right controller's clock is ahead of the left one's."""
        left, right = self._arms
        for _ in range(_READ_AGAIN):
            left.read()
            before_s = left.time_s
            right.read()
            left.read()
            if left.time_s - before_s <= _TOGETHER_S:
                break
        self._skew_s = right.time_s - left.time_s

    def _read(self) -> None:
        """Read the newest states; the older one again where the other has come in between."""
        for arm in self._arms:
            arm.read()
        for _ in range(_READ_AGAIN):
            left_s, right_s = self.stamps_s
            if abs(left_s - right_s) <= _TOGETHER_S:
                return
            older = 0 if left_s < right_s else 1
            self._arms[older].read()

    # Commands ----------------------------------------------------------------------------------

    def follow(self, q: Array, v: Array, openings: Array) -> None:
        """See `PositionPlant`."""
        for index, arm in enumerate(self._arms):
            joints = self.robot.joints_of(index)
            arm.follow(q[joints], v[joints], self.dt)
        for hand, opening in zip(self._hands, openings, strict=True):
            hand.open_to(float(opening))
        self.sent = Sent(self.kind, self.time, q=q.copy(), v=v.copy())

    @property
    def limits_rad(self) -> tuple[Array, Array] | None:
        """Least and largest joint positions (n,) that the controllers declare, or None."""
        declared = [arm.limits_rad for arm in self._arms]
        bounds = [limits for limits in declared if limits is not None]
        if len(bounds) < len(SIDES):
            return None
        lower, upper = zip(*bounds, strict=True)
        return np.concatenate(lower), np.concatenate(upper)

    def soften(self, share: float) -> None:
        """Set the stiffness of both controllers' joints to a share of their default."""
        for arm in self._arms:
            arm.soften(share)

    def brake(self, arms: tuple[int, ...]) -> None:
        """See `Plant`: the controllers stop these arms themselves."""
        for index in arms:
            self._arms[index].stop()

    def step(self) -> None:
        """Wait until both controllers' clocks have gone on by a period.

        A lost arm sends no states: then it waits for no more than a period.
        """
        due_s = self.time + self.dt
        left, right = self._arms
        silent_s = 0.0 if left.is_lost or right.is_lost else self._silent_s
        patient_until_s = time.perf_counter() + self.dt + silent_s
        faults = [arm.fault for arm in self._arms]
        while True:
            self._read()
            if self.stamp_s >= due_s - 1e-9:
                break
            if [arm.fault for arm in self._arms] != faults:
                break  # a connection that is lost brings no more states
            if time.perf_counter() > patient_until_s:
                break
            time.sleep(self._poll_s)
        self.time = max(due_s, self.stamp_s)
        drift_s = right.time_s - left.time_s - self._skew_s
        self._skew_s += _SKEW_GAIN * drift_s
        if self._twin is not None:
            self._twin.refresh()

    def catch_up(self) -> None:
        """Read the newest states: the controllers' time runs on between steps."""
        self._read()
        self.time = max(self.time, self.stamp_s)
        if self._twin is not None:
            self._twin.refresh()

    # Ends --------------------------------------------------------------------------------------

    def recover(self) -> None:
        """Clear the errors that the controllers can clear; `healths` has the rest."""
        for arm in self._arms:
            arm.recover()
        self.catch_up()

    def close(self) -> None:
        """Stop both arms, and release the hands' connections."""
        for arm in self._arms:
            arm.close()
        for hand in self._hands:
            hand.close()
        self._hands = []
        self._arms = []
        if self._twin is not None:
            self._twin.close()
            self._twin = None


def franka(request: PlantRequest) -> FrankaPlant:
    """Return the row `franka` of `PLANTS`."""
    return FrankaPlant(request)
