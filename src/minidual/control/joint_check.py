"""Cross-checks of joint readings, and estimates for the joints that fail them.

Position and velocity of a joint must agree:

    r <- r exp(-dt / 0.1 s) + q - q_before - (v + v_before) dt / 2,    |r| <= bound

A joint is frozen if its readings do not change by a bit although it moved a moment ago, or although the torque beyond
what its posture and motion take has changed. A joint that fails a check is blind until `reset`: from readings taken
before the failure it coasts at constant speed for `BLIND_S`, then counts as at rest.
"""

import math

import numpy as np
import numpy.typing as npt
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array, Robot

BLIND_S = 0.05
"""A blind joint coasts for this long; then the plant's brakes take over."""
_FORGET_S = 0.1
_TORQUE_SHARE = 0.025
"""Share of the torque limits; a larger change of torque must change a joint's readings."""
_BRAKING_RAD_PER_S2 = 20.0
"""No joint slows down faster without a collision."""
_MOVED_RAD_PER_S = 0.1
_STANDS_S = 0.008
"""A joint that moved faster a moment ago cannot give the same readings for this long."""
_HISTORY = 32
"""Ticks of accepted readings kept; longer than it takes to notice frozen readings."""
_SLOPE_TICKS = 4
"""Ticks over which positions give a speed."""

_Q, _V, _MISMATCH, _SAME_S, _TORQUE, _SPEED = range(6)
_NOT_FINITE = 1
_DISAGREES = 2
_FROZEN = 4


# One array an argument: see `bounds.excess`.
@kernel(types.intp(VECTOR, VECTOR, VECTOR, VECTOR, types.float64, VECTOR, ROWS, VECTOR))
def compare(
    q: Array,
    v: Array,
    applied: Array,
    needed: Array,
    dt: float,
    bounds: Array,
    state: Array,
    failures: Array,
) -> int:
    """Check readings q, v (n,) that are `dt` newer than the last; return the number of joints that fail.

    Args:
        applied, needed: Torques (n,) [Nm]: applied, and what posture and motion take (NaN: unknown).
        bounds: (n + 2,): mismatch [rad], time frozen [s], torque changes that must move the joints [Nm].
        state: (6, n), updated: last q and v, mismatch r, seconds unchanged, torque beyond `needed` before
            that, and the speed that the joint cannot have lost yet.
        failures: (n,), filled with a sum of flags.
    """
    failed_n = 0
    keep = math.exp(-dt / _FORGET_S)
    for j in range(len(q)):
        failures[j] = 0.0
        if not (math.isfinite(q[j]) and math.isfinite(v[j])):
            failures[j] = _NOT_FINITE
            failed_n += 1
            continue
        moved = q[j] - state[_Q, j]
        unchanged = moved == 0.0 and v[j] == state[_V, j]
        state[_MISMATCH, j] = keep * state[_MISMATCH, j] + moved - 0.5 * dt * (v[j] + state[_V, j])
        state[_SAME_S, j] = state[_SAME_S, j] + dt if unchanged else 0.0
        state[_SPEED, j] = max(abs(v[j]), state[_SPEED, j] - dt * _BRAKING_RAD_PER_S2)
        state[_Q, j] = q[j]
        state[_V, j] = v[j]
        if abs(state[_MISMATCH, j]) > bounds[0]:
            failures[j] += _DISAGREES
        beyond = applied[j] - needed[j]
        frozen = state[_SAME_S, j] >= _STANDS_S - 1e-9 and state[_SPEED, j] > _MOVED_RAD_PER_S
        if state[_SAME_S, j] < bounds[1] or math.isnan(state[_TORQUE, j]):
            state[_TORQUE, j] = beyond
        elif abs(beyond - state[_TORQUE, j]) > bounds[2 + j]:  # false for NaN
            frozen = True
        if frozen:
            failures[j] += _FROZEN
        failed_n += failures[j] != 0.0
    return failed_n


def slower(v: Array, other: Array) -> Array:
    """Return, for each joint, the velocity (n,) nearer to zero."""
    return np.where(np.abs(other) < np.abs(v), other, v)


