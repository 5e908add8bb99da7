"""Replay a recording: does it repeat to the bit, and what left its bounds first."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.errors import DataError, UsageError
from minidual.plant.fields import apply_physical_fields
from minidual.plant.model import build_model
from minidual.plant.recording import STATE, Recording, check_shapes, versions
from minidual.plant.world import World
from minidual.robot.pair import Array

_TOLERANCE = {"Nm": 1e-9, "rad/s": 1e-9, "rad": 1e-3}
_TIME_ROUNDING_S = 1e-9


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
        value = f"{self.value:.6g} {self.unit}"
        return f"{self.time_s:.3f} s  {self.what}: {value}, bound {self.bound:.6g} {self.unit}"


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
        from_s: Time of the first state.
        to_s: Time of the last state.
        steps: Number of steps.
        compared: Number of keyframes after the first.
        largest_deviation: 0.0 is bit-exact.
        deviates: First deviation, or None.
        model_changed: Physical fields that differ from the scene's.
        versions_differ: Libraries of other versions: name, was, is.
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
    """Keep MuJoCo from writing its warnings to a file."""
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


@_quiet()
def replay(
    recording: Recording,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    on_step: Callable[[World], None] | None = None,
) -> Replayed:
    """Run the recorded controls from the last keyframe at or before `from_s`; compare states.

    `on_step` is called at the start and after each step.

    Raises:
        UsageError: Times outside the recording.
        DataError: Scene, states or physical fields do not fit a model.
    """
    begin_s = recording.start_s if from_s is None else from_s
    stop_s = recording.end_s if to_s is None else to_s
    _check_times(recording, begin_s, stop_s)
    try:
        model = build_model(recording.scene, recording.robot, visuals=False)
    except UsageError as error:
        raise DataError(
            f"the recording's scene cannot be built: {error.message}",
            remedy="record it again",
        ) from error
    check_shapes(model, recording)
    model_changed = apply_physical_fields(model, recording.model)
    world = World(recording.scene, recording.robot, model=model)
    first_step = _keyframe_before(recording, begin_s)
    last_step = round((stop_s - recording.start_s) / recording.dt_s)
    run = _Replay(recording, world, first_step, last_step)
    run.run(on_step)
    return Replayed(
        from_s=recording.start_s + first_step * recording.dt_s,
        to_s=recording.start_s + run.done * recording.dt_s,
        steps=run.done - first_step,
        compared=run.compared,
        largest_deviation=run.largest_deviation,
        deviates=run.deviates,
        model_changed=tuple(model_changed),
        versions_differ=_differing_versions(recording),
        first=tuple(run.signs.values()),
        ended=run.ended,
    )


def _check_times(recording: Recording, begin_s: float, stop_s: float) -> None:
    start_s = recording.start_s
    end_s = recording.end_s
    if not (start_s - _TIME_ROUNDING_S <= begin_s < stop_s <= end_s + _TIME_ROUNDING_S):
        raise UsageError(
            f"cannot replay from {begin_s:g} s to {stop_s:g} s: "
            f"the recording runs from {start_s:.3f} s to {end_s:.3f} s",
            remedy="choose --from-s and --to-s inside it",
        )


def _keyframe_before(recording: Recording, time_s: float) -> int:
    """Return the step of the last keyframe at or before a time."""
    step = round((time_s - recording.start_s) / recording.dt_s)
    after = int(np.searchsorted(recording.keyframe_steps, step, side="right"))
    return int(recording.keyframe_steps[after - 1])


def _differing_versions(recording: Recording) -> tuple[dict[str, str], ...]:
    rows = []
    for name, version in versions().items():
        recorded = recording.libraries.get(name, "none")
        if recorded != version:
            rows.append({"name": name, "was": recorded, "is": version})
    return tuple(rows)


class _Replay:
    """One run through a stretch of a recording; see `Replayed` for the results.

    Attributes:
        done: Step before which the last complete state stands.
        signs: First values beyond their bounds, by quantity.
    """

    def __init__(
        self,
        recording: Recording,
        world: World,
        first_step: int,
        last_step: int,
    ) -> None:
        self._recording = recording
        self._world = world
        self._first_step = first_step
        self._last_step = last_step
        steps = recording.keyframe_steps.tolist()
        self._keyframes: dict[int, Array] = dict(zip(steps, recording.keyframes, strict=True))
        self._names = _state_names(world.model)
        self.done = first_step
        self.compared = 0
        self.largest_deviation = 0.0
        self.deviates: Deviation | None = None
        self.signs: dict[str, Sign] = {}
        self.ended: str | None = None

    def run(self, on_step: Callable[[World], None] | None) -> None:
        """Step to the end, or to a command or state that is not finite."""
        self._set_first_state()
        if on_step is not None:
            on_step(self._world)
        for step in range(self._first_step, self._last_step):
            self._step(step)
            if self.ended is not None:
                return
            if on_step is not None:
                on_step(self._world)
            self._compare(step + 1)

    def _set_first_state(self) -> None:
        model = self._world.model
        data = self._world.data
        state = self._keyframes[self._first_step]
        time_and_motion = state[: 1 + model.nq + model.nv]
        if not (np.abs(time_and_motion) <= mujoco.mjMAXVAL).all():  # true for NaN
            raise DataError(
                f"the state at {state[0]:g} s is not finite",
                remedy="choose another --from-s, or record it again",
            )
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_forward(model, data)
        mujoco.mj_setState(model, data, state, STATE)  # `mj_forward` changes the warm start

    def _compare(self, step: int) -> None:
        """Compare the state before a step with the keyframe, if there is one."""
        if step not in self._keyframes:
            return
        model = self._world.model
        state = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, self._world.data, state, STATE)
        difference = np.abs(state - self._keyframes[step])[: len(self._names)]
        index = int(np.argmax(difference))  # the first NaN, if there is one
        size = float(difference[index])
        self.compared += 1
        self.largest_deviation = float(np.maximum(self.largest_deviation, size))
        if size != 0.0 and self.deviates is None:
            self.deviates = Deviation(self._world.time, self._names[index], size)

    def _step(self, step: int) -> None:
        """Apply the recorded controls and pushes of a step, and watch the arms' limits."""
        world = self._world
        data = world.data
        controls = self._recording.controls[step]
        data.ctrl[:] = controls
        data.xfrc_applied[:] = self._push(step)
        finite = np.isfinite(controls)
        if not finite.all():
            motor = world.model.actuator(int(np.argmin(finite))).name
            self.ended = f"the command of {motor} is not finite at {world.time:.3f} s"
            return
        robot = world.robot
        torques = controls[world.joints.ctrl]
        self._watch("torque asked of", torques, -robot.tau_max, robot.tau_max, "Nm")
        before_s = world.time
        mujoco.mj_step(world.model, data)
        self.done = step + 1
        if world.time <= before_s:  # MuJoCo has reset a state that is not finite
            self._end_at_reset(before_s, step)
            return
        self._watch("velocity of", world.v, -robot.v_max, robot.v_max, "rad/s")
        self._watch("position of", world.q, robot.q_lower, robot.q_upper, "rad")

    def _push(self, step: int) -> Array | float:
        """Return the external wrenches (nbody, 6) of a step."""
        index = int(np.searchsorted(self._recording.push_steps, step, side="right")) - 1
        return self._recording.pushes[index] if index >= 0 else 0.0

    def _end_at_reset(self, before_s: float, step: int) -> None:
        self.ended = f"the state is not finite after {before_s:.3f} s"
        recorded_later = any(step < later <= self._last_step for later in self._keyframes)
        if self.deviates is None and recorded_later:
            self.largest_deviation = math.inf
            what = "the state, which goes on in the recording,"
            self.deviates = Deviation(before_s, what, math.inf)

    def _watch(self, quantity: str, values: Array, low: Array, high: Array, unit: str) -> None:
        """Note the first value of each joint beyond its bounds; values are (n,)."""
        beyond = np.maximum(low - values, values - high)
        joint = int(np.argmax(beyond))
        if beyond[joint] <= _TOLERANCE[unit]:  # false for NaN
            return
        name = f"{quantity} {self._world.robot.joint_names[joint]}"
        value = float(values[joint])
        bound = low[joint] if value < low[joint] else high[joint]
        sign = Sign(self._world.time, name, value, float(bound), unit)
        self.signs.setdefault(name, sign)


def _state_names(model: mujoco.MjModel) -> list[str]:
    """Return a name for each number of a state: time, positions, velocities."""
    joints = [model.joint(i).name for i in range(model.njnt)]
    position_counts = np.diff([*model.jnt_qposadr, model.nq])
    velocity_counts = np.diff([*model.jnt_dofadr, model.nv])
    positions = [f"position of {name}" for name in np.repeat(joints, position_counts)]
    velocities = [f"velocity of {name}" for name in np.repeat(joints, velocity_counts)]
    return ["time", *positions, *velocities]
