"""Phases of handling an object and their parameters.

Position-driven phases are planned and timed; force-driven phases use object impedance and felt contact.
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
        force_s: Shortest force ramp.
        limits: Of the object or hands; None: the planner's.
    """

    name: str
    open: bool
    rise_m: float = 0.0
    hold_s: float = 0.0
    force_s: float = 0.0
    limits: PathLimits | None = None


_SLOW = PathLimits(speed_m_per_s=0.15, acceleration_m_per_s2=0.6)

PHASES: dict[str, Phase] = {
    phase.name: phase
    for phase in (
        Phase("approach", open=True, rise_m=0.08),
        Phase("descend", open=True, limits=_SLOW),
        Phase("close", open=False, hold_s=0.7),
        Phase("squeeze", open=False, force_s=0.3),
        Phase("lift", open=False, limits=_SLOW),
        Phase("carry", open=False, limits=PathLimits(speed_m_per_s=0.35, acceleration_m_per_s2=1.0)),
        Phase("lower", open=False, limits=_SLOW),
        Phase("settle", open=False, hold_s=0.2, force_s=0.1),
        Phase("unload", open=False, force_s=0.2),
        Phase("open", open=True, hold_s=0.5, force_s=0.3),
        Phase("retreat", open=True, rise_m=0.10, limits=_SLOW),
        Phase("home", open=True),
    )
}
