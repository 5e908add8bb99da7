"""How hard two fingers must pinch, so that their pads carry the squeeze by friction.

The fingers close across the object, the hands squeeze along it: the squeeze F lies in the plane of the pads, where
friction alone can carry it. So does each hand's half of the object's weight and inertia m (g + a). With the object's
axis tilted by theta, one hand carries in the pads' plane

    along  F + m (g + a) sin(theta) / 2          across  m (g + a) cos(theta) / 2

and two pads pressed by N each resist up to 2 mu N in any direction of that plane (Coulomb), hence

    N >= safety sqrt(along^2 + across^2) / (2 mu)

For a light object this is the rule f_int < 2 mu F_pinch. The pads' torsional friction and their size are left out: they
hold the object's turning about the line between the pads, which the torsional springs of the hands see to.
"""

from __future__ import annotations

import math

from minidual.errors import UsageError

SAFETY = 1.5
"""Factor on the pinch: friction varies by some tenths between pads and days."""
_GRAVITY = 9.81


def pinch_force(
    squeeze_n: float,
    mu: float,
    mass_kg: float = 0.0,
    *,
    safety: float = SAFETY,
    tilt_rad: float = 0.0,
    acceleration_m_per_s2: float = 0.0,
) -> float:
    """Return the normal force of each finger [N] with which the pads carry a squeeze.

    Args:
        squeeze_n: Internal force along the object.
        mu: Coefficient of friction between pad and object.
        mass_kg: Of the object; each hand carries half.
        safety: At least 1.
        tilt_rad: Largest angle between the object's axis and the horizontal.
        acceleration_m_per_s2: Largest upward acceleration.

    Raises:
        UsageError: A value without meaning, named with its bound.
    """
    if not mu > 0.0:
        raise UsageError(f"friction coefficient {mu}: must be above 0, no pinch holds without friction")
    if not mass_kg >= 0.0:
        raise UsageError(f"mass {mass_kg} kg: must be at least 0")
    if not safety >= 1.0:
        raise UsageError(f"safety factor {safety}: must be at least 1")
    if not squeeze_n >= 0.0:
        raise UsageError(f"squeeze {squeeze_n} N: must be at least 0, hands do not pull")
    half = 0.5 * mass_kg * (_GRAVITY + acceleration_m_per_s2)
    along, across = half * abs(math.sin(tilt_rad)), half * math.cos(tilt_rad)
    return safety * math.hypot(squeeze_n + along, across) / (2.0 * mu)
