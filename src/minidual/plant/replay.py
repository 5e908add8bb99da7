"""Replay a recording: does it repeat to the bit, and what left its bounds first."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from minidual.errors import DataError, UsageError
from minidual.plant.model import build_model
from minidual.plant.recording import STATE, Recording, apply_physical_fields, check_shapes, versions
from minidual.plant.world import World
from minidual.robot.pair import Array

_TOLERANCE = {"Nm": 1e-9, "rad/s": 1e-9, "rad": 1e-3}


@dataclass(frozen=True)
class Sign:
    """First value of a quantity beyond its bound."""

    time_s: float
    what: str
    value: float
    bound: float
    unit: str

    @property
    def text(self) -> str:
        """One line."""
        return f"{self.time_s:.3f} s  {self.what}: {self.value:.6g} {self.unit}, bound {self.bound:.6g} {self.unit}"


@dataclass(frozen=True)
class Deviation:
    """First difference from the recording."""

    time_s: float
    what: str
    size: float


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes:
        compared: Number of keyframes after the first.
        largest_deviation: 0.0 is bit-exact.
        first: Signs by time.
        ended: Why it stopped early, or None.
    """

    from_s: float
    to_s: float
    steps: int
    compared: int
    largest_deviation: float
    deviates: Deviation | None
    model_changed: tuple[str, ...]
    versions_differ: tuple[dict[str, str], ...]
    first: tuple[Sign, ...]
    ended: str | None

    @property
    def exact(self) -> bool:
        """Whether all compared keyframes, at least one, matched."""
        return self.compared > 0 and self.deviates is None


@contextmanager
def _quiet() -> Iterator[None]:
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@_quiet()
def replay(
    recording: Recording,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    on_step: Callable[[World], None] | None = None,
) -> Replayed:
    """Run the recorded controls from the last keyframe at or before `from_s` and compare states.

    `on_step` is called at the start and after each step.

    Raises:
        UsageError: Times outside the recording.
        DataError: Scene, states or physical fields do not fit a model.
    """
    start = recording.start_s
    end = recording.end_s
    begin = start if from_s is None else from_s
    stop = end if to_s is None else to_s
    if not (start - 1e-9 <= begin < stop <= end + 1e-9):
        outside = f"cannot replay from {begin:g} s to {stop:g} s: the recording runs from {start:.3f} s to {end:.3f} s"
        raise UsageError(outside, remedy="choose --from-s and --to-s inside it")
    try:
        model = build_model(recording.scene, recording.robot, visuals=False)
    except ValueError as error:  # MuJoCo's compiler
        raise DataError(
            f"the recording's scene cannot be built: {error}",
            remedy="record it again",
        ) from error
    check_shapes(model, recording)
    changed = apply_physical_fields(model, recording.model)
    world = World(recording.scene, recording.robot, model=model)
    data = world.data
    keyframe = (
        np.searchsorted(
            recording.keyframe_steps,
            round((begin - start) / recording.dt_s),
            side="right",
        )
        - 1
    )
    first = int(recording.keyframe_steps[keyframe])
    last = round((stop - start) / recording.dt_s)
    frames = dict(zip(recording.keyframe_steps.tolist(), recording.keyframes, strict=True))
    if not (np.abs(frames[first][: 1 + model.nq + model.nv]) <= mujoco.mjMAXVAL).all():
        remedy = "choose another --from-s, or record it again"
        raise DataError(f"the state at {frames[first][0]:g} s is not finite", remedy=remedy)
    mujoco.mj_setState(model, data, frames[first], STATE)
    mujoco.mj_forward(model, data)
    mujoco.mj_setState(model, data, frames[first], STATE)  # forward changes the warm start
    names = _state_names(model)
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    signs: dict[str, Sign] = {}
    deviates: Deviation | None = None
    largest = 0.0
    compared = 0
    ended = None
    done = first
    if on_step is not None:
        on_step(world)
    for step in range(first, last + 1):
        if step > first and step in frames:
            compared += 1
            mujoco.mj_getState(model, data, state, STATE)
            difference = np.abs(state - frames[step])[: len(names)]
            index = int(np.argmax(difference))  # the first NaN, if there is one
            largest = float(np.maximum(largest, difference[index]))
            if difference[index] != 0.0 and deviates is None:
                deviates = Deviation(world.time, names[index], float(difference[index]))
        if step == last:
            break
        controls = recording.controls[step]
        data.ctrl[:] = controls
        push = int(np.searchsorted(recording.push_steps, step, side="right")) - 1
        data.xfrc_applied[:] = recording.pushes[push] if push >= 0 else 0.0
        finite = np.isfinite(controls)
        if not finite.all():
            motor = model.actuator(int(np.argmin(finite))).name
            ended = f"the command of {motor} is not finite at {world.time:.3f} s"
            break
        tau_max = world.robot.tau_max
        _watch(
            world,
            "torque asked of",
            controls[world.joints.ctrl],
            -tau_max,
            tau_max,
            "Nm",
            signs,
        )
        before = world.time
        mujoco.mj_step(model, data)
        done = step + 1
        if world.time <= before:  # MuJoCo resets a non-finite state
            ended = f"the state is not finite after {before:.3f} s"
            if deviates is None and any(step < later <= last for later in frames):
                largest = math.inf
                deviates = Deviation(before, "the state, which goes on in the recording,", largest)
            break
        v_max = world.robot.v_max
        _watch(world, "velocity of", world.v, -v_max, v_max, "rad/s", signs)
        _watch(
            world,
            "position of",
            world.q,
            world.robot.q_lower,
            world.robot.q_upper,
            "rad",
            signs,
        )
        if on_step is not None:
            on_step(world)
    then = recording.libraries
    now = versions()
    differ = [name for name in now if then.get(name) != now[name]]
    span: Any = {
        "from_s": start + first * recording.dt_s,
        "to_s": start + done * recording.dt_s,
        "steps": done - first,
    }
    return Replayed(
        **(
            span
            | {
                "compared": compared,
                "largest_deviation": largest,
                "deviates": deviates,
                "ended": ended,
            }
        ),
        model_changed=tuple(changed),
        versions_differ=tuple(
            {"name": name, "was": then.get(name, "none"), "is": now[name]} for name in differ
        ),
        first=tuple(signs.values()),
    )


def _state_names(model: mujoco.MjModel) -> list[str]:
    names = [model.joint(i).name for i in range(model.njnt)]
    kinds = (
        ("position", [*model.jnt_qposadr, model.nq]),
        ("velocity", [*model.jnt_dofadr, model.nv]),
    )
    return [
        "time",
        *(
            f"{kind} of {name}"
            for kind, first in kinds
            for name in np.repeat(names, np.diff(first))
        ),
    ]


def _watch(
    world: World,
    what: str,
    values: Array,
    low: Array,
    high: Array,
    unit: str,
    signs: dict[str, Sign],
) -> None:
    beyond = np.maximum(low - values, values - high)
    joint = int(np.argmax(beyond))
    if not beyond[joint] <= _TOLERANCE[unit]:
        name = f"{what} {world.robot.joint_names[joint]}"
        bound = float((low if values[joint] < low[joint] else high)[joint])
        signs.setdefault(name, Sign(world.time, name, float(values[joint]), bound, unit))
