"""The table of timing engines."""

from collections.abc import Collection
from typing import NamedTuple, Protocol

from minidual.config.planning import MotionLimits
from minidual.motion import timing
from minidual.motion.speed_profile import Curve
from minidual.motion.timing import PathLimits, TimedPath
from minidual.registry import Registry
from minidual.robot.kinematics import Kinematics


class TimePath(Protocol):
    """Times a curve; see `minidual.motion.timing.time_path`."""

    def __call__(
        self,
        path: Curve,
        group: str,
        limits: MotionLimits,
        kinematics: Kinematics,
        along: PathLimits | None = None,
    ) -> TimedPath:
        """Return the trajectory of a curve, whose first columns are all joints."""
        ...


class TimingEngine(NamedTuple):
    """A way to time paths.

    Attributes:
        time_path: Times a curve.
        unlimited: Limits that it does not keep ("jerk", "torque_rate"). A plan's proof reports
            their use and does not require it.
    """

    time_path: TimePath
    unlimited: Collection[str] = ()


OWN = TimingEngine(timing.time_path)

TIMING_ENGINES: Registry[TimingEngine] = Registry(
    "timing engine",
    {"own": OWN, "toppra": "minidual.motion.toppra_timing:ENGINE"},
    group="minidual.timing_engines",
)


def duration_ratio(
    path: Curve,
    group: str,
    limits: MotionLimits,
    kinematics: Kinematics,
    other: str = "toppra",
) -> float:
    """Return how many times longer a curve takes with `own` than with another engine.

    Raises:
        TimingError: An engine finds no timing.
        UsageError: Unknown engine.
    """
    own = OWN.time_path(path, group, limits, kinematics)
    compared = TIMING_ENGINES[other].time_path(path, group, limits, kinematics)
    return own.trajectory.duration_s / compared.trajectory.duration_s
