"""The phases of handling an object, with their numbers. Every cycle reads them here.

A phase is driven by position (planned joint motions; the hands close and open by the clock) or by force (object
impedance; a hand counts as closed when both fingers feel the pinch, and the squeeze is ramped).
"""

from __future__ import annotations

from dataclasses import dataclass

from minidual.motion.held.path import ObjectLimits


@dataclass(frozen=True)
class Phase:
    """One row of the table.

    Attributes:
        name: As methods, records and films name it.
        open: Whether the hands that act are open during it.
        rise_m: Height of the hands over their grasps at the end of the phase, where it moves them up or down.
        hold_s: How long the arms hold still, driven by position.
        force_s: Least duration of the phase's ramp, driven by force.
        limits: Speed and acceleration of the object, or of the hands that go to it; None is up to the planner.
    """

    name: str
    open: bool
    rise_m: float = 0.0
    hold_s: float = 0.0
    force_s: float = 0.0
    limits: ObjectLimits | None = None


_SLOW = ObjectLimits(speed_m_per_s=0.15, acceleration_m_per_s2=0.6)

PHASES: dict[str, Phase] = {
    phase.name: phase
    for phase in (
        Phase("approach", open=True, rise_m=0.08),
        Phase("descend", open=True, limits=_SLOW),
        Phase("close", open=False, hold_s=0.7),
        Phase("squeeze", open=False, force_s=0.3),
        Phase("lift", open=False, limits=_SLOW),
        Phase("carry", open=False, limits=ObjectLimits(speed_m_per_s=0.35, acceleration_m_per_s2=1.0)),
        Phase("lower", open=False, limits=_SLOW),
        Phase("settle", open=False, hold_s=0.2, force_s=0.1),
        Phase("unload", open=False, force_s=0.2),
        Phase("open", open=True, hold_s=0.5, force_s=0.3),
        Phase("retreat", open=True, rise_m=0.10, limits=_SLOW),
        Phase("home", open=True),
    )
}
