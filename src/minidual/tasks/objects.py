"""What can be carried: one explicit table, each row an object with the squeeze and the stiffness it is carried with.

Shapes are chosen so that two parallel grippers can hold them from above: 80 mm of opening, pads 3 mm over the axis.
Squeeze and stiffness lie in the range that is recommended for the object. Pads carry the squeeze by friction, so the
pinch follows from it (control/pinch.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel

from minidual.config.root import Config
from minidual.control.pinch import pinch_force
from minidual.errors import unknown_name


@dataclass(frozen=True)
class CarryObject:
    """One row of the catalogue.

    Attributes:
        name: As typed.
        summary: One line for people.
        squeeze_range_n: Recommended internal force, least and most.
        stiffness_range_n_per_m: Recommended translational stiffness, least and most.
        rod: Values of `scene.rod`.
        impedance: Values of `carry.impedance`.
        physics: Values of `scene.physics`.
        pace: Values of `carry.pace`.
    """

    name: str
    summary: str
    squeeze_range_n: tuple[float, float]
    stiffness_range_n_per_m: tuple[float, float]
    rod: Mapping[str, Any] = field(default_factory=dict)
    impedance: Mapping[str, float] = field(default_factory=dict)
    physics: Mapping[str, float] = field(default_factory=dict)
    pace: Mapping[str, float] = field(default_factory=dict)


def _rounded(force_n: float) -> float:
    return round(force_n, 1)


OBJECTS: dict[str, CarryObject] = {
    row.name: row
    for row in (
        CarryObject("rod", "aluminium rod, 30 cm, 0.2 kg", (25.0, 40.0), (300.0, 500.0)),
        # Twice the usual safety: pads that press a flat face with 30 N now and then lose it for one step of simulated
        # contact (3 of 10 carries), with 60 N they do not (12 of 12).
        CarryObject(
            "board",
            "laminate board, 40 x 5 x 3 cm, 1.0 kg",
            (20.0, 30.0),
            (400.0, 600.0),
            rod={
                "shape": "box",
                "length_m": 0.40,
                "width_m": 0.05,
                "height_m": 0.03,
                "mass_kg": 1.0,
                "friction": 0.7,
                "grasp_offset_m": 0.16,
                "colour": (0.63, 0.44, 0.26, 1.0),
            },
            impedance={
                "internal_force_n": 27.0,
                "stiffness_n_per_m": 500.0,
                "pinch_n": _rounded(pinch_force(27.0, 0.7, 1.0, safety=3.0)),
            },
        ),
        CarryObject(
            "box",
            "plastic box, 30 x 6 x 6 cm, 0.5 kg",
            (40.0, 60.0),
            (300.0, 500.0),
            rod={
                "shape": "box",
                "length_m": 0.30,
                "width_m": 0.06,
                "height_m": 0.06,
                "mass_kg": 0.5,
                "friction": 0.3,
                "colour": (0.36, 0.55, 0.72, 1.0),
            },
            impedance={
                "internal_force_n": 42.0,
                "stiffness_n_per_m": 400.0,
                "pinch_n": _rounded(pinch_force(42.0, 0.3, 0.5)),
            },
            # More than the hand's continuous 70 N and within its 140 N maximum: a carry lasts seconds.
            physics={"finger_force_max_n": 110.0},
        ),
        CarryObject(
            "glass",
            "glass tube, 30 cm, 0.15 kg, breaks at 20 N of a hand or 40 N of pinch",
            (10.0, 15.0),
            (100.0, 200.0),
            rod={
                "radius_m": 0.01,
                "mass_kg": 0.15,
                "friction": 0.4,
                "break_force_n": 20.0,
                "break_pinch_n": 40.0,
                "colour": (0.62, 0.84, 0.86, 0.55),
            },
            impedance={
                "internal_force_n": 13.0,
                "stiffness_n_per_m": 200.0,
                "pinch_n": _rounded(pinch_force(13.0, 0.4, 0.15)),
                "force_correction_max_n": 3.0,
            },
            # It lands softly: a soft spring follows a fast motion less closely, and what is left is a blow.
            pace={"object_acceleration_m_per_s2": 0.9, "landing_m": 0.003, "landing_s": 0.35},
        ),
    )
}


def object_spec(name: str) -> CarryObject:
    """Return the row of an object, or say which exist."""
    if name not in OBJECTS:
        raise unknown_name("object", name, OBJECTS)
    return OBJECTS[name]


def with_object(config: Config) -> Config:
    """Return the configuration for the object that `carry.object` names.

    The table's values take the place of defaults; what a profile or `--set` names stays as it was set. The least
    internal force of the success test is lowered to the low end of the object's own range where that is below it, and
    never raised or lowered otherwise.
    """
    spec = object_spec(config.carry.object)
    scene, carry = config.scene, config.carry
    task = scene.task
    least = min(task.internal_force_min_n, spec.squeeze_range_n[0])
    scene = replaced(
        scene,
        rod=filled(scene.rod, **spec.rod),
        physics=filled(scene.physics, **spec.physics),
        task=task if least == task.internal_force_min_n else replaced(task, internal_force_min_n=least),
    )
    impedance, pace = filled(carry.impedance, **spec.impedance), filled(carry.pace, **spec.pace)
    return replaced(config, scene=scene, carry=replaced(carry, impedance=impedance, pace=pace))


def filled[M: BaseModel](section: M, **values: Any) -> M:
    """Return a section with values where nobody has set another; in a part that is set, what it leaves open is filled.

    Raises:
        pydantic.ValidationError: The values do not go together.
    """
    wanted: dict[str, Any] = {}
    for name, value in values.items():
        now = getattr(section, name)
        if name not in section.model_fields_set:
            wanted[name] = value
        elif isinstance(now, BaseModel) and isinstance(value, BaseModel):
            wanted[name] = filled(now, **{k: getattr(value, k) for k in value.model_fields_set})
    return replaced(section, **wanted)


def replaced[M: BaseModel](section: M, **values: Any) -> M:
    """Return a validated copy with these values; fields that nobody set stay unset."""
    known = {name: getattr(section, name) for name in section.model_fields_set}
    return type(section).model_validate({**known, **values})
