"""Contact parameters and groups of geoms."""

from typing import NamedTuple

GROUP_VISUAL = 1
GROUP_MARKER = 2
GROUP_COLLISION = 3

INTANGIBLE: dict[str, int] = {"contype": 0, "conaffinity": 0}
"""Keywords of a geom without contacts."""

# Stiff contacts with little creep. Stiffer ones lose contact for single steps
# (docs/simulation.md).
SOLREF = [0.0025, 1.0]
SOLIMP = [0.985, 0.9985, 0.001, 0.5, 2.0]


class Surface(NamedTuple):
    """Contact parameters of a geom, as MuJoCo names them."""

    condim: int
    margin: float
    solimp: list[float]


ROUND = Surface(6, 0.0, SOLIMP)
"""With rolling friction: without it a cylinder rolls away by itself."""
FLAT = Surface(4, 0.0002, [0.955, 0.9955, 0.001, 0.5, 2.0])
"""Faces do not roll; rolling friction at many contact points over-constrains them.

Flat faces share a load between many points, each so shallow that it parts at the slightest motion.
Softer faces, whose contact begins 0.2 mm before they touch, keep contact (docs/simulation.md).
"""
