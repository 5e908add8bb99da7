"""Physical fields of a MuJoCo model that trials may change."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.errors import DataError
from minidual.robot.pair import Array

TAMPERED = "the file was changed after it was written; record it again"
"""Remedy for a recording with values that no world has."""

_BODY = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_subtreemass",
    "body_invweight0",
)
_JOINT = (
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "dof_invweight0",
    "dof_M0",
    "jnt_range",
    "jnt_stiffness",
)
_MOTOR = ("actuator_gainprm", "actuator_biasprm", "actuator_ctrlrange", "actuator_forcerange")
_GEOM = ("geom_size", "geom_friction", "geom_solref", "geom_solimp", "geom_margin", "geom_condim")
"""Of geoms with contacts only."""
_OPTION_PREFIX = "opt."
_OPTIONS = (
    "timestep",
    "gravity",
    "impratio",
    "integrator",
    "cone",
    "solver",
    "iterations",
    "tolerance",
)
_CHOICES: dict[str, Sequence[int]] = {
    "geom_condim": (1, 3, 4, 6),
    "opt.integrator": range(len(mujoco.mjtIntegrator.__members__)),
    "opt.cone": range(len(mujoco.mjtCone.__members__)),
    "opt.solver": range(len(mujoco.mjtSolver.__members__)),
    "opt.iterations": range(1, 1001),
}
_SIGNED = ("body_ipos", "body_iquat", "jnt_range", *_MOTOR, "geom_solref", "opt.gravity")
"""Fields that may be negative."""


def _with_contacts(model: mujoco.MjModel) -> npt.NDArray[np.bool_]:
    return (model.geom_contype != 0) | (model.geom_conaffinity != 0)


def physical_fields(model: mujoco.MjModel) -> dict[str, Array]:
    """Return copies of the fields that trials may change."""
    solid = _with_contacts(model)
    fields: dict[str, Array] = {}
    for name in (*_BODY, *_JOINT, *_MOTOR):
        fields[name] = np.array(getattr(model, name), dtype=float)
    for name in _GEOM:
        fields[name] = np.array(getattr(model, name)[solid], dtype=float)
    for name in _OPTIONS:
        fields[_OPTION_PREFIX + name] = np.array(getattr(model.opt, name), dtype=float)
    return fields


def apply_physical_fields(model: mujoco.MjModel, fields: Mapping[str, Array]) -> list[str]:
    """Write recorded fields; return which differed.

    Raises:
        DataError: A field is missing, of another shape, or holds a value that no model has.
    """
    changed: list[str] = []
    for name, values in physical_fields(model).items():
        recorded = fields.get(name)
        recorded_shape = None if recorded is None else recorded.shape
        if recorded is None or recorded_shape != values.shape:
            raise shape_misfit(f"the model's {name}", values.shape, recorded_shape)
        _check_field(name, recorded, float(model.opt.timestep))
        if not np.array_equal(recorded, values):
            changed.append(name)
            _write_field(model, name, recorded)
    return changed


def _write_field(model: mujoco.MjModel, name: str, values: Array) -> None:
    if name.startswith(_OPTION_PREFIX):
        option = name.removeprefix(_OPTION_PREFIX)
        if values.ndim:
            setattr(model.opt, option, values)
        else:
            kind = type(getattr(model.opt, option))
            setattr(model.opt, option, kind(values.item()))
    elif name in _GEOM:
        getattr(model, name)[_with_contacts(model)] = values
    else:
        getattr(model, name)[...] = values


def _check_field(name: str, values: Array, timestep_s: float) -> None:
    """Refuse values that crash MuJoCo or make another experiment."""
    if name in _CHOICES:
        fits = np.isin(values, _CHOICES[name])
        bound = f"one of {', '.join(map(str, _CHOICES[name]))}"
    elif name == "opt.timestep":
        fits = values == timestep_s
        bound = f"the scene's {timestep_s:g}"
    else:
        low = -mujoco.mjMAXVAL if name in _SIGNED else 0.0
        fits = (low <= values) & (values <= mujoco.mjMAXVAL)  # false for NaN
        bound = f"from {low:g} to {mujoco.mjMAXVAL:g}"
    if not fits.all():
        raise DataError(
            f"the recording's {name} is {values[~fits].flat[0]:g}; it must be {bound}",
            remedy=TAMPERED,
        )


def shape_misfit(
    name: str,
    shape: tuple[int, ...],
    recorded_shape: tuple[int, ...] | None,
) -> DataError:
    """Return the error of an array whose recorded shape does not fit the model."""
    return DataError(
        f"{name} has shape {shape}, the recording's {recorded_shape}",
        remedy="it was made with another robot or scene; replay it with the version that made it",
    )
