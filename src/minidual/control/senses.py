"""What the supervisor senses: joint measurements checked against one another, and external torques.

A joint's measurements are replaced where they fail:

    r <- r exp(-dt / 0.1 s) + q - q_before - (v + v_before) dt / 2        position and velocity must agree

A value that stands still while the other moves is frozen. Lost positions follow the integral of v, lost velocities the
slope of q; a joint that lost both follows forward dynamics under the applied torque.

A momentum observer finds the torques:

    r <- r + g (M(q) dv/dt + h(q, v) + friction - tau - tau_expected - r)

Source: Haddadin, De Luca, Albu-Schaeffer, Robot collisions, IEEE T-RO 33(6), 2017.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

_FORGET_S = 0.1
_SLOPE_S = 0.005
"""Time constant of a velocity from positions."""
_FROZEN_SHARE = 0.025
"""Of the torque limits: a change of torque that must move a joint's readings."""
_KEPT = 64
"""Applied torques kept, in steps: the longest time from a loss to its detection."""

_Q, _V, _R, _Q_SAME, _V_SAME, _TAU, _DQ, _DV, _Q_USABLE, _V_USABLE = range(10)


@kernel(types.float64(*[VECTOR] * 4, types.float64, types.intp, VECTOR, ROWS, ROWS))
def compare(
    q: Array,
    v: Array,
    tau: Array,
    needed: Array,
    dt: float,
    row: int,
    bounds: Array,
    kept: Array,
    applied: Array,
) -> float:
    """Update `kept` (10, n): q, v, r, seconds unchanged of q, v, torque beyond `needed` before both froze, change of q, v.

    Last, usable q, v. Copies tau to a row of `applied`. Returns the largest ratio to a bound; infinite if not finite.
    bounds (n + 2,): mismatch [rad], time frozen [s], changes of that torque that must move the joints.
    """
    worst = 0.0
    keep = math.exp(-dt / _FORGET_S)
    for j in range(len(q)):
        applied[row, j] = tau[j]
        if not (math.isfinite(q[j]) and math.isfinite(v[j])):
            worst = math.inf
            continue
        moved = q[j] - kept[_Q, j]
        before = kept[_V, j]
        kept[_DQ, j], kept[_DV, j] = moved, v[j] - before
        kept[_Q_SAME, j] = kept[_Q_SAME, j] + dt if moved == 0.0 else 0.0
        kept[_V_SAME, j] = kept[_V_SAME, j] + dt if v[j] == kept[_V, j] else 0.0
        kept[_R, j] = keep * kept[_R, j] + moved - 0.5 * dt * (v[j] + before)
        kept[_Q, j], kept[_V, j] = q[j], v[j]
        worst = max(worst, abs(kept[_R, j]) / bounds[0])
        beyond = tau[j] - needed[j]  # NaN where it is not known
        if min(kept[_Q_SAME, j], kept[_V_SAME, j]) < bounds[1] or math.isnan(kept[_TAU, j]):
            kept[_TAU, j] = beyond
        elif abs(beyond - kept[_TAU, j]) > worst * bounds[2 + j]:
            worst = abs(beyond - kept[_TAU, j]) / bounds[2 + j]
    if worst <= 1.0:
        for j in range(len(q)):
            kept[_Q_USABLE, j], kept[_V_USABLE, j] = q[j], v[j]
    return worst


def slower(v: Array, before: Array) -> Array:
    """Return the slower of the last two velocities (n,) of each joint: one sample may be wrong."""
    return np.where(np.abs(before) < np.abs(v), before, v)


