"""Table of objects to carry, with internal force and stiffness.

Parallel grippers hold them from above: 80 mm opening, pads 3 mm over the axis.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from minidual.control.pinch import SAFETY, pinch_force
from minidual.registry import Registry


@dataclass(frozen=True)
class CarryObject:
    """One object.

    Attributes:
        squeeze_range_n: Recommended internal force.
        stiffness_range_n_per_m: Recommended translational stiffness.
        values: Configuration defaults {dotted path: value}.
    """

    summary: str
    squeeze_range_n: tuple[float, float]
    stiffness_range_n_per_m: tuple[float, float]
    values: Mapping[str, Any] = field(default_factory=dict)


def _values(
    body: Mapping[str, Any], squeeze_n: float, stiffness_n_per_m: float, safety: float = SAFETY, **others: float
) -> dict[str, Any]:
    """Return configuration values; `others` belong to `carry.impedance`."""
    pinch = round(pinch_force(squeeze_n, body["friction"], body["mass_kg"], safety=safety), 1)
    gains = {"internal_force_n": squeeze_n, "stiffness_n_per_m": stiffness_n_per_m, "pinch_n": pinch, **others}
    values = {f"scene.object.{k}": v for k, v in body.items()}
    return values | {f"carry.impedance.{k}": v for k, v in gains.items()}


_BOARD: dict[str, Any] = {
    "shape": "box",
    "length_m": 0.40,
    "width_m": 0.05,
    "height_m": 0.03,
    "mass_kg": 1.0,
    "friction": 0.7,
    "grasp_offset_m": 0.16,
    "colour": (0.63, 0.44, 0.26, 1.0),
}
_BOX: dict[str, Any] = {
    "shape": "box",
    "length_m": 0.30,
    "width_m": 0.06,
    "height_m": 0.06,
    "mass_kg": 0.5,
    "friction": 0.3,
    "colour": (0.36, 0.55, 0.72, 1.0),
}
_GLASS: dict[str, Any] = {
    "radius_m": 0.01,
    "mass_kg": 0.15,
    "friction": 0.4,
    "break_force_n": 20.0,
    "break_pinch_n": 40.0,
    "colour": (0.62, 0.84, 0.86, 0.55),
}

OBJECTS: Registry[CarryObject] = Registry(
    "object",
    {
        "rod": CarryObject("aluminium rod, 30 cm, 0.2 kg", (25.0, 40.0), (300.0, 500.0)),
        # Twice the usual safety: on a flat face, pads lose contact for one step in 3 of 10 carries at 30 N, in 0 of 12
        # at 60 N.
        "board": CarryObject(
            "laminate board, 40 x 5 x 3 cm, 1.0 kg",
            (20.0, 30.0),
            (400.0, 600.0),
            _values(_BOARD, 27.0, 500.0, safety=3.0),
        ),
        # The hand allows 70 N continuously, 140 N at most; a carry lasts seconds.
        "box": CarryObject(
            "plastic box, 30 x 6 x 6 cm, 0.5 kg",
            (40.0, 60.0),
            (300.0, 500.0),
            {**_values(_BOX, 42.0, 400.0), "scene.physics.finger_force_max_n": 110.0},
        ),
        # Slow landing: with low stiffness the tracking error of a fast one becomes an impact.
        "glass": CarryObject(
            "glass tube, 30 cm, 0.15 kg, breaks at 20 N of a hand or 40 N of pinch",
            (10.0, 15.0),
            (100.0, 200.0),
            {
                **_values(_GLASS, 13.0, 200.0, force_correction_max_n=3.0),
                "carry.pace.object_acceleration_m_per_s2": 0.9,
                "carry.pace.landing_m": 0.003,
                "carry.pace.landing_s": 0.35,
            },
        ),
    },
    group="minidual.objects",
)
