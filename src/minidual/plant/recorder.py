"""Record the last second or a whole trial for replay."""

import itertools
import re
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from minidual.plant.recording import STATE, Recording, physical_fields, versions, write_recording
from minidual.plant.world import World
from minidual.robot.pair import Array

_KEYFRAME_S = 0.02  # dense in dumps, sparse in whole trials
_KEYFRAME_TRIAL_S = 0.1


class Recorder:
    """Records each step of the world that has it as `recorder`; a reset starts over.

    State writes between steps are not kept: their replay deviates. `window_s` None keeps a whole trial; without `folder` there are no dumps.
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
        self._every = max(
            1,
            round((_KEYFRAME_TRIAL_S if window_s is None else _KEYFRAME_S) / world.dt),
        )
        kept = None if window_s is None else max(1, round(window_s / world.dt / self._every))
        self._stretches: deque[tuple[int, Array, list[Array]]] = deque(
            maxlen=kept,
        )  # step, keyframe, controls
        self._pushes: list[tuple[int, Array]] = []
        self._ctrl = world.data.ctrl  # views
        self._xfrc = world.data.xfrc_applied
        self._fields: dict[str, Array] = {}
        self._count = 0
        self._last_s = -1.0
        self.write_error: OSError | None = None
        """Last failed dump's error."""

    def _continues(self) -> bool:
        return 0.0 < self._data.time - self._last_s < 1.5 * self._world.dt

    def before_step(self) -> None:
        """Keep the next step's controls."""
        if not self._continues():
            self._stretches.clear()
            self._pushes.clear()
            self._count = 0
            self._pushed = bytes(self._xfrc.nbytes)
            self._fields = physical_fields(self._model)
        self._last_s = self._data.time
        if not self._count % self._every:
            self._stretches.append((self._count, self._state(), []))
        self._stretches[-1][2].append(self._ctrl.copy())
        push = self._xfrc.tobytes()
        if push != self._pushed:
            self._pushed = push
            self._pushes.append((self._count, self._xfrc.copy()))
        self._count += 1

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
        """Return what was kept."""
        first = self._stretches[0][0]
        frames = [(step - first, state) for step, state, _ in self._stretches]
        if self._continues():
            frames.append((self._count - first, self._state()))
        before = [(0, push) for step, push in self._pushes if step <= first][-1:]
        pushes = before + [(step - first, push) for step, push in self._pushes if step > first]
        about: Any = {
            "kind": kind,
            "reason": reason,
            "arm": self._world.robot.arm.name,
            "scene": self._world.scene,
        }
        about |= {
            "model": self._fields,
            "libraries": versions(),
            "seed": self._seed,
            "details": dict(details or {}),
        }
        return Recording(
            **about,
            controls=np.array([row for _, _, rows in self._stretches for row in rows]),
            keyframe_steps=np.array([step for step, _ in frames]),
            keyframes=np.array([state for _, state in frames]),
            push_steps=np.array([step for step, _ in pushes], dtype=np.int64),
            pushes=np.array([push for _, push in pushes]).reshape(-1, *self._xfrc.shape),
        )

    def dump(
        self,
        name: str,
        reason: str,
        *,
        details: Mapping[str, Any] | None = None,
    ) -> Path | None:
        """Write the window; return its file, or None.

        Disk errors go to `write_error`: the arms must stop anyway.
        """
        if self._folder is None or self._count == 0:
            return None
        stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", f"{name}-{self._last_s:.3f}s")
        try:
            names = (f"{stem}.npz" if i == 0 else f"{stem}-{i}.npz" for i in itertools.count())
            path = next(p for p in (self._folder / n for n in names) if not p.exists())
            return write_recording(path, self.recording(reason, kind="dump", details=details))
        except OSError as error:
            self.write_error = error
            return None
