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
from collections.abc import Mapping
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
from minidual.plant.fields import TAMPERED, shape_misfit
from minidual.robot.pair import Array, Robot, robot_from

FORMAT = "minidual-recording"
VERSION = 3
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""Everything the next step depends on, including the solver's warm start."""

_BYTES_MAX = 2**30
_LIBRARIES = ("mujoco", "numpy", "pin", "example-robot-data")
_ARRAYS = {"controls": 2, "keyframe_steps": 1, "keyframes": 2, "push_steps": 1, "pushes": 3}
"""Number of dimensions; steps are int64, all others float64."""
_MODEL_PREFIX = "model."
_TIME_ROUNDING_S = 1e-6
type _AnyArray = npt.NDArray[Any]


class Recording(StrictModel, arbitrary_types_allowed=True):
    """A replayable stretch of simulation.

    Attributes:
        kind: "dump" (last second before a reflex or divergence) or "trial".
        reason: Why it was written.
        arm: Name of the arm model.
        libraries: Versions that made it.
        seed: Of the trial, or None.
        details: Anything more that the writer tells.
        controls: (T, nu).
        keyframe_steps: (K,), from 0 to T; T is missing after a reset or divergence.
        keyframes: (K, n).
        push_steps: (P,), first step of each push.
        pushes: (P, nbody, 6).
        model: Physical fields by name.
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


def check_shapes(model: mujoco.MjModel, recording: Recording) -> None:
    """Raise DataError if controls, keyframes or pushes do not fit the model."""
    row_shapes = {
        "controls": (model.nu,),
        "keyframes": (mujoco.mj_stateSize(model, STATE),),
        "pushes": (model.nbody, 6),
    }
    for name, shape in row_shapes.items():
        recorded_shape = getattr(recording, name).shape[1:]
        if recorded_shape != shape:
            raise shape_misfit(f"a row of the model's {name}", shape, recorded_shape)


# Writing ------------------------------------------------------------------------------------------


def write_recording(path: Path, recording: Recording) -> Path:
    """Write a recording durably; return its path."""
    header = recording.model_dump(exclude={*_ARRAYS, "model", "details"})
    header["details"] = recording.details
    header["format"] = FORMAT
    header["version"] = VERSION
    arrays: dict[str, _AnyArray] = {name: getattr(recording, name) for name in _ARRAYS}
    for name, values in recording.model.items():
        arrays[_MODEL_PREFIX + name] = values
    arrays["header"] = np.frombuffer(json.dumps(header, default=dict).encode(), dtype=np.uint8)
    arrays["digest"] = _digest(arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return path


def _digest(arrays: Mapping[str, _AnyArray]) -> npt.NDArray[np.uint8]:
    """Return the sha256 (32,) of the arrays with their names, types and shapes."""
    sha256 = hashlib.sha256()
    for name, values in sorted(arrays.items()):
        sha256.update(f"{name} {values.dtype.str} {values.shape}".encode())
        sha256.update(values.tobytes())
    return np.frombuffer(sha256.digest(), dtype=np.uint8)


# Reading ------------------------------------------------------------------------------------------


def read_recording(path: Path) -> Recording:
    """Read a recording; `check_shapes` and `apply_physical_fields` compare it with the model.

    Raises:
        DataError: Missing, damaged, changed, or of another version.
    """
    kind = kind_of(path)
    if kind != "file":
        raise DataError(
            f"{path} is a {kind}, not a recording" if kind else f"there is no file {path}",
            remedy="`minidual carry` writes some, and a reflex names its dump",
        )
    remedy = "record it again, or check that the copy is complete"
    arrays = _read_arrays(path, remedy)
    try:
        header = json.loads(arrays["header"].tobytes())
        if header["format"] != FORMAT:
            raise ValueError(f"its format is '{header['format']}', not '{FORMAT}'")
        maker = header["libraries"]["minidual"]
        remedy = f"record it again, or replay it with the minidual {maker} that made it"
        if header["version"] != VERSION:
            raise ValueError(
                f"it has version {header['version']} of the format; "
                f"this minidual reads version {VERSION}",
            )
        recording = _validated(header, arrays)
        remedy = TAMPERED
        _check_arrays(arrays)
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


def _read_arrays(path: Path, remedy: str) -> dict[str, _AnyArray]:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(item.file_size for item in archive.infolist())
        if size > _BYTES_MAX:
            raise ValueError(f"unpacked it has {size} bytes, more than {_BYTES_MAX}")
        with np.load(path, allow_pickle=False) as stored:
            return dict(stored)
    except Exception as error:  # zipfile, its decompressors and numpy each raise their own
        raise DataError(f"{path} is no whole recording: {error}", remedy=remedy) from error


def _validated(header: dict[str, Any], arrays: Mapping[str, _AnyArray]) -> Recording:
    """Return the recording of a header and arrays; ValidationError names the first misfit."""
    values = {name: value for name, value in header.items() if name not in ("format", "version")}
    values["model"] = {
        name.removeprefix(_MODEL_PREFIX): array
        for name, array in arrays.items()
        if name.startswith(_MODEL_PREFIX)
    }
    for name in _ARRAYS:
        values[name] = arrays[name]
    return Recording.model_validate(values)


def _check_arrays(arrays: Mapping[str, _AnyArray]) -> None:
    """Raise ValueError if the arrays do not fit their digest, or their types are others."""
    digest = arrays["digest"]
    others = {name: values for name, values in arrays.items() if name != "digest"}
    if digest.tobytes() != _digest(others).tobytes():
        raise ValueError("its content does not fit its digest")
    fields = [name for name in arrays if name.startswith(_MODEL_PREFIX)]
    for name in (*_ARRAYS, *fields):
        values = arrays[name]
        dtype = np.int64 if name.endswith("_steps") else np.float64
        dimensions = _ARRAYS.get(name, values.ndim)
        if values.dtype != dtype or values.ndim != dimensions:
            raise ValueError(f"{name} is {values.ndim}-dimensional {values.dtype}")


def _check_steps(recording: Recording) -> None:
    """Raise ValueError unless there are controls and a first state, and steps and times grow."""
    steps = recording.keyframe_steps
    count = recording.steps
    begins_at_0 = len(steps) > 0 and steps[0] == 0
    if not (count and begins_at_0 and recording.keyframes.size):
        raise ValueError("it lacks controls, or the state before the first")
    _check_growth("keyframe", steps, len(recording.keyframes), count)
    _check_growth("push", recording.push_steps, len(recording.pushes), count)
    times_s = recording.start_s + steps * recording.dt_s
    off_s = np.abs(recording.keyframes[:, 0] - times_s).max()
    if not off_s <= _TIME_ROUNDING_S:  # true for NaN
        raise ValueError(f"the times of its keyframes are not {recording.dt_s:g} s a step apart")


def _check_growth(name: str, steps: npt.NDArray[np.int64], rows: int, count: int) -> None:
    grow = (np.diff([-1, *steps, count + 1]) > 0).all()
    if len(steps) != rows or not grow:
        raise ValueError(
            f"its {name} steps do not grow from 0 to {count}, one for each of {rows} rows",
        )
