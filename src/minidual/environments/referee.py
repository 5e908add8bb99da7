"""Judges the trials of many worlds: success, failures, and which trials are over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from minidual.environments.judging import TransportJudges
from minidual.environments.rewards import LiftState
from minidual.environments.senses import Sensed
from minidual.environments.transport_kernel import Scene
from minidual.environments.worlds import Worlds
from minidual.robot.pair import SIDES, Array, Indices
from minidual.tasks.task import Task, Trial

DIVERGED = "diverged"
STOPPED = "stopped"
"""Names of failures beside those of conditions."""

Flags = npt.NDArray[np.bool_]


class Referee:
    """The judges of N worlds, and the other reasons to end a trial.

    Attributes:
        judges: Of success.
        goals: (N, 3), x, y [m] and yaw [rad].
        diverged: Whether MuJoCo has reset a world (N,).
        stopped: Whether the supervisor would have stopped the arms (N,).

    Args:
        linger_s: For how long a trial must have been finished.
        supervised: Whether to compare with the supervisor's bounds.
    """

    def __init__(
        self, task: Task, worlds: Worlds, trial: Trial, linger_s: float, supervised: bool
    ) -> None:
        worlds_n = worlds.worlds_n
        self._task = task
        self._worlds = worlds
        self._linger_s = linger_s
        self._supervised = supervised
        self.judges = TransportJudges(task, trial, worlds.solids, worlds_n)
        self._item = task.objects[task.carried]
        self._grasps = np.stack([self._item.grasps[side] for side in SIDES])
        self.goals = np.zeros((worlds_n, 3))
        self.diverged: Flags = np.zeros(worlds_n, dtype=bool)
        self.stopped: Flags = np.zeros(worlds_n, dtype=bool)
        self._elapsed_s = np.zeros(worlds_n)

    def reset(self, worlds: Indices, starts: Array, goals: Array) -> None:
        """Begin trials with starts and goals (m, 3) of objects on the table."""
        self.judges.reset(worlds)
        self.goals[worlds] = goals
        self.diverged[worlds] = False
        self.stopped[worlds] = False
        self._elapsed_s[worlds] = 0.0
        judged = self.judges.state
        judged["xyz"][worlds] = self._worlds.object_poses()[worlds, :3, 3]
        judged["yaw"][worlds] = starts[:, 2]

    def observe(self, scene: Scene) -> None:
        """Judge one physics step."""
        self.judges.observe(scene)

    def note(self, period_s: float) -> None:
        """Note divergence and stops of a period of simulated time."""
        self._elapsed_s += period_s
        off_s = np.abs(self._worlds.time_s - self._elapsed_s)  # MuJoCo resets a world's clock too
        self.diverged |= ~(off_s < 0.5 * self._worlds.dt)
        if self._supervised:
            self.stopped |= ~(self._worlds.loads.strain <= 1.0)

    @property
    def finished(self) -> Flags:
        """Whether a trial has been finished for long enough (N,)."""
        since_s = self._worlds.time_s - self.judges.state["done_s"]  # NaN while it is not
        return since_s >= self._linger_s - 1e-9

    @property
    def violated(self) -> Flags:
        """Whether a trial can no longer succeed (N,)."""
        return self.judges.violated | self.stopped | self.diverged

    @property
    def late(self) -> Flags:
        """Whether the time of a trial is over (N,)."""
        return self._worlds.time_s >= self._task.time_limit_s - 1e-9

    def failure(self, world: int) -> str:
        """Return the name of the first violation of a world's trial, or ""."""
        if self.diverged[world]:
            return DIVERGED
        if self.stopped[world] and not self.judges.violated[world]:
            return STOPPED
        return self.judges.failure(world)

    def state(self, sensed: Sensed) -> LiftState:
        """Return the state for the rewards."""
        judged = self.judges.state
        limits = self.judges.limits
        violated = self.violated
        return LiftState(
            hands=sensed.hands,
            opening=sensed.gripper,
            grasps=self._grasps,
            xyz=judged["xyz"].copy(),
            yaw=judged["yaw"].copy(),
            tilt=judged["tilt"].copy(),
            clearance=judged["clearance"].copy(),
            rest_m=self._item.body.rest_height_m,
            pinch_n=judged["pinch"].copy(),
            lifted_m=judged["lifted_m"].copy(),
            goal=self.goals,
            rise_m=limits.rise,
            tilt_max=limits.tilt,
            symmetry=self._item.symmetry,
            strain=self._worlds.loads.strain,
            violated=violated,
            succeeded=self.judges.succeeded & self.finished & ~violated,
        )

    def outcomes(self, trials: Sequence[Trial], succeeded: Flags) -> dict[str, Any]:
        """Return how the trials of all worlds stand (N,), by name."""
        judged = self.judges.state
        failures = [self.failure(world) for world in range(len(trials))]
        pinch_n = judged["pinch_least"]
        return {
            "success": succeeded,
            "failure": np.array(failures, dtype=object),
            "trial": np.array([trial.index for trial in trials]),
            "time_s": self._worlds.time_s,
            "highest_m": judged["highest_m"].copy(),
            "tilt_max_rad": judged["tilt_max"].copy(),
            "pinch_min_n": np.where(np.isfinite(pinch_n), pinch_n, 0.0),
        }
