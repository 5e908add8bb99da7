"""Record the last second or a whole trial for replay."""

import itertools
import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np

from minidual.plant.fields import physical_fields
from minidual.plant.recording import STATE, Recording, versions, write_recording
from minidual.plant.world import World
from minidual.robot.pair import Array

_KEYFRAME_DUMP_S = 0.02
_KEYFRAME_TRIAL_S = 0.1


@dataclass
class _Stretch:
    """A keyframe and the controls of the steps after it."""

    first_step: int
    state: Array
    controls: list[Array] = field(default_factory=list)


class _Push(NamedTuple):
    """External wrenches (nbody, 6) from a step on."""

    step: int
    wrenches: Array


class Recorder:
    """Records each step of the world that has it as `recorder`; a reset starts over.

    State writes between steps are not kept: their replay deviates.

    Args:
        world: World to record.
        window_s: Time to keep; None keeps a whole trial.
        seed: Of the trial, for the file.
        folder: Of dumps; None writes none.

    Attributes:
        write_error: Error of the last dump that failed, or None.
    """

    def __init__(
        self,
        world: World,
        *,
        window_s: float | None = None,
        seed: int | None = None,
        folder: Path | None = None,
    ) -> None:
        self._world = world
        self._model = world.model
        self._data = world.data
        self._seed = seed
        self._folder = folder
        keyframe_s = _KEYFRAME_TRIAL_S if window_s is None else _KEYFRAME_DUMP_S
        self._every = max(1, round(keyframe_s / world.dt))
        stretches_max = None
        if window_s is not None:
            stretches_max = max(1, round(window_s / world.dt / self._every))
        self._stretches: deque[_Stretch] = deque(maxlen=stretches_max)
        self._pushes: list[_Push] = []
        self._ctrl = world.data.ctrl  # a view
        self._xfrc = world.data.xfrc_applied  # a view
        self._last_push = b""
        self._fields: dict[str, Array] = {}
        self._count = 0
        self._last_s = -1.0
        self.write_error: OSError | None = None

    def _continues(self) -> bool:
        """Return whether the state follows the one that was recorded last."""
        return 0.0 < self._data.time - self._last_s < 1.5 * self._world.dt

    def before_step(self) -> None:
        """Keep the next step's controls."""
        if not self._continues():
            self._begin()
        self._last_s = self._data.time
        if self._count % self._every == 0:
            self._stretches.append(_Stretch(self._count, self._state()))
        self._stretches[-1].controls.append(self._ctrl.copy())
        push = self._xfrc.tobytes()
        if push != self._last_push:
            self._last_push = push
            self._pushes.append(_Push(self._count, self._xfrc.copy()))
        self._count += 1

    def _begin(self) -> None:
        self._stretches.clear()
        self._pushes.clear()
        self._count = 0
        self._last_push = bytes(self._xfrc.nbytes)
        self._fields = physical_fields(self._model)

    def _state(self) -> Array:
        state = np.empty(mujoco.mj_stateSize(self._model, STATE))
        mujoco.mj_getState(self._model, self._data, state, STATE)
        return state

    def recording(
        self,
        reason: str,
        *,
        kind: Literal["dump", "trial"] = "trial",
        details: Mapping[str, Any] | None = None,
    ) -> Recording:
        """Return the kept second."""
        first = self._stretches[0].first_step
        steps = [stretch.first_step - first for stretch in self._stretches]
        states = [stretch.state for stretch in self._stretches]
        if self._continues():
            steps.append(self._count - first)
            states.append(self._state())
        controls = [row for stretch in self._stretches for row in stretch.controls]
        pushes = self._pushes_from(first)
        return Recording(
            kind=kind,
            reason=reason,
            arm=self._world.robot.name,
            scene=self._world.scene,
            libraries=versions(),
            seed=self._seed,
            details=dict(details or {}),
            controls=np.array(controls),
            keyframe_steps=np.array(steps),
            keyframes=np.array(states),
            push_steps=np.array([push.step for push in pushes], dtype=np.int64),
            pushes=np.array([push.wrenches for push in pushes]).reshape(-1, *self._xfrc.shape),
            model=self._fields,
        )

    def _pushes_from(self, first: int) -> list[_Push]:
        """Return the push at step `first` and the later ones, with steps counted from there."""
        pushes: list[_Push] = []
        for push in self._pushes:
            if push.step <= first:
                pushes = [_Push(0, push.wrenches)]
            else:
                pushes.append(_Push(push.step - first, push.wrenches))
        return pushes

    def dump(
        self,
        name: str,
        reason: str,
        *,
        details: Mapping[str, Any] | None = None,
    ) -> Path | None:
        """Write the window; return its file, or None.

        Errors of the disk go to `write_error`: the arms must stop anyway.
        """
        if self._folder is None or self._count == 0:
            return None
        stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", f"{name}-{self._last_s:.3f}s")
        try:
            path = _free_path(self._folder, stem)
            return write_recording(path, self.recording(reason, kind="dump", details=details))
        except OSError as error:
            self.write_error = error
            return None


def _free_path(folder: Path, stem: str) -> Path:
    """Return the path of a new .npz file, numbered if the name is taken."""
    path = folder / f"{stem}.npz"
    for number in itertools.count(1):
        if not path.exists():
            break
        path = folder / f"{stem}-{number}.npz"
    return path