class JointCheck:
    """Usable positions and velocities of all joints.

    Attributes:
        q: (n,) [rad], as read, or an estimate where the joint is blind.
        v: (n,) [rad/s].
        blind: (n,) joints whose readings are not used.
        why: Text on the first joint that failed, or empty.
        detail: `not_finite`, `implausible` or `stale`.
    """

    def __init__(self, robot: Robot, config: SupervisorConfig, dt_s: float) -> None:
        self._robot = robot
        self._mismatch_max_rad = config.position_mismatch_rad
        torque_changes = _TORQUE_SHARE * robot.tau_max
        self._bounds = np.r_[config.position_mismatch_rad, config.frozen_s, torque_changes]
        self._dt = dt_s
        self._state = np.zeros((6, robot.dof))
        self._failures = np.zeros(robot.dof)
        self._history = np.zeros((_HISTORY, 2, robot.dof))
        self._nobody = np.zeros(robot.dof, dtype=bool)
        self.reset()

    def reset(self) -> None:
        """Trust everything again; `begin` comes next."""
        self.blind: npt.NDArray[np.bool_] = self._nobody
        self.why = ""
        self.detail = ""
        self._blind_s = 0.0
        self._ticks = 0

    def begin(self, q: Array, v: Array) -> None:
        """Start from finite readings (n,)."""
        self._state[:] = 0.0
        self._state[_Q] = q
        self._state[_V] = v
        self._state[_TORQUE] = math.nan
        self._history[:] = q, v
        self.q = q
        self.v = v

    def update(self, q: Array, v: Array, newer_s: float, applied: Array, needed: Array) -> None:
        """Take readings q, v (n,) that are `newer_s` newer than the last; see `compare`."""
        gap = newer_s > _HISTORY * self._dt
        if gap:  # too long ago to compare with
            finite = np.isfinite(q + v)
            self._state[_Q, finite] = q[finite] - newer_s * v[finite]
            self._state[_V, finite] = v[finite]
        failed_n = compare(
            q,
            v,
            applied,
            needed,
            newer_s,
            self._bounds,
            self._state,
            self._failures,
        )
        if failed_n:
            self._lose(q, v)
        if self.blind is self._nobody:
            self.q = q
            self.v = v
        else:
            self.q = np.where(self.blind, self.q, q)
            self.v = np.where(self.blind, self.v, v)
        row = self._history[self._ticks % _HISTORY]
        row[0] = self.q
        row[1] = self.v
        self._ticks += 1

    def lose_all(self) -> None:
        """Use no readings from now on: there are no new ones."""
        if not self.blind.all():
            self._coast_from(~self.blind, np.zeros(self._robot.dof, dtype=int))
            self.blind = np.ones(self._robot.dof, dtype=bool)

    def coast(self, period_s: float) -> None:
        """Move the estimates of blind joints on by one tick."""
        if self.blind is self._nobody:
            return
        self._blind_s += period_s
        at_rest = self._blind_s > BLIND_S
        self.v = np.where(self.blind, 0.0 if at_rest else self.v, self.v)
        q = np.clip(self.q + period_s * self.v, self._robot.q_lower, self._robot.q_upper)
        self.q = np.where(self.blind, q, self.q)

    @property
    def braking_due(self) -> bool:
        """Whether blind joints have coasted for `BLIND_S`."""
        return self._blind_s > BLIND_S

    def _lose(self, q: Array, v: Array) -> None:
        failures = self._failures.astype(int)
        failed = failures > 0
        newly = failed & ~self.blind
        if not newly.any():
            return
        if not self.why:
            self._name(int(np.argmax(newly)), failures)
        same_ticks = np.round(self._state[_SAME_S] / self._dt).astype(int)
        frozen = (failures & _FROZEN) > 0
        self._coast_from(newly, np.where(frozen, same_ticks, 1))
        self.blind = self.blind | newly

    def _coast_from(self, joints: npt.NDArray[np.bool_], since_ticks: npt.NDArray[np.int_]) -> None:
        """Estimate joints from readings `since_ticks` (n,) ticks ago, and move them on to now."""
        q = self.q.copy()
        v = self.v.copy()
        for joint in np.flatnonzero(joints):
            back = min(int(since_ticks[joint]) + 1, self._ticks, _HISTORY - _SLOPE_TICKS - 1)
            newest = self._history[(self._ticks - 1 - back) % _HISTORY, :, joint]
            oldest = self._history[(self._ticks - 1 - back - _SLOPE_TICKS) % _HISTORY, 0, joint]
            slope = (newest[0] - oldest) / (_SLOPE_TICKS * self._dt)
            v[joint] = newest[1] if abs(newest[1]) <= abs(slope) else slope
            q[joint] = newest[0] + back * self._dt * v[joint]
        self.q = np.clip(q, self._robot.q_lower, self._robot.q_upper)
        self.v = np.clip(v, -self._robot.v_max, self._robot.v_max)

    def _name(self, joint: int, failures: npt.NDArray[np.int_]) -> None:
        name = self._robot.joint_names[joint]
        if failures[joint] & _NOT_FINITE:
            self.detail = "not_finite"
            self.why = f"position or velocity of {name}"
            return
        self.detail = "implausible"
        parts = []
        if failures[joint] & _DISAGREES:
            apart_rad = abs(self._state[_MISMATCH, joint])
            parts.append(f"position and velocity differ by {apart_rad:.4f} rad")
        if failures[joint] & _FROZEN:
            parts.append(f"readings unchanged for {1e3 * self._state[_SAME_S, joint]:.0f} ms")
        self.why = f"{name}: {' and '.join(parts)}"
