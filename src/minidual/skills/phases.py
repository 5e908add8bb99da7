"""Phases of handling an object and their parameters.

Position-driven phases are planned and timed; force-driven ones use object impedance.
"""

from minidual.config.base import StrictModel
from minidual.motion.timing import PathLimits
from minidual.registry import rows_beside


class Phase(StrictModel):
    """Parameters of a phase.

    Attributes:
        rise_m: Final height of the hands over their grasps.
        hold_s: Standstill, position-driven.
        force_s: Shortest force ramp, or standstill.
        limits: Of the object or hands; None: the planner's.
    """

    rise_m: float = 0.0
    hold_s: float = 0.0
    force_s: float = 0.0
    limits: PathLimits | None = None


PHASES = {name: Phase(**row) for name, row in rows_beside(__file__).items()}
