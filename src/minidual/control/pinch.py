"""Pinch force with which two pads carry squeeze F and half the weight by friction.

    N >= safety sqrt(F^2 + (m g / 2)^2) / (2 mu)

Torsional friction is neglected; the hands' torsional springs hold that rotation.
"""

import math

from minidual.errors import UsageError

SAFETY = 1.5  # friction varies by some tenths between pads and days
_GRAVITY = 9.81


def pinch_force(squeeze_n: float, mu: float, mass_kg: float = 0.0, *, safety: float = SAFETY) -> float:
    """Return each finger's normal force [N].

    Raises:
        UsageError: A value is out of range.
    """
    if not mu > 0.0:
        raise UsageError(f"friction coefficient {mu}: must be above 0, no pinch holds without friction")
    if not mass_kg >= 0.0:
        raise UsageError(f"mass {mass_kg} kg: must be at least 0")
    if not safety >= 1.0:
        raise UsageError(f"safety factor {safety}: must be at least 1")
    if not squeeze_n >= 0.0:
        raise UsageError(f"squeeze {squeeze_n} N: must be at least 0, hands do not pull")
    return safety * math.hypot(squeeze_n, 0.5 * mass_kg * _GRAVITY) / (2.0 * mu)
