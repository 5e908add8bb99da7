"""Recording file for replay: npz without pickle.

header      JSON: format, version, kind, reason, arm, scene, seed, libraries, details
controls    (T, nu) `ctrl` of every step
keyframes   (K, n) MuJoCo states before keyframe_steps[k], and at the end
push_steps, pushes   external wrenches (nbody, 6) at each change
model.*     physical model fields
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

import minidual
from minidual.config.robot import RobotConfig
from minidual.config.scene import SceneConfig
from minidual.durable import replacing
from minidual.errors import DataError
from minidual.robot.arms import robot_from
from minidual.robot.pair import Array, Robot

FORMAT = "minidual-recording"
VERSION = 2
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""Everything the next step depends on, including the solver's warm start."""

_LIBRARIES = ("mujoco", "numpy", "pin", "example-robot-data")
_BODY = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_subtreemass", "body_invweight0")
_JOINT = ("dof_armature", "dof_damping", "dof_frictionloss", "dof_invweight0", "dof_M0", "jnt_range", "jnt_stiffness")
_MOTOR = ("actuator_gainprm", "actuator_biasprm", "actuator_ctrlrange", "actuator_forcerange")
_GEOM = ("geom_size", "geom_friction", "geom_solref", "geom_solimp", "geom_margin", "geom_condim")
_OPTIONS = ("timestep", "gravity", "impratio", "integrator", "cone", "solver", "iterations", "tolerance")


@dataclass(frozen=True)
class Recording:
    """A replayable stretch of simulation.

    Attributes:
        kind: "dump" (last second before a reflex or divergence) or "trial".
        keyframe_steps: (K,), from 0 to T; T is missing after a reset or divergence.
        push_steps: (P,) first steps.
    """

    kind: str
    reason: str
    arm: str
    scene: SceneConfig
    controls: Array
    keyframe_steps: npt.NDArray[np.int64]
    keyframes: Array
    push_steps: npt.NDArray[np.int64]
    pushes: Array
    model: Mapping[str, Array]
    libraries: Mapping[str, str]
    seed: int | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

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
    own = {"minidual": minidual.__version__, "python": platform.python_version(), "machine": platform.machine()}
    return own | {name: importlib.metadata.version(name) for name in _LIBRARIES}


def physical_fields(model: mujoco.MjModel) -> dict[str, Array]:
    """Return copies of the fields that trials may change."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    fields = {name: np.array(getattr(model, name), dtype=float) for name in (*_BODY, *_JOINT, *_MOTOR)}
    fields |= {name: np.array(getattr(model, name)[solid], dtype=float) for name in _GEOM}
    return fields | {f"opt.{name}": np.array(getattr(model.opt, name), dtype=float) for name in _OPTIONS}


def apply_physical_fields(model: mujoco.MjModel, fields: Mapping[str, Array]) -> list[str]:
    """Write recorded fields; return which differed.

    Raises:
        DataError: A field is missing or of another shape.
    """
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    now = physical_fields(model)
    changed = []
    for name, values in now.items():
        recorded = fields.get(name)
        if recorded is None or recorded.shape != values.shape:
            shape = None if recorded is None else recorded.shape
            raise DataError(
                f"the model's {name} has shape {values.shape}, the recording's {shape}",
                remedy="it was made with another robot or scene; replay it with the version that made it",
            )
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


_HEADER = ("kind", "reason", "arm", "libraries", "seed", "details")
_ARRAYS = ("controls", "keyframe_steps", "keyframes", "push_steps", "pushes")


def write_recording(path: Path, recording: Recording) -> Path:
    """Write a recording durably."""
    header = {name: getattr(recording, name) for name in _HEADER}
    header |= {"format": FORMAT, "version": VERSION, "scene": recording.scene.model_dump(mode="json")}
    arrays = {name: getattr(recording, name) for name in _ARRAYS}
    arrays |= {f"model.{name}": values for name, values in recording.model.items()}
    arrays["header"] = np.frombuffer(json.dumps(header, default=dict).encode(), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return path


def read_recording(path: Path) -> Recording:
    """Read a recording.

    Raises:
        DataError: Missing, damaged, or of another version.
    """
    if not path.is_file():
        raise DataError(f"there is no file {path}", remedy="dumps lie in the folder that the error message named")
    remedy = "record it again, or check that the copy is complete"
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = dict(stored)
        header = json.loads(arrays["header"].tobytes())
        if header["format"] != FORMAT:
            raise ValueError(f"its format is '{header['format']}', not '{FORMAT}'")
        remedy = f"replay it with minidual {header['libraries']['minidual']}, which made it"
        if header["version"] != VERSION:
            raise ValueError(f"it has version {header['version']} of the format; this minidual reads version {VERSION}")
        return Recording(
            scene=SceneConfig.model_validate(header["scene"]),
            model={name[6:]: values for name, values in arrays.items() if name.startswith("model.")},
            **{name: header[name] for name in _HEADER},
            **{name: arrays[name] for name in _ARRAYS},
        )
    except ValidationError as error:
        settings = ", ".join(".".join(map(str, item["loc"])) for item in error.errors())
        raise DataError(f"{path} has a scene that this version does not know: {settings}", remedy=remedy) from error
    except KeyError as error:
        raise DataError(f"{path} is no recording: it lacks {error}", remedy=remedy) from error
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, TypeError, ValueError, NotImplementedError) as error:
        raise DataError(f"{path} is no whole recording: {error}", remedy=remedy) from error
