"""Phases of handling an object, and their parameters.

Position-driven phases are planned and timed; force-driven ones use object impedance.
"""

from dataclasses import dataclass

from minidual.motion.timing import PathLimits


@dataclass(frozen=True, kw_only=True)
class Phase:
    """Parameters of a phase.

    Attributes:
        rise_m: Final height of the hands above their grasps.
        hold_s: Standstill, position-driven.
        force_s: Shortest force ramp, or standstill, force-driven.
        limits: Limits of the object or the hands; None takes the planner's.
    """

    rise_m: float = 0.0
    hold_s: float = 0.0
    force_s: float = 0.0
    limits: PathLimits | None = None


_SLOW = PathLimits(speed_m_per_s=0.15, acceleration_m_per_s2=0.6)

PHASES = {
    "approach": Phase(rise_m=0.08),
    "descend": Phase(limits=_SLOW),
    "close": Phase(hold_s=0.2),  # after the travel of the fingers
    "squeeze": Phase(force_s=0.3),
    "lift": Phase(limits=_SLOW),
    "carry": Phase(limits=PathLimits(speed_m_per_s=0.35, acceleration_m_per_s2=1.0)),
    "lower": Phase(limits=_SLOW),
    "insert": Phase(
        hold_s=0.6,
        force_s=2.0,
        limits=PathLimits(speed_m_per_s=0.015, acceleration_m_per_s2=0.3),
    ),
    "settle": Phase(hold_s=0.2, force_s=0.1),
    "unload": Phase(force_s=0.2),
    "open": Phase(hold_s=0.5, force_s=0.3),
    "retreat": Phase(rise_m=0.10, limits=_SLOW),
    "home": Phase(),
}
