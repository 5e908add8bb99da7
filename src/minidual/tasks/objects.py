"""Tables of objects and motions of a carry (docs/carry.md); a row is configuration defaults {dotted path: value}."""

from collections.abc import Mapping
from typing import Any

from minidual.control.gripper import SAFETY, pinch_force
from minidual.registry import Registry, rows_beside


def with_pinch(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with the pinch that its squeeze needs, at its `safety`."""
    values = {"safety": SAFETY, **row}
    safety = values.pop("safety")
    if "carry.impedance.internal_force_n" in row:
        held = (row[f"scene.object.{name}"] for name in ("friction", "mass_kg"))
        pinch_n = pinch_force(row["carry.impedance.internal_force_n"], *held, safety=safety)
        values["carry.impedance.pinch_n"] = round(pinch_n, 1)
    return values


_ROWS: dict[str, dict[str, dict[str, Any]]] = rows_beside(__file__)
_OBJECTS = {name: with_pinch(row) for name, row in _ROWS["objects"].items()}
OBJECTS: Registry[Mapping[str, Any]] = Registry("object", _OBJECTS, group="minidual.objects")
MOTIONS: Registry[Mapping[str, Any]] = Registry("motion", _ROWS["motions"], group="minidual.motions")
