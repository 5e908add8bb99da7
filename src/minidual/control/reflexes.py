"""The supervisor's reflexes, and its bounds: the arms' limits, tightened by the configuration."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.errors import MinidualError
from minidual.registry import rows_beside
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot


@dataclass(frozen=True)
class ReflexKind:
    """A row of reflexes.yaml."""

    cause: str
    remedy: str
    unit: str = ""


REFLEXES = {name: ReflexKind(**words) for name, words in rows_beside(__file__).items()}


@dataclass(frozen=True)
class Reflex:
    """A triggered reflex.

    Attributes:
        name: Key of REFLEXES.
        where: Joint, hand, pair of parts, or reason.
        value: NaN possible for `not_finite`.
        details: Measurements and requested torque of that tick (JSON types).
    """

    name: str
    time_s: float
    where: str
    value: float
    bound: float | None
    details: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def kind(self) -> ReflexKind:
        """Its table row."""
        return REFLEXES[self.name]

    @property
    def text(self) -> str:
        """One line with value and bound."""
        unit = f" {self.kind.unit}" if self.kind.unit else ""
        numbers = (
            "" if self.bound is None else f" ({self.value:.6g}{unit}, bound {self.bound:.6g}{unit})"
        )
        return (
            f"reflex {self.name} at {self.time_s:.3f} s: {self.kind.cause}: {self.where}{numbers}"
        )


class ReflexError(MinidualError):
    """The supervisor stops the arms; raised once per reflex.

    Attributes:
        tau: (n,) [Nm] to apply in this tick; finite, within limits.
        dump: File for `minidual replay`, if written.
    """

    remedy: str

    def __init__(self, reflex: Reflex, tau: Array) -> None:
        super().__init__(reflex.text, remedy=reflex.kind.remedy)
        self.reflex = reflex
        self.tau = tau
        self.dump: Path | None = None


QUANTITIES: tuple[str, ...] = (
    "position",
    "velocity",
    "torque",
    "torque_step",
    "acceleration",
    "acceleration_step",
)
"""Quantities compared each tick, per joint; a step is a difference between ticks."""

POSITION_TOLERANCE_RAD = 1e-3  # targets may lie on the bound; tracking is imperfect
TORQUE_TOLERANCE = 1e-6  # relative excess accepted as rounding
SATURATED = 0.999
"""Share of the torque limit that counts as saturated; controllers clip at 1."""
_WIDTH_M = 0.1
"""Lateral extent of a link or hand."""


@kernel(types.float64(VIEW, VIEW, VIEW, VECTOR, VIEW, types.boolean, ROWS, ROWS, ROWS))
def excess(
    q: Array,
    v: Array,
    tau: Array,
    before: Array,
    a_ref: Array,
    follows: bool,
    centre: Array,
    scale: Array,
    rows: Array,
) -> float:
    """Return the largest |x - centre| scale of QUANTITIES (6, n); NaN stays.

    Fills `rows` (6, n) with them: the step of the torque is since `before`, that of a_ref (n,) 0 unless it `follows`.
    """
    most = 0.0
    for j in range(len(before)):
        rows[0, j], rows[1, j], rows[2, j], rows[3, j] = q[j], v[j], tau[j], tau[j] - before[j]
        rows[4, j], rows[5, j] = a_ref[j], a_ref[j] - rows[4, j] if follows else 0.0
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            ratio = abs(rows[i, j] - centre[i, j]) * scale[i, j]
            most = ratio if ratio > most or ratio != ratio else most
    return most


class TickBounds:
    """Bounds of QUANTITIES: `|x - centre| * scale > 1` needs a closer check.

    Attributes:
        centre, scale: (6, n).
        q_lower, q_upper: (n,) [rad], margins applied.
        tau_step, a_step: Largest change per tick.
    """

    def __init__(self, config: SupervisorConfig, dt_s: float, robot: Robot) -> None:
        self.q_lower = robot.q_lower + config.position_margin_rad
        self.q_upper = robot.q_upper - config.position_margin_rad
        self.v_max = config.velocity_scale * robot.v_max
        self.tau_max = config.torque_scale * robot.tau_max
        self.tau_step = config.torque_rate_scale * robot.arm.tau_rate_max * dt_s
        self.a_max = config.acceleration_scale * robot.a_max
        self.a_step = robot.jerk_max * dt_s
        position = 0.5 * (self.q_upper - self.q_lower) + POSITION_TOLERANCE_RAD
        steps = np.full(robot.dof, self.tau_step), self.a_max, self.a_step
        half = np.stack(
            [position, self.v_max, SATURATED * self.tau_max, *(x * (1.0 + 1e-9) for x in steps)],
        )
        self.centre = np.zeros_like(half)
        self.centre[0] = 0.5 * (self.q_lower + self.q_upper)
        self.scale = 1.0 / half


class Reach:
    """Bounds on the motion of arm points.

    Attributes:
        m: (n,) [m]; a turn dq of joint j moves no point by more than m[j] |dq|.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        model = kinematics.model
        robot = kinematics.robot
        chain: list[float] = []
        for arm, frame in enumerate(kinematics.tcp_ids):
            tool = model.frames[frame]
            steps = [
                model.jointPlacements[model.getJointId(name)]
                for name in robot.joint_names[robot.joints_of(arm)]
            ]
            lengths = [
                float(np.abs(step.translation).sum()) for step in (*steps[1:], tool.placement)
            ]
            chain += np.cumsum(lengths[::-1])[::-1].tolist()
        self.m = np.array(chain) + _WIDTH_M
        self._acceleration = float(self.m @ robot.a_max)

    def safe_time_s(self, v: Array, gap_m: float) -> float:
        """Return the time [s] in which a gap [m] cannot close.

        In time h a gap shrinks by at most h sum_j m[j] (|v_j| + a_j h), over both arms.
        """
        speed = float(self.m @ np.abs(v))
        root = np.sqrt(speed * speed + 4.0 * self._acceleration * max(0.0, gap_m))
        return float(root - speed) / (2.0 * self._acceleration)
