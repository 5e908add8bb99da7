"""Recording file for replay: npz without pickle.

header      JSON: format, version, kind, reason, arm, scene, seed, libraries, details
controls    (T, nu) `ctrl` of every step
keyframes   (K, n) MuJoCo states before keyframe_steps[k], and at the end
push_steps, pushes   external wrenches (nbody, 6) at each change
model.*     physical model fields
digest      sha256 of the others: finds damage, not forgery
"""

import hashlib
import importlib.metadata
import json
import platform
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
import numpy.typing as npt
from pydantic import Field, SkipValidation, ValidationError

import minidual
from minidual.config.base import StrictModel
from minidual.config.scene import RobotConfig, SceneConfig
from minidual.durable import kind_of, replacing
from minidual.errors import DataError
from minidual.robot.pair import Array, Robot, robot_from

FORMAT = "minidual-recording"
VERSION = 3
_BYTES_MAX = 2**30
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""Everything the next step depends on, including the solver's warm start."""

_LIBRARIES = ("mujoco", "numpy", "pin", "example-robot-data")
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


class Recording(StrictModel, arbitrary_types_allowed=True):
    """A replayable stretch of simulation.

    Attributes:
        kind: "dump" (last second before a reflex or divergence) or "trial".
        keyframe_steps: (K,), from 0 to T; T is missing after a reset or divergence.
        push_steps: (P,) first steps.
    """

    kind: Literal["dump", "trial"]
    reason: str
    arm: str
    scene: SceneConfig
    libraries: dict[str, str]
    seed: int | None = None
    details: dict[str, Any] = Field(default_factory=dict)
    controls: SkipValidation[Array]
    keyframe_steps: SkipValidation[npt.NDArray[np.int64]]
    keyframes: SkipValidation[Array]
    push_steps: SkipValidation[npt.NDArray[np.int64]]
    pushes: SkipValidation[Array]
    model: SkipValidation[Mapping[str, Array]]

    @property
    def robot(self) -> Robot:
        """Arms."""
        return robot_from(RobotConfig(arm=self.arm))

    @property
    def dt_s(self) -> float:
        """Time step [s]."""
        return self.scene.physics.timestep_s

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.controls)

    @property
    def start_s(self) -> float:
        """Time before the first step [s]."""
        return float(self.keyframes[0, 0])

    @property
    def end_s(self) -> float:
        """Time after the last step [s]."""
        return self.start_s + self.steps * self.dt_s


def versions() -> dict[str, str]:
    """Return versions that affect results to the bit."""
    own = {
        "minidual": minidual.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
    }
    return own | {name: importlib.metadata.version(name) for name in _LIBRARIES}


