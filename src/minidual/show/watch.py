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
from minidual.plant.marks import goal_mark
from minidual.plant.model import build_model
from minidual.plant.simulation import Simulation
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, Robot
from minidual.show.forces import force_arrows
from minidual.show.view import View
from minidual.show.view.overlay import ARM_RGB, NO_PREVIEW, Overlay, PathLine, Preview
from minidual.trials.methods import Method
from minidual.trials.runner import Bench, StepHook, Watch

_BRAKE_EVERY_S = 0.01
_LAG_MAX_S = 0.1
_PATH_POINTS_N = 60
_STATIC_M = 1e-3
"""Extent below which a hand's path counts as rest."""

Narrator = Callable[[], Overlay]
"""Returns the state to show; `overlay` adds time and forces."""


@functools.lru_cache(maxsize=2)
def visual_model(scene: SceneConfig, robot: Robot = DUAL_PANDA) -> mujoco.MjModel:
    """Return a scene's visual model; bodies as simulated."""
    return build_model(scene, robot, visuals=True)


def overlay(world: Simulation, words: Overlay) -> Overlay:
    """Return `words` with the world's time, forces and goal."""
    objects = [world.truth(name) for name in world.objects]
    pinch_left, pinch_right = np.max([each.pinch() for each in objects], axis=0)
    return words._replace(
        time_s=world.time,
        pinch_n=(float(pinch_left), float(pinch_right)),
        internal_n=max(each.internal_force() for each in objects),
        arrows=force_arrows(world),
        goal=_goal_pose(world.model),
    )


def _goal_pose(model: mujoco.MjModel) -> Array | None:
    """Return the pose of the goal's mark (7,); None without a mark."""
    geom = goal_mark(model)
    if geom is None:
        return None
    return np.concatenate([model.geom_pos[geom], model.geom_quat[geom]])


