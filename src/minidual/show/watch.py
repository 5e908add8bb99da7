"""Show a running world; the view has its own model, so watching never changes the simulation."""

import functools
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.commands import TrajectoryCommand
from minidual.control.stack import ControlStack
from minidual.demos.recording import Observe
from minidual.demos.rig import Rig
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, Robot
from minidual.show.view import View
from minidual.show.view.overlay import ARM_RGB, NO_PREVIEW, Arrow, Overlay, PathLine, Preview
from minidual.trials.methods import Method
from minidual.trials.runner import Bench, StepHook, Watch

_ASIDE_M = np.array([0.05, 0.0, 0.0])  # from the hands, where the object would hide the arrows
_BRAKE_EVERY_S = 0.01
_LOST_S = 0.1
_PATH_POINTS = 60
_STATIC_M = 1e-3

Narrator = Callable[[], Overlay]
"""Returns the state to show; `overlay` adds time and forces."""


@functools.lru_cache(maxsize=2)
def visual_model(scene: SceneConfig, robot: Robot = DUAL_PANDA) -> mujoco.MjModel:
    """Return a scene's visual model; bodies as simulated."""
    return build_model(scene, robot, visuals=True)


def overlay(world: World, words: Overlay) -> Overlay:
    """Return `words` with the world's time and forces."""
    objects = [world.truth(name) for name in world.objects]
    hands = zip(
        world.robot.tcp_names,
        np.sum([thing.forces() for thing in objects], axis=0),
        ARM_RGB,
        strict=True,
    )
    left, right = np.max([thing.pinch() for thing in objects], axis=0)
    return words._replace(
        time_s=world.time,
        pinch_n=(float(left), float(right)),
        internal_n=max(thing.internal_force() for thing in objects),
        arrows=tuple(
            Arrow(world.data.body(name).xpos + _ASIDE_M, np.array(f), rgb) for name, f, rgb in hands
        ),
    )


class Brake:
    """Limits simulated time to `speed` times wall time."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start = (0.0, 0.0)
        self._last_s = math.inf

    def hold(self, time_s: float) -> None:
        """Sleep until simulated time `time_s` is due; lags over 0.1 s are not caught up."""
        now = time.monotonic()
        ahead = (time_s - self._start[1]) / self._speed - (now - self._start[0])
        if time_s < self._last_s or ahead < -_LOST_S:
            self._start = (now, time_s)
        elif ahead > 0.0:
            time.sleep(ahead)
        self._last_s = time_s


class Watcher:
    """Step observer that shows one world; `narrate` is called once per frame."""

    def __init__(self, view: View, world: World, narrate: Narrator) -> None:
        view.open(visual_model(world.scene, world.robot))  # type: ignore[arg-type]  # frozen, so hashable
        self._view = view
        self._narrate = narrate
        self._brake = Brake(view.speed_max) if view.speed_max > 0.0 else None
        self._braked_s = float("-inf")

    def __call__(self, world: World) -> None:
        """Show the world if a frame is due."""
        if self._brake is not None and abs(world.time - self._braked_s) >= _BRAKE_EVERY_S:
            self._braked_s = world.time
            self._brake.hold(world.time)
        if self._view.due():
            self._view.update(world.data, overlay(world, self._narrate()))


@contextmanager
def watched(view: View | None, world: World, narrate: Narrator) -> Iterator[None]:
    """Show `world` inside the block; no-op without a view."""
    if view is None:
        yield
        return
    before = world.observer
    world.observer = Watcher(view, world, narrate)
    try:
        yield
    finally:
        world.observer = before


def watch_trials(view: View | None) -> Watch | None:
    """Return the `watch` argument of `run_trials`; None without a view."""
    return None if view is None else functools.partial(trial_hook, view)


def trial_hook(view: View, bench: Bench, title: str) -> StepHook:
    """Return a step hook that shows a trial."""
    narrate: Narrator | None = None
    watcher = Watcher(view, bench.world, lambda: narrate() if narrate else Overlay())

    def hook(world: World, method: Method) -> None:
        nonlocal narrate
        if narrate is None:
            stack = getattr(method, "stack", None)
            words = Overlay(title=title, mode=bench.method, source=bench.method)
            if isinstance(stack, ControlStack):
                narrate = StackNarrator(
                    stack,
                    bench.kinematics,
                    title,
                    lambda: (method.phase, method.aborted),
                )
            else:  # the method computes torques itself
                narrate = lambda: words._replace(state=method.phase, status=method.aborted or "")  # noqa: E731
        watcher(world)

    return hook


def watch_recording(view: View | None) -> Observe | None:
    """Return the `observe` argument of `record`; None without a view."""
    return None if view is None else functools.partial(_demonstration, view)


def _demonstration(view: View, rig: Rig, index: int) -> AbstractContextManager[None]:
    return watched(
        view,
        rig.world,
        StackNarrator(rig.session.stack, rig.kinematics, f"teleop-record, trial {index}"),
    )


def tcp_preview(kinematics: Kinematics, qs: Array) -> Preview:
    """Return the TCP paths of postures (T, n), without resting arms."""
    rows = np.unique(np.linspace(0, len(qs) - 1, min(len(qs), _PATH_POINTS)).round().astype(int))
    points = np.array([[T[:3, 3] for T in kinematics.tcp_poses(qs[row])] for row in rows])
    sides = zip(kinematics.robot.sides, points.swapaxes(0, 1), ARM_RGB, strict=True)
    return Preview(
        tuple(PathLine(*side) for side in sides if np.ptp(side[1], axis=0).max() > _STATIC_M),
    )


@dataclass
class StackNarrator:
    """Describes a control stack; `tell` returns the method's phase and why it stopped itself."""

    stack: ControlStack
    kinematics: Kinematics
    title: str
    tell: Callable[[], tuple[str, str | None]] = lambda: ("", None)
    _drawn: tuple[TrajectoryCommand, ...] = ()
    _preview: Preview = NO_PREVIEW

    def __call__(self) -> Overlay:
        """Return the current overlay."""
        stack = self.stack
        state = str(self.stack.state)
        phase, aborted = self.tell()
        return Overlay(
            title=self.title,
            mode=stack.source or "hold",
            source=stack.output.active_source or "none, posture held",
            state=f"{state}, {phase}" if phase and phase != state else state,
            status=aborted or "" if stack.reflex is None else stack.reflex.message,
            preview=self._planned(),
        )

    def _planned(self) -> Preview:
        found = (execution.command for execution in self.stack.arbiter.underway.executions)
        commands = tuple(command for command in found if isinstance(command, TrajectoryCommand))
        if [id(command) for command in commands] != [id(command) for command in self._drawn]:
            self._drawn = commands
            self._preview = Preview(
                tuple(line for command in commands for line in self._paths(command)),
            )
        return self._preview

    def _paths(self, command: TrajectoryCommand) -> tuple[PathLine, ...]:
        times: Array = np.linspace(0.0, command.motion.duration_s, _PATH_POINTS, dtype=np.float64)
        qs = np.tile(self.stack.plant.q, (len(times), 1))
        group = self.kinematics.robot.groups[command.group]
        found = command.motion.sample_many(times)[0]
        qs[:, group] = found if found.shape[1] == qs[:, group].shape[1] else found[:, group]
        return tcp_preview(self.kinematics, qs).paths
