"""Replay a recording: bit-exactness, and what first exceeded a bound."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.errors import UsageError
from minidual.plant.model import build_model
from minidual.plant.recording import STATE, Recording, apply_physical_fields, versions
from minidual.plant.world import World
from minidual.robot.pair import Array

_POSITION_TOLERANCE_RAD = 1e-3


@dataclass(frozen=True)
class Sign:
    """First exceedance of a quantity; `bound` None means not finite."""

    time_s: float
    what: str
    value: float
    bound: float | None
    unit: str

    @property
    def text(self) -> str:
        """One line."""
        bound = "" if self.bound is None else f", bound {self.bound:.6g} {self.unit}"
        return f"{self.time_s:.3f} s  {self.what}: {self.value:.6g} {self.unit}{bound}"


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
        compared: Keyframes, without the starting one.
        largest_deviation: 0.0 is bit-exact.
        first: Exceedances by time.
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
        """Whether keyframes were compared and all matched."""
        return self.compared > 0 and self.deviates is None


def replay(
    recording: Recording,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    on_step: Callable[[World], None] | None = None,
) -> Replayed:
    """Run the recorded controls from the last keyframe at or before `from_s` and compare states.

    `on_step` is called before the first and after each step.

    Raises:
        UsageError: Times outside the recording, or state sizes unlike the robot's.
        DataError: Physical fields do not fit the model.
    """
    model = build_model(recording.scene, recording.robot, visuals=False)
    changed = apply_physical_fields(model, recording.model)
    world = World(recording.scene, recording.robot, model=model)
    first, last = _steps(recording, world, from_s, to_s)
    keyframe = int(np.searchsorted(recording.keyframe_steps, first, side="right")) - 1
    first = int(recording.keyframe_steps[keyframe])
    frames = dict(zip(recording.keyframe_steps.tolist(), recording.keyframes, strict=True))
    mujoco.mj_setState(model, world.data, recording.keyframes[keyframe], STATE)
    mujoco.mj_forward(model, world.data)
    mujoco.mj_setState(model, world.data, recording.keyframes[keyframe], STATE)  # forward changes the warm start
    names = _state_names(world)
    scratch = mujoco.MjData(model)
    signs: dict[str, Sign] = {}
    deviates: Deviation | None = None
    largest, compared, ended, done = 0.0, 0, None, first
    with _quiet():
        if on_step is not None:
            on_step(world)
        for step in range(first, last + 1):
            if step > first and step in frames:
                compared += 1
                mujoco.mj_setState(model, scratch, frames[step], STATE)
                size, name = _deviation(world.data, scratch, names)
                largest = max(largest, size) if size == size else size
                if size != 0.0 and deviates is None:
                    deviates = Deviation(float(world.data.time), name, size)
            if step == last:
                break
            controls = recording.controls[step]
            world.data.ctrl[:] = controls
            push = int(np.searchsorted(recording.push_steps, step, side="right")) - 1
            world.data.xfrc_applied[:] = recording.pushes[push] if push >= 0 else 0.0
            _watch_commands(world, controls, signs)
            if not np.isfinite(controls).all():
                ended = f"a command is not finite at {world.time:.3f} s"
                break
            before = world.data.time
            mujoco.mj_step(model, world.data)
            done = step + 1
            if world.data.time <= before:  # MuJoCo resets a non-finite state
                ended = f"the state is not finite after {before:.3f} s"
                break
            _watch_state(world, signs)
            if on_step is not None:
                on_step(world)
    then, now = recording.libraries, versions()
    start = recording.start_s
    return Replayed(
        from_s=start + first * recording.dt_s,
        to_s=start + done * recording.dt_s,
        steps=done - first,
        compared=compared,
        largest_deviation=largest,
        deviates=deviates,
        model_changed=tuple(changed),
        versions_differ=tuple(
            {"name": name, "was": str(then.get(name, "none")), "is": now[name]}
            for name in now
            if then.get(name) != now[name]
        ),
        first=tuple(sorted(signs.values(), key=lambda sign: sign.time_s)),
        ended=ended,
    )


def _steps(recording: Recording, world: World, from_s: float | None, to_s: float | None) -> tuple[int, int]:
    if recording.controls.shape[1] != world.model.nu or recording.keyframes.shape[1] != mujoco.mj_stateSize(
        world.model, STATE
    ):
        raise UsageError(
            f"the recording has {recording.controls.shape[1]} controls and states of "
            f"{recording.keyframes.shape[1]} numbers; this robot has {world.model.nu} and "
            f"{mujoco.mj_stateSize(world.model, STATE)}",
            remedy="replay it with the version that made it",
        )
    start, end = recording.start_s, recording.end_s
    begin = start if from_s is None else from_s
    stop = end if to_s is None else to_s
    if not (start - 1e-9 <= begin < stop <= end + 1e-9):
        raise UsageError(
            f"cannot replay from {begin:g} s to {stop:g} s: the recording runs from {start:.3f} s to {end:.3f} s",
            remedy="choose --from-s and --to-s inside it",
        )
    return round((begin - start) / recording.dt_s), round((stop - start) / recording.dt_s)


def _state_names(world: World) -> list[str]:
    """Name every number in (time, qpos, qvel)."""
    model = world.model
    positions, velocities = [""] * model.nq, [""] * model.nv
    for i in range(model.njnt):
        joint = model.joint(i)
        free = int(model.jnt_type[i]) == int(mujoco.mjtJoint.mjJNT_FREE)
        place = ["x", "y", "z", "qw", "qx", "qy", "qz"] if free else [""]
        for k, axis in enumerate(place):
            positions[int(joint.qposadr[0]) + k] = f"position {axis} of {joint.name}".replace("  ", " ")
        for k, axis in enumerate(["x", "y", "z", "rx", "ry", "rz"] if free else [""]):
            velocities[int(joint.dofadr[0]) + k] = f"velocity {axis} of {joint.name}".replace("  ", " ")
    return ["time", *positions, *velocities]


def _deviation(data: mujoco.MjData, recorded: mujoco.MjData, names: list[str]) -> tuple[float, str]:
    """Return the largest difference (NaN if any) and its quantity."""
    here = np.concatenate([[data.time], data.qpos, data.qvel])
    there = np.concatenate([[recorded.time], recorded.qpos, recorded.qvel])
    if np.array_equal(here, there):
        return 0.0, ""
    difference = np.abs(here - there)
    index = int(np.argmax(difference))
    return float(difference[index]), names[index]


def _watch_commands(world: World, controls: Array, signs: dict[str, Sign]) -> None:
    tau = controls[world.joints.ctrl]
    finite = np.isfinite(controls)
    if not finite.all():
        index = int(np.argmin(finite))
        actuator = world.model.actuator(index).name
        _note(signs, Sign(world.time, f"command of {actuator} is not finite", float(controls[index]), None, "Nm"))
        return
    _note_largest(world, "torque asked of", tau, world.robot.tau_max, "Nm", signs, 1.0 + 1e-9)


def _watch_state(world: World, signs: dict[str, Sign]) -> None:
    robot, q = world.robot, world.q
    _note_largest(world, "velocity of", world.v, robot.v_max, "rad/s", signs, 1.0)
    beyond = np.maximum(robot.q_lower - q, q - robot.q_upper)
    joint = int(np.argmax(beyond))
    if not beyond[joint] <= _POSITION_TOLERANCE_RAD:
        bound = robot.q_lower[joint] if q[joint] < robot.q_lower[joint] else robot.q_upper[joint]
        _note(signs, Sign(world.time, f"position of {robot.joint_names[joint]}", float(q[joint]), float(bound), "rad"))


def _note_largest(
    world: World, what: str, values: Array, bounds: Array, unit: str, signs: dict[str, Sign], limit: float
) -> None:
    ratio = np.abs(values) / bounds
    joint = int(np.argmax(ratio))
    if not ratio[joint] <= limit:
        name = world.robot.joint_names[joint]
        _note(signs, Sign(world.time, f"{what} {name}", float(values[joint]), float(bounds[joint]), unit))


def _note(signs: dict[str, Sign], sign: Sign) -> None:
    signs.setdefault(sign.what, sign)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence MuJoCo's warnings."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