class JointSense:
    """Usable joint measurements.

    Attributes:
        q: (n,) [rad], measured or replaced.
        v: (n,) [rad/s].
        lost: (2, n) positions and velocities not to be used, until `reset`. A joint that lost both, or was not measured
            when control began, is used again once both are measured, change and agree with the packet before.
        returned: (n,), which joints came back in this update.
    """

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._model = pin.Model(kinematics.model)
        self._robot = kinematics.robot
        # Implicit in the damping, as in the simulator: without readings an error grows as a pendulum falls.
        self._model.armature = self._model.armature + dt_s * self._robot.arm.damping
        self._data = self._model.createData()
        self._config = config
        self._dt = dt_s
        self._age_max_s = max(config.measurement_age_max_s, 2.0 * dt_s)
        self._tau_moves = _FROZEN_SHARE * self._robot.tau_max
        self._bounds = np.r_[config.position_mismatch_rad, config.frozen_s, self._tau_moves]
        self.reset()

    def reset(self) -> None:
        """Trust everything again; start at the next measurement."""
        n = self._robot.dof
        self.lost: npt.NDArray[np.bool_] = np.zeros((2, n), dtype=bool)
        self.why = ""
        """Which values of which joint disagreed first, and by how much."""
        self.age_s = 0.0
        """Time without a new measurement."""
        self.needed: Array = np.full(n, math.nan)
        """Torque (n,) [Nm] that posture and motion take: a joint that stands under it need not be frozen."""
        self._kept = np.zeros((10, n))
        self._started = False
        self._any_lost = False
        self._none = self.returned = np.zeros(n, dtype=bool)
        self.q, self.v = self._kept[_Q_USABLE:]
        self.q[:] = self._robot.home
        self.applied = np.zeros((_KEPT, n))
        self.ticks = 0
        """Ring of applied torques; row of the last: (ticks - 1) % len(applied)."""

    def update(self, q: Array, v: Array, tau: Array, new_s: float) -> bool:
        """Take measurements q, v (n,) that are `new_s` newer than the last; return whether all are usable.

        tau: applied since the last tick [Nm]. `new_s` 0: nothing new was measured.
        """
        row = self.ticks % _KEPT
        self.ticks = self.ticks + 1
        self.returned = self._none
        if new_s > 0.0:
            if self._any_lost:
                back = self.lost.all(axis=0) & (self._kept[[_Q, _V]] != [q, v]).all(axis=0)
                back &= np.abs(q - self._kept[_Q] - new_s * v) < self._config.position_mismatch_rad
                back = (back | np.isnan(self._kept[_Q])) & np.isfinite(q + v)
                self.lost[:, back] = False
                self.returned = back
                self._begin(back, q, slower(v, self._kept[_V]), tau, new_s)
            if not self._started:
                self.q[:] = np.where(np.isfinite(q), q, self.q)
                self.v[:] = np.where(np.isfinite(v), v, 0.0)
            if not self._started or new_s > self._age_max_s:  # nothing to compare with
                self._begin(np.ones_like(self.lost[0]), q, v, tau, new_s)
            more = self.needed, new_s, row, self._bounds, self._kept, self.applied
            self.age_s = 0.0
            usable = compare(q, v, tau, *more) <= 1.0
            if not usable:
                self._judge(q, v, tau, new_s)
        else:
            q = self.q
            v = self.v
            self.applied[row] = tau
            self.age_s += self._dt
            usable = self.age_s <= self._age_max_s
            if not usable:
                self._lose(np.ones_like(self.lost), self.age_s)
        if self._any_lost:
            self._replace(q, v, new_s if new_s > 0.0 else self._dt)  # the stamp may be NaN
        return usable

    def _begin(
        self,
        joints: npt.NDArray[np.bool_],
        q: Array,
        v: Array,
        tau: Array,
        new_s: float,
    ) -> None:
        for row, value in ((_Q, q - new_s * v), (_V, v), (_R, 0.0 * v), (_TAU, tau - self.needed)):
            self._kept[row, joints] = value[joints]
        self._started = True

    def _judge(self, q: Array, v: Array, tau: Array, new_s: float) -> None:
        kept = self._kept
        bad = ~np.isfinite(np.stack([q, v]))
        finite = ~bad.any(axis=0)
        same = kept[[_Q_SAME, _V_SAME]]
        apart = (
            finite
            & (np.abs(kept[_R]) > self._config.position_mismatch_rad)
            & ~self.lost.any(axis=0)
        )
        moves = np.abs(tau - self.needed - kept[_TAU]) > self._tau_moves
        still = finite & (same.min(axis=0) >= self._config.frozen_s) & moves
        # A position that moved as neither velocity says, or too far for any joint, is wrong; so is a velocity whose jump
        # alone explains the mismatch.
        moved = kept[_DQ]
        ways = new_s * np.stack([kept[_V], kept[_V] - kept[_DV]])
        leapt = np.abs(moved - ways).min(axis=0) > 0.5 * self._config.position_mismatch_rad
        leapt = apart & (leapt | (np.abs(moved) > 2.0 * new_s * self._robot.v_max))
        sped = apart & (new_s * np.abs(kept[_DV]) > 0.5 * self._config.position_mismatch_rad)
        lost = apart & (same > 0.0) & ~leapt & ~sped
        lost[0] |= leapt
        lost[1] |= sped | (
            apart & ~lost.any(axis=0)
        )  # unknown which: positions err less than a model that falls
        lost |= bad | still
        newly = finite & lost[1] & ~self.lost[1]  # the last velocity may be the wrong one
        self.v[newly] = slower(kept[_V], kept[_V] - kept[_DV])[newly]
        if (apart | still).any() and not self.why:
            joint = int(np.argmax(apart | still))
            what = " and ".join(np.array(["position", "velocity"])[lost[:, joint]])
            far = f"they differ by {abs(kept[_R, joint]):.4f} rad"
            same_s = float(same[:, joint].max())
            held = f"unchanged for {1e3 * same_s:.0f} ms, " if same_s else ""
            self.why = f"{what} of {self._robot.joint_names[joint]}: {held}{far}"
        self._lose(lost, float(same.min(axis=0)[apart | still].max(initial=0.0)))
        kept[_R, self.lost.any(axis=0)] = 0.0

    @property
    def v_slower(self) -> Array:
        """The slower of the last two velocities (n,) [rad/s]."""
        return np.where(self.lost[1], self.v, slower(self.v, self.v - self._kept[_DV]))

    def _lose(self, lost: npt.NDArray[np.bool_], since_s: float) -> None:
        """Stop using values; joints that have lost both follow the model from `since_s` ago."""
        seen = ~self.lost.all(axis=0)
        self.lost |= lost
        self._any_lost = True
        newly = seen & self.lost.all(axis=0)
        steps = min(round(since_s / self._dt), self.ticks, _KEPT) - 1
        if newly.any() and steps > 0:  # all but the last step, which `_replace` adds
            q, v = self._moved(range(self.ticks - 1 - steps, self.ticks - 1))
            self.q[newly] = q[newly]
            self.v[newly] = v[newly]

    def _replace(self, q: Array, v: Array, step_s: float) -> None:
        q_lost, v_lost = self.lost
        q_model, v_model = self._moved(range(self.ticks - 1, self.ticks))
        far = 2.0 * self._robot.v_max  # what nothing is compared with is followed no faster
        q = np.where(v_lost, self.q + np.clip(q - self.q, -step_s * far, step_s * far), q)
        v = np.where(q_lost, np.clip(v, -far, far), v)
        slope = self.v + min(1.0, step_s / _SLOPE_S) * ((q - self.q) / step_s - self.v)
        self.v = np.where(q_lost & v_lost, v_model, np.where(v_lost, slope, v))
        self.q = np.where(q_lost & v_lost, q_model, np.where(q_lost, self.q + step_s * self.v, q))

    def _moved(self, steps: range) -> tuple[Array, Array]:
        """Return (q, v) after steps under the torques applied in them."""
        q = self.q
        v = self.v
        arm = self._robot.arm
        for step in steps:
            tau = self.applied[step % _KEPT]
            friction = arm.damping * v + arm.friction * np.tanh(v / 0.02)
            v = v + self._dt * np.array(pin.aba(self._model, self._data, q, v, tau - friction))
            q = q + self._dt * v
        return q, v


