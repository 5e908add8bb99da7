"""Tables of objects and motions of a carry (docs/carry.md); a row is configuration defaults {dotted path: value}.

An object's row may state its `safety` against slipping.
"""

from collections.abc import Mapping
from typing import Any

from minidual.control.gripper import SAFETY, pinch_force
from minidual.registry import Registry, rows_beside

_HELD = "carry.impedance.internal_force_n", "scene.object.friction", "scene.object.mass_kg"


def with_pinch(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with the pinch that its squeeze needs, at its `safety`."""
    values = {"safety": SAFETY, **row}
    safety = values.pop("safety")
    known: list[Any] = [row.get(path) for path in _HELD]
    if None not in known:
        values.setdefault("carry.impedance.pinch_n", round(pinch_force(*known, safety=safety), 1))
    return values


_ROWS: dict[str, dict[str, dict[str, Any]]] = rows_beside(__file__)
OBJECTS: Registry[Mapping[str, Any]] = Registry(
    "object",
    _ROWS["objects"],
    group="minidual.objects",
)
MOTIONS: Registry[Mapping[str, Any]] = Registry(
    "motion",
    _ROWS["motions"],
    group="minidual.motions",
)
