"""Planned paths, timed again by another engine."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from minidual.collision.errors import TimingError
from minidual.config.root import Config
from minidual.motion.timing_engines import duration_ratio
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.trials.planning.evaluate import QueryOutcome

PATHS_PER_GROUP_N = 5


class Retiming(NamedTuple):
    """Durations of planned paths by `own`, in shares of those by `toppra`.

    Attributes:
        ratios: One for each path.
        failures: A line for each path that an engine cannot time.
    """

    ratios: list[float]
    failures: list[str]

    @property
    def median(self) -> float:
        """Median ratio; NaN without paths."""
        return float(np.median(self.ratios)) if self.ratios else np.nan


def retime(config: Config, outcomes: Mapping[str, Sequence[QueryOutcome]]) -> Retiming:
    """Time the first solved paths of each group by both engines."""
    kinematics = Kinematics(robot_from(config.robot))
    ratios: list[float] = []
    failures: list[str] = []
    for group, group_outcomes in outcomes.items():
        results = [o.result for o in group_outcomes if o.result is not None]
        curves = [result.curve for result in results if result.curve is not None]
        for curve in curves[:PATHS_PER_GROUP_N]:
            try:
                ratios.append(duration_ratio(curve, group, config.plan.planner, kinematics))
            except TimingError as error:
                failures.append(f"a path of {group} could not be timed again: {error.message}")
    return Retiming(ratios, failures)
