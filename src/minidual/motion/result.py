"""Result of a successful query."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

from minidual.proof.scene_engines import Verification
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory

PHASES: tuple[str, ...] = ("scene", "ik", "search", "shortcut", "blend", "timing", "verify")


@dataclass
class PhaseTimes:
    """Wall time by phase [s], summed over attempts."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PHASES, 0.0))
    started: float = field(default_factory=perf_counter)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the block's time to a phase."""
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - begin

    @property
    def elapsed_s(self) -> float:
        """Time since the query began."""
        return perf_counter() - self.started


@dataclass(frozen=True, eq=False)
class PlanResult:
    """A proven plan.

    Attributes:
        path: Polyline (n, dof) after shortcutting.
        q_goal: Goal reached (dof,).
        notes: Why earlier attempts failed, or a straight move ends early.
    """

    trajectory: Trajectory
    path: Array
    q_goal: Array
    verification: Verification
    times_s: dict[str, float]
    total_s: float
    attempts_n: int
    notes: tuple[str, ...] = ()

    @property
    def direct(self) -> bool:
        """Whether the path is one segment."""
        return len(self.path) == 2