class Brake:
    """Limits simulated time to `speed` times wall time."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start_wall_s = 0.0
        self._start_s = 0.0
        self._last_s = math.inf

    def hold(self, time_s: float) -> None:
        """Sleep until simulated time `time_s` is due; lags over 0.1 s are not caught up."""
        now_s = time.monotonic()
        due_s = self._start_wall_s + (time_s - self._start_s) / self._speed
        ahead_s = due_s - now_s
        restarted = time_s < self._last_s
        if restarted or ahead_s < -_LAG_MAX_S:
            self._start_wall_s = now_s
            self._start_s = time_s
        elif ahead_s > 0.0:
            time.sleep(ahead_s)
        self._last_s = time_s


class Watcher:
    """Step observer that shows one world; `narrate` is called once per frame."""

    def __init__(self, view: View, world: Simulation, narrate: Narrator) -> None:
        view.open(visual_model(world.scene, world.robot))  # type: ignore[arg-type]  # frozen, so hashable
        self._view = view
        self._narrate = narrate
        self._brake = Brake(view.speed_max) if view.speed_max > 0.0 else None
        self._braked_s = float("-inf")

    def __call__(self, world: Simulation) -> None:
        """Show the world if a frame is due."""
        if self._brake is not None and abs(world.time - self._braked_s) >= _BRAKE_EVERY_S:
            self._braked_s = world.time
            self._brake.hold(world.time)
        if self._view.due():
            self._view.update(world.data, overlay(world, self._narrate()))


@contextmanager
def watched(view: View | None, world: Simulation, narrate: Narrator) -> Iterator[None]:
    """Show `world` inside the block; do nothing without a view."""
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
    if view is None:
        return None
    return functools.partial(trial_hook, view)


def trial_hook(view: View, bench: Bench, title: str) -> StepHook:
    """Return a step hook that shows a trial."""
    narrate: Narrator | None = None

    def words() -> Overlay:
        return Overlay() if narrate is None else narrate()

    watcher = Watcher(view, bench.world, words)

    def hook(world: Simulation, method: Method) -> None:
        nonlocal narrate
        if narrate is None:  # the method exists from the first step on
            narrate = _narrator(bench, method, title)
        watcher(world)

    return hook


def _narrator(bench: Bench, method: Method, title: str) -> Narrator:
    """Return the description of a trial of a method."""
    stack = getattr(method, "stack", None)
    if isinstance(stack, ControlStack):
        return StackNarrator(
            stack,
            bench.kinematics,
            title,
            lambda: (method.phase, method.aborted),
            method=bench.method,
        )

    def describe_torque_method() -> Overlay:
        return Overlay(
            title=title,
            method=bench.method,
            source=bench.method,
            state=method.phase,
            status=method.aborted or "",
        )

    return describe_torque_method


def watch_recording(view: View | None) -> Observe | None:
    """Return the `observe` argument of `record`; None without a view."""
    if view is None:
        return None
    return functools.partial(_watch_demonstration, view)


def _watch_demonstration(view: View, rig: Rig, index: int) -> AbstractContextManager[None]:
    title = f"teleop-record, trial {index}"
    return watched(view, rig.world, StackNarrator(rig.session.stack, rig.kinematics, title))


def tcp_preview(kinematics: Kinematics, qs: Array) -> Preview:
    """Return the TCP paths of postures (T, n), without resting arms."""
    points_n = min(len(qs), _PATH_POINTS_N)
    rows = np.unique(np.linspace(0, len(qs) - 1, points_n).round().astype(int))
    positions = np.array([[T[:3, 3] for T in kinematics.tcp_poses(qs[row])] for row in rows])
    of_arms = positions.swapaxes(0, 1)
    lines = [
        PathLine(side, points, rgb)
        for side, points, rgb in zip(kinematics.robot.sides, of_arms, ARM_RGB, strict=True)
    ]
    return Preview(tuple(line for line in lines if _moves(line)))


def _moves(line: PathLine) -> bool:
    return bool(np.ptp(line.points, axis=0).max() > _STATIC_M)


@dataclass
class StackNarrator:
    """Describes a control stack.

    Attributes:
        stack: What is described.
        kinematics: Of its arms.
        title: Above the state.
        progress: Returns the method's phase and why it stopped itself, if it did.
        method: What drives a trial; empty for people and the scene alone.
    """

    stack: ControlStack
    kinematics: Kinematics
    title: str
    progress: Callable[[], tuple[str, str | None]] = lambda: ("", None)
    method: str = ""
    _drawn_commands: tuple[TrajectoryCommand, ...] = ()
    _preview: Preview = NO_PREVIEW

    def __call__(self) -> Overlay:
        """Return the current overlay."""
        stack = self.stack
        state = str(stack.state)
        phase, aborted = self.progress()
        if phase and phase != state:
            state = f"{state}, {phase}"
        status = aborted or ""
        if stack.reflex is not None:
            status = stack.reflex.message
        return Overlay(
            title=self.title,
            method=self.method,
            mode="" if self.method else stack.source or "hold",
            source=self._source(),
            controller=" + ".join(name.replace("_", " ") for name in stack.manager.active),
            state=state,
            status=status,
            preview=self._planned(),
        )

    def _source(self) -> str:
        """Return the source that commands the arms; in a trial, the method."""
        source = self.stack.output.active_source
        if source is None:
            return "none, posture held"
        return self.method or source

    def _planned(self) -> Preview:
        """Return the paths of the trajectories under way; the same object while they are the same."""
        underway = (execution.command for execution in self.stack.arbiter.underway.executions)
        commands = tuple(command for command in underway if isinstance(command, TrajectoryCommand))
        drawn = [id(command) for command in self._drawn_commands]
        if [id(command) for command in commands] != drawn:
            self._drawn_commands = commands
            lines = (line for command in commands for line in self._paths(command))
            self._preview = Preview(tuple(lines))
        return self._preview

    def _paths(self, command: TrajectoryCommand) -> tuple[PathLine, ...]:
        """Return the paths of the hands along a trajectory; arms outside its group rest."""
        times = np.linspace(0.0, command.motion.duration_s, _PATH_POINTS_N, dtype=np.float64)
        qs = np.tile(self.stack.plant.q, (len(times), 1))
        group = self.kinematics.robot.groups[command.group]
        samples = command.motion.sample_many(times)[0]
        covers_only_group = samples.shape[1] == qs[:, group].shape[1]
        qs[:, group] = samples if covers_only_group else samples[:, group]
        return tcp_preview(self.kinematics, qs).paths
