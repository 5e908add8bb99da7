"""Record the last second or a whole trial for replay."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from minidual.plant.recording import STATE, Recording, physical_fields, versions, write_recording
from minidual.plant.world import World
from minidual.robot.pair import Array

_KEYFRAME_S, _KEYFRAME_TRIAL_S = 0.02, 0.1
"""Keyframe spacing: dense in dumps, sparse in whole trials."""


class Recorder:
    """Records each step of the world that has it as `recorder`; a reset starts over.

    External forces and model changes before the first step are kept. State writes between steps are not, so their
    replay deviates. `window_s` None keeps everything; without `folder` there are no dumps.
    """

    def __init__(
        self, world: World, *, window_s: float | None = None, seed: int | None = None, folder: Path | None = None
    ) -> None:
        self._world, self._model, self._data = world, world.model, world.data
        self._seed, self._folder = seed, folder
        self._every = max(1, round((_KEYFRAME_TRIAL_S if window_s is None else _KEYFRAME_S) / world.dt))
        window = None if window_s is None else max(1, round(window_s / world.dt / self._every)) * self._every
        self._window = window
        capacity = 2 * window if window is not None else 128 * self._every
        self._controls = np.empty((capacity, world.model.nu))
        self._ctrl, self._xfrc = world.data.ctrl, world.data.xfrc_applied  # views
        self._still = bytes(self._xfrc.nbytes)
        self._state_size = mujoco.mj_stateSize(world.model, STATE)
        self._time_tolerance_s = 1.5 * world.dt
        self.write_error: OSError | None = None
        """Last failed dump's error."""
        self.clear()

    def clear(self) -> None:
        """Start over."""
        self._count = 0
        self._last_s = -1.0
        self._keyframes: list[tuple[int, Array]] = []
        self._pushes: list[tuple[int, Array]] = []
        self._pushed = self._still
        self._fields: dict[str, Array] | None = None

    @property
    def steps(self) -> int:
        """Steps kept."""
        return self._count

    def before_step(self) -> None:
        """Keep the next step's controls; `World.step` calls it."""
        now = self._data.time
        if not 0.0 < now - self._last_s < self._time_tolerance_s:
            self.clear()
            self._fields = physical_fields(self._model)
        self._last_s = now
        if self._count == len(self._controls):
            self._make_room()
        count = self._count
        self._controls[count] = self._ctrl
        if not count % self._every:
            self._keyframes.append((count, self._state()))
        push = self._xfrc.tobytes()
        if push != self._pushed:
            self._pushed = push
            self._pushes.append((count, self._xfrc.copy()))
        self._count = count + 1

    def _state(self) -> Array:
        state = np.empty(self._state_size)
        mujoco.mj_getState(self._model, self._data, state, STATE)
        return state

    def _ended_whole(self) -> bool:
        """Return whether no reset or divergence followed the last step."""
        return self._count > 0 and 0.0 < self._data.time - self._last_s < self._time_tolerance_s

    def _make_room(self) -> None:
        """Drop old steps, or double the capacity."""
        if self._window is None:
            self._controls = np.concatenate([self._controls, np.empty_like(self._controls)])
            return
        drop = self._count - self._window  # a multiple of the distance of keyframes
        self._controls[: self._window] = self._controls[drop : self._count]
        self._count = self._window
        self._keyframes = [(step - drop, state) for step, state in self._keyframes if step >= drop]
        before = [push for step, push in self._pushes if step <= drop]
        self._pushes = [(step - drop, push) for step, push in self._pushes if step > drop]
        if before:
            self._pushes.insert(0, (0, before[-1]))

    def recording(self, reason: str, *, kind: str = "trial", details: Mapping[str, Any] | None = None) -> Recording:
        """Return what was kept, from the window's first keyframe."""
        first = 0
        if self._window is not None and self._count > self._window:
            first = self._count - self._window
            first += -first % self._every  # the next keyframe
        pushes = [(max(0, step - first), push) for step, push in self._pushes if step > first]
        before = [push for step, push in self._pushes if step <= first]
        if before:
            pushes.insert(0, (0, before[-1]))
        frames = [(step - first, state) for step, state in self._keyframes if step >= first]
        if self._ended_whole():
            frames.append((self._count - first, self._state()))
        none = np.zeros((0, *self._xfrc.shape))
        return Recording(
            kind=kind,
            reason=reason,
            arm=self._world.robot.arm.name,
            scene=self._world.scene,
            controls=self._controls[first : self._count].copy(),
            keyframe_steps=np.array([step for step, _ in frames], dtype=np.int64),
            keyframes=np.array([state for _, state in frames]),
            push_steps=np.array([step for step, _ in pushes], dtype=np.int64),
            pushes=np.array([push for _, push in pushes]) if pushes else none,
            model=dict(self._fields or {}),
            libraries=versions(),
            seed=self._seed,
            details=dict(details or {}),
        )

    def write(self, path: Path, reason: str, *, details: Mapping[str, Any] | None = None) -> Path:
        """Write a trial."""
        return write_recording(path, self.recording(reason, details=details))

    def dump(self, name: str, reason: str, *, details: Mapping[str, Any] | None = None) -> Path | None:
        """Write the window; return its file, or None.

        Disk errors go to `write_error`, not raised: the arms must stop anyway.
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
