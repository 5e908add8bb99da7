"""Phases of handling an object and their parameters.

Position-driven phases are planned and timed; force-driven ones use object impedance.
"""

from dataclasses import dataclass

from minidual.motion.timing import PathLimits


@dataclass(frozen=True)
class Phase:
    """Parameters of a phase.

    Attributes:
        open: Whether the acting hands are open.
        rise_m: Final height of the hands over their grasps.
        hold_s: Standstill, position-driven.
        force_s: Shortest force ramp, or standstill.
        limits: Of the object or hands; None: the planner's.
    """

    open: bool
    rise_m: float = 0.0
    hold_s: float = 0.0
    force_s: float = 0.0
    limits: PathLimits | None = None


_SLOW = PathLimits(speed_m_per_s=0.15, acceleration_m_per_s2=0.6)

PHASES: dict[str, Phase] = {
    "approach": Phase(open=True, rise_m=0.08),
    "descend": Phase(open=True, limits=_SLOW),
    "close": Phase(open=False, hold_s=0.7),
    "squeeze": Phase(open=False, force_s=0.3),
    "lift": Phase(open=False, limits=_SLOW),
    "carry": Phase(open=False, limits=PathLimits(speed_m_per_s=0.35, acceleration_m_per_s2=1.0)),
    "lower": Phase(open=False, limits=_SLOW),
    "insert": Phase(
        open=False, hold_s=0.6, force_s=2.0, limits=PathLimits(speed_m_per_s=0.015, acceleration_m_per_s2=0.3)
    ),
    "settle": Phase(open=False, hold_s=0.2, force_s=0.1),
    "unload": Phase(open=False, force_s=0.2),
    "open": Phase(open=True, hold_s=0.5, force_s=0.3),
    "retreat": Phase(open=True, rise_m=0.10, limits=_SLOW),
    "home": Phase(open=True),
}