EVERY = 4
"""Ticks between updates."""
_FILTER_S = 0.012
_STEADY_S = 0.1
_LEAST_NM = 3.0
"""Least torque bound: touching fingers turn the weak last joints."""
STILL_RAD_S = 0.001
_MOVED_RAD_S = 0.05
"""A slower joint is still; one that was faster a moment before has been stopped."""
_WINDOW_MAX = 32
"""Longest step, in ticks; after longer silence it begins anew."""
MODES = {
    "free motion": (0.15, 20.0, 0.05),
    "closed hands": (0.5, 60.0, 0.1),
    "held object": (0.15, 40.0, 0.1),
}
"""Allowed torque, relative to the motors' limits, force [N] and deviation [rad] of a mode. Closed hands may squeeze by
position; object impedance tells its load."""


class Expected(NamedTuple):
    """What controllers expect.

    Key of MODES, external torque (n,) [Nm], joints (n,) [rad]; fault of a hand; arms off; weight in each hand [N].
    """

    mode: str = "free motion"
    torque: Array | None = None
    reference: Array | None = None
    hand_fault: str = ""
    off: tuple[int, ...] = ()
    bears_n: Sequence[float] = (0.0, 0.0)


@kernel(types.void(VECTOR, VECTOR, types.float64, ROWS, ROWS))
def halfway(q: Array, v: Array, step_s: float, before: Array, mean: Array) -> None:
    """Fill `mean` (3, n), q, v and dv/dt in mid-step, and `before` (2, n), last q and v."""
    for j in range(len(q)):
        mean[0, j], mean[1, j] = 0.5 * (before[0, j] + q[j]), 0.5 * (before[1, j] + v[j])
        mean[2, j] = (v[j] - before[1, j]) / step_s
        before[0, j], before[1, j] = q[j], v[j]