def physical_fields(model: mujoco.MjModel) -> dict[str, Array]:
    """Return copies of the fields that trials may change."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    fields = {
        name: np.array(getattr(model, name), dtype=float) for name in (*_BODY, *_JOINT, *_MOTOR)
    }
    fields |= {name: np.array(getattr(model, name)[solid], dtype=float) for name in _GEOM}
    return fields | {
        f"opt.{name}": np.array(getattr(model.opt, name), dtype=float) for name in _OPTIONS
    }


def apply_physical_fields(model: mujoco.MjModel, fields: Mapping[str, Array]) -> list[str]:
    """Write recorded fields; return which differed.

    Raises:
        DataError: A field is missing, of another shape, or holds a value that no model has.
    """
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    now = physical_fields(model)
    changed = []
    for name, values in now.items():
        recorded = fields.get(name)
        if recorded is None or recorded.shape != values.shape:
            raise _misfit(
                f"the model's {name}",
                values.shape,
                None if recorded is None else recorded.shape,
            )
        _check_field(name, recorded, float(model.opt.timestep))
        if np.array_equal(recorded, values):
            continue
        changed.append(name)
        if name.startswith("opt."):
            old = getattr(model.opt, name[4:])
            setattr(model.opt, name[4:], recorded if recorded.ndim else type(old)(recorded.item()))
        elif name in _GEOM:
            getattr(model, name)[solid] = recorded
        else:
            getattr(model, name)[...] = recorded
    return changed


def _check_field(name: str, values: Array, timestep_s: float) -> None:
    """Refuse what MuJoCo would not survive, or would turn into another experiment."""
    low = -mujoco.mjMAXVAL if name in _SIGNED else 0.0
    fits = (low <= values) & (values <= mujoco.mjMAXVAL)  # NaN does not
    bound = f"from {low:g} to {mujoco.mjMAXVAL:g}"
    if name in _CHOICES:
        fits = np.isin(values, _CHOICES[name])
        bound = f"one of {', '.join(map(str, _CHOICES[name]))}"
    elif name == "opt.timestep":
        fits = values == timestep_s
        bound = f"the scene's {timestep_s:g}"
    if not fits.all():
        raise DataError(
            f"the recording's {name} is {values[~fits].flat[0]:g}; it must be {bound}",
            remedy=_TAMPERED,
        )


def _misfit(what: str, shape: tuple[int, ...], recorded: tuple[int, ...] | None) -> DataError:
    return DataError(
        f"{what} has shape {shape}, the recording's {recorded}",
        remedy="it was made with another robot or scene; replay it with the version that made it",
    )


def check_shapes(model: mujoco.MjModel, recording: Recording) -> None:
    """Raise DataError if controls, keyframes or pushes do not fit the model."""
    size = mujoco.mj_stateSize(model, STATE)
    for name, shape in (
        ("controls", (model.nu,)),
        ("keyframes", (size,)),
        ("pushes", (model.nbody, 6)),
    ):
        if getattr(recording, name).shape[1:] != shape:
            raise _misfit(f"a row of the model's {name}", shape, getattr(recording, name).shape[1:])


_TAMPERED = "the file was changed after it was written; record it again"
_ARRAYS = {"controls": 2, "keyframe_steps": 1, "keyframes": 2, "push_steps": 1, "pushes": 3}
"""Dimensions; steps are int64, all others float64."""


def _digest(arrays: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[np.uint8]:
    """Return the sha256 (32,) of the arrays with their names, types and shapes."""
    found = hashlib.sha256()
    for name, values in sorted(arrays.items()):
        found.update(f"{name} {values.dtype.str} {values.shape}".encode())
        found.update(values.tobytes())
    return np.frombuffer(found.digest(), dtype=np.uint8)


def write_recording(path: Path, recording: Recording) -> Path:
    """Write a recording durably."""
    header = recording.model_dump(exclude={*_ARRAYS, "model", "details"}) | {
        "details": recording.details,
    }
    header |= {"format": FORMAT, "version": VERSION}
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(recording, name) for name in _ARRAYS}
    arrays |= {f"model.{name}": values for name, values in recording.model.items()}
    arrays["header"] = np.frombuffer(json.dumps(header, default=dict).encode(), dtype=np.uint8)
    arrays["digest"] = _digest(arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return path


def read_recording(path: Path) -> Recording:
    """Read a recording; `check_shapes` and `apply_physical_fields` compare it with the model.

    Raises:
        DataError: Missing, damaged, changed, or of another version.
    """
    if (kind := kind_of(path)) != "file":
        what = f"{path} is a {kind}, not a recording" if kind else f"there is no file {path}"
        raise DataError(what, remedy="`minidual carry` writes some, and a reflex names its dump")
    remedy = "record it again, or check that the copy is complete"
    arrays = _read_arrays(path, remedy)
    try:
        header = json.loads(arrays["header"].tobytes())
        if header["format"] != FORMAT:
            raise ValueError(f"its format is '{header['format']}', not '{FORMAT}'")
        remedy = f"record it again, or replay it with the minidual {header['libraries']['minidual']} that made it"
        if header["version"] != VERSION:
            raise ValueError(
                f"it has version {header['version']} of the format; this minidual reads version {VERSION}",
            )
        fields = {name[6:]: values for name, values in arrays.items() if name.startswith("model.")}
        told = {name: value for name, value in header.items() if name not in ("format", "version")}
        recording = Recording.model_validate(
            told | {"model": fields} | {name: arrays[name] for name in _ARRAYS},
        )
        remedy = _TAMPERED
        if arrays.pop("digest").tobytes() != _digest(arrays).tobytes():
            raise ValueError("its content does not fit its digest")
        for name in (*_ARRAYS, *(f"model.{name}" for name in fields)):
            kind = np.int64 if name.endswith("_steps") else np.float64
            rank = arrays[name].ndim
            if arrays[name].dtype != kind or _ARRAYS.get(name, rank) != rank:
                raise ValueError(f"{name} is {arrays[name].ndim}-dimensional {arrays[name].dtype}")
        _check_steps(recording)
        return recording
    except ValidationError as error:
        settings = ", ".join(".".join(map(str, item["loc"])) for item in error.errors())
        raise DataError(
            f"{path} has values that this version does not know: {settings}",
            remedy=remedy,
        ) from error
    except KeyError as error:
        raise DataError(f"{path} is no recording: it lacks {error}", remedy=remedy) from error
    except (TypeError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is no whole recording: {error}", remedy=remedy) from error


def _read_arrays(path: Path, remedy: str) -> dict[str, npt.NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(item.file_size for item in archive.infolist())
        if size > _BYTES_MAX:
            raise ValueError(f"unpacked it has {size} bytes, more than {_BYTES_MAX}")
        with np.load(path, allow_pickle=False) as stored:
            return dict(stored)
    except Exception as error:  # zipfile, its decompressors and numpy each raise their own
        raise DataError(f"{path} is no whole recording: {error}", remedy=remedy) from error


def _check_steps(recording: Recording) -> None:
    steps = recording.keyframe_steps
    pushed = recording.push_steps
    count = recording.steps
    if not (count and len(steps) and steps[0] == 0 and recording.keyframes.size):
        raise ValueError("it lacks controls, or the state before the first")
    for name, numbers, rows in (
        ("keyframe", steps, recording.keyframes),
        ("push", pushed, recording.pushes),
    ):
        if len(numbers) != len(rows) or not (np.diff([-1, *numbers, count + 1]) > 0).all():
            raise ValueError(
                f"its {name} steps do not grow from 0 to {count}, one for each of {len(rows)} rows",
            )
    if (
        not np.abs(recording.keyframes[:, 0] - recording.start_s - steps * recording.dt_s).max()
        <= 1e-6
    ):
        raise ValueError(f"the times of its keyframes are not {recording.dt_s:g} s a step apart")
