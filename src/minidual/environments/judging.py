"""Judge of many worlds: the success test of a trial, compiled."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from minidual.environments.transport_kernel import CONDITIONS, JUDGED, Limits, Scene, judge
from minidual.errors import UsageError
from minidual.robot.pair import Array, Indices
from minidual.tasks import movement, success
from minidual.tasks.judge import REST_S
from minidual.tasks.success import SuccessCondition
from minidual.tasks.task import Task, Trial

_KNOWN: dict[type[SuccessCondition], bool] = {
    success.Level: True,
    success.Whole: True,
    success.Clear: False,  # only where there is an obstacle
    success.Held: True,
    movement.Slow: True,
    movement.Carried: True,
    success.Squeezed: True,  # optional, and asked of methods by force alone
    success.Rose: True,
    success.Arrived: True,
    success.Turned: True,
    success.Released: True,
    movement.Settled: True,
    success.AtRest: True,
    success.OnTime: True,
}
"""Conditions that the compiled judge knows, and whether it needs each."""


def limits_of(task: Task, trial: Trial, reach_m: float) -> Limits:
    """Return the numbers of a task's conditions.

    Args:
        reach_m: Distance of the object's farthest end from its centre, horizontally.

    Raises:
        UsageError: The task is no transport of one object by both hands.
    """
    conditions = task.success(task, trial)
    rows = {type(condition): condition for condition in conditions}
    needed = {kind for kind, is_needed in _KNOWN.items() if is_needed}
    if set(rows) - set(_KNOWN) or needed - set(rows) or len(rows) < len(conditions):
        raise UsageError(
            f"the task '{task.name}' cannot be judged in a batch",
            remedy="a batch judges transports of one object by both hands: rod_carry, pot_lift",
        )
    return _limits(conditions, reach_m)


def _limits(conditions: Sequence[SuccessCondition], reach_m: float) -> Limits:
    def only[C: SuccessCondition](kind: type[C]) -> C:
        return next(condition for condition in conditions if isinstance(condition, kind))

    level = only(success.Level)
    whole = only(success.Whole)
    held = only(success.Held)
    carried = only(movement.Carried)
    turned = only(success.Turned)
    settled = only(movement.Settled)
    if not held.both or held.hand is not None or carried.height_m != settled.height_m:
        raise UsageError("a batch judges objects that both hands hold")
    return Limits(
        tilt=level.limit_rad,
        break_pinch=math.inf if whole.pinch_max_n is None else whole.pinch_max_n,
        break_force=math.inf if whole.force_max_n is None else whole.force_max_n,
        pinch=held.limit_n,
        speed=only(movement.Slow).limit_m_per_s,
        high=carried.height_m,
        shift=carried.limit_m,
        rise=only(success.Rose).limit_m,
        goal=only(success.Arrived).limit_m,
        yaw=turned.limit_rad,
        period=math.tau / turned.symmetry,
        settle=settled.limit_m,
        over=settled.over_m,
        free_s=movement.FREE_S,
        rest_speed=only(success.AtRest).limit_m_per_s,
        rest_s=REST_S,
        reach=reach_m,
        upright=False,
    )


class TransportJudges:
    """Judges of N worlds in which both hands carry one object; call `observe` after each step.

    Attributes:
        limits: Numbers of the conditions.
        state: (N,) of `transport_kernel.JUDGED`.
    """

    def __init__(self, task: Task, trial: Trial, solids: Array, worlds_n: int) -> None:
        ends_m = np.abs(solids[:, :2]) + solids[:, 3:5]
        limits = limits_of(task, trial, float(ends_m.max()))
        upright = task.objects[task.carried].body.upright
        self.limits = limits._replace(upright=upright)
        self._time_limit_s = task.time_limit_s
        self.state = np.zeros(worlds_n, JUDGED)
        self.reset(np.arange(worlds_n))

    def reset(self, worlds: Indices) -> None:
        """Begin new trials."""
        self.state[worlds] = np.zeros(1, JUDGED)
        for name in ("failed_s", "done_s", "quiet_s", "free_s"):
            self.state[name][worlds] = math.nan
        self.state["pinch_least"][worlds] = math.inf

    def observe(self, scene: Scene) -> None:
        """Evaluate one physics step."""
        judge(scene, self.limits, self.state)

    @property
    def violated(self) -> npt.NDArray[np.bool_]:
        """Whether a condition is violated (N,)."""
        return self.state["failure"] > 0

    @property
    def finished(self) -> npt.NDArray[np.bool_]:
        """Whether the final conditions have held for `REST_S` (N,)."""
        return np.isfinite(self.state["done_s"])

    @property
    def succeeded(self) -> npt.NDArray[np.bool_]:
        """Whether each trial would count as a success if it ended now (N,)."""
        rose = self.state["highest_m"] > self.limits.rise
        on_time = self.state["done_s"] <= self._time_limit_s
        return self.finished & ~self.violated & rose & on_time

    def failure(self, world: int) -> str:
        """Return the name of the condition that was violated first, or ""."""
        return CONDITIONS[int(self.state["failure"][world])]