@kernel(
    types.UniTuple(types.float64, 2)(
        *(VECTOR, ROWS, ROWS, types.int64, types.int64, VECTOR, VECTOR),
        *(VECTOR, types.float64, types.float64, types.float64, types.float64, ROWS),
    ),
)
def observe(
    needed: Array,
    mean: Array,
    applied: Array,
    newest: int,
    ticks: int,
    expected: Array,
    reference: Array,
    bounds: Array,
    damping: float,
    dry: float,
    gain: float,
    step_s: float,
    kept: Array,
) -> tuple[float, float]:
    """Update `kept` (4, n): see `ContactSense`; return the largest ratios to bounds of torque and lateness.

    needed: M dv/dt + h (n,). applied: ring of torques (T, n).
    """
    torque = 0.0
    late = 0.0
    n = len(needed)
    slowly = min(1.0, step_s / _STEADY_S)
    for j in range(n):
        given = 0.0
        for k in range(ticks):
            given += applied[(newest - k) % len(applied), j]
        v = mean[1, j]
        friction = damping * v + (dry * math.tanh(v / 0.02) if dry != 0.0 else 0.0)
        half = 0.5 * step_s * mean[2, j]
        stopped = (
            abs(v + half) < STILL_RAD_S and abs(v - half) > _MOVED_RAD_S
        )  # at once: that of a stop is soon over
        kept[0, j] += (1.0 if stopped else gain) * (
            needed[j] + friction - given / ticks - expected[j] - kept[0, j]
        )
        kept[3, j] += slowly * (kept[0, j] - kept[3, j])
        kept[2, j] = mean[0, j] - reference[j]
        kept[1, j] = kept[1, j] + step_s if abs(kept[2, j]) > bounds[n] else 0.0
        ratio = abs(kept[0, j]) / bounds[j]
        torque = torque if ratio <= torque else ratio  # keeps NaN
        late = max(late, kept[1, j] / bounds[n + 1])
    return torque, late


class ContactSense:
    """Observes external torques.

    Attributes:
        torque: (n,) [Nm], unexplained.
        needed: (n,) [Nm], of the motion.
        late_s: (n,), time too far from the reference.
        away: (n,) [rad] from it.
        steady: (n,) [Nm], mean of `torque` over the last 0.1 s.
        limits: (n + 3,), the bounds in force.
    """

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._kinematics = kinematics
        robot = kinematics.robot
        self._dt = dt_s
        self._friction = robot.arm.damping, robot.arm.friction
        self.bounds: dict[str, Array] = {}
        """(n + 3,) of each mode: torques [Nm], distance [rad], patience [s], force [N]."""
        for name, (share, force_n, deviation_rad) in MODES.items():
            torques = config.contact_scale * np.maximum(share * robot.tau_max, _LEAST_NM)
            late = config.deviation_scale * deviation_rad, config.deviation_s
            self.bounds[name] = np.r_[torques, late, config.contact_scale * force_n]
        self._before = np.zeros((2, robot.dof))
        self._mean = np.zeros((3, robot.dof))
        self._nothing = np.zeros(robot.dof)
        self.limits = self.bounds["free motion"]
        self.reset()

    def reset(self) -> None:
        """Start at the next measurement."""
        self.torque, self.late_s, self.away, self.steady = self._kept = np.zeros(
            (4, len(self._nothing)),
        )
        self.needed = np.full(len(self._nothing), math.nan)
        self._stamp_s = math.nan

    def update(
        self,
        stamp_s: float,
        q: Array,
        v: Array,
        applied: Array,
        newest: int,
        expected: Expected,
    ) -> tuple[float, float]:
        """Take q, v (n,) measured at `stamp_s`; return as `observe`.

        applied: ring of torques (T, n), `newest` the last row before that time.
        """
        step_s = stamp_s - self._stamp_s
        self._stamp_s = stamp_s
        if not 0.5 * self._dt < step_s < _WINDOW_MAX * self._dt:  # the first, or after a silence
            self._before[:] = q, v
            return 0.0, 0.0
        halfway(q, v, step_s, self._before, self._mean)
        torque = expected.torque
        reference = expected.reference
        self.limits = self.bounds[expected.mode]
        if expected.off:  # their motors do not give what is applied
            self.limits = self.limits.copy()
            reference = self._mean[0] if reference is None else reference.copy()
            for arm in expected.off:
                joints = self._kinematics.robot.joints_of(arm)
                self.limits[joints] = math.inf
                reference[joints] = self._mean[0, joints]
                self._kept[:, joints] = 0.0
        self.needed = self._kinematics.rnea(*self._mean)
        return observe(
            self.needed,
            *(self._mean, applied, newest, round(step_s / self._dt)),
            self._nothing if torque is None else torque,
            self._mean[0] if reference is None else reference,
            *(self.limits, *self._friction, -math.expm1(-step_s / _FILTER_S), step_s, self._kept),
        )
