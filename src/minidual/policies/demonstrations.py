"""Demonstrations in memory, and their sampling."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.demos.lerobot_features import is_own
from minidual.demos.lerobot_reader import LeRobotTables, Rows, read_dataset, read_signal
from minidual.demos.lerobot_video import Image
from minidual.demos.quality import grip_changes
from minidual.demos.signals import DRIVERS
from minidual.errors import DataError
from minidual.policies.inputs import read_input
from minidual.policies.takes import Takes, gripper_columns
from minidual.robot.pair import GRIPPERS_N

SWITCH_SHARE_MIN = 0.5
"""Grippers that move less, of the most over all episodes, do not switch."""
SWITCH_TICKS_MIN = 25
"""Switches no further apart count once: both hands switch together."""
INSTRUCTIONS_MAX = 16
"""A policy reads the instruction of a dataset with no more; further ones are descriptions."""


@dataclass
class Demonstrations:
    """N ticks of recorded episodes.

    Attributes:
        images: (N, H, W, 3) uint8 by camera.
        state, action: (N, dim): joints [rad], left then right, gripper openings; of another robot
            what `takes` names. Behind them a state holds the inputs that `takes` counts, then an
            entry for each of its instructions: 1 for the one that holds.
        takes: What a policy trained on them takes; None: joints of two arms and two openings.
        driver: (N,) who drove, see `demos.signals.DRIVERS`; None: a leader, in every tick.
        episode_index: (N,) ascending.
        phase: (N,) gripper switches before the tick.
        keyframe_ticks: (N, K) rows of the episode's switches, or -1; K of the episode with most.
        last_tick: (N,) the episode's last row.
    """

    images: dict[str, Image]
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    episode_index: Rows
    takes: Takes | None = None
    driver: Rows | None = None
    phase: Rows = field(init=False)
    keyframe_ticks: Rows = field(init=False)
    last_tick: Rows = field(init=False)

    def __post_init__(self) -> None:
        """Derive phases; DataError for invalid data."""
        self._check()
        openings = self.action[:, self.switching]
        span = openings.max(axis=0) - openings.min(axis=0)
        bounds = list(self.episode_bounds().values())
        switches = [gripper_switches(openings[start:stop], span) for start, stop in bounds]
        switches_max = max(map(len, switches))
        self.phase = np.zeros(len(self), dtype=np.int64)
        self.last_tick = np.zeros(len(self), dtype=np.int64)
        self.keyframe_ticks = np.full((len(self), switches_max), -1, dtype=np.int64)
        for (start, stop), ticks in zip(bounds, switches, strict=True):
            self.last_tick[start:stop] = stop - 1
            for k, tick in enumerate(ticks):
                # The switching tick belongs to the phase before it.
                self.phase[start + tick + 1 : stop] += 1
                self.keyframe_ticks[start:stop, k] = start + tick

    def __len__(self) -> int:
        return int(self.state.shape[0])

    @property
    def dim(self) -> int:
        """Entries of an action."""
        return int(self.action.shape[1])

    @property
    def state_dim(self) -> int:
        """Entries of a state, inputs and instructions included."""
        return int(self.state.shape[1])

    @property
    def instructions(self) -> tuple[str, ...]:
        """Instructions that a state tells, none if they are all the same."""
        return () if self.takes is None else self.takes.instructions

    @property
    def sensed(self) -> NDArray[np.float32]:
        """Joints, openings and inputs (N, entries): the states without instructions."""
        return self.state[:, : self.state_dim - len(self.instructions)]

    def instruction(self, row: int) -> str:
        """Return the instruction of a row, or "" if all are the same."""
        told = self.state[row, self.sensed.shape[1] :]
        return self.instructions[int(told.argmax())] if self.instructions else ""

    @property
    def inputs(self) -> dict[str, int]:
        """Entries of each input behind joints and openings, by signal."""
        return {} if self.takes is None else self.takes.inputs

    @property
    def state_inputs(self) -> list[int]:
        """Entries of a state that are inputs."""
        sensed_n = self.sensed.shape[1]
        return list(range(sensed_n - sum(self.inputs.values()), sensed_n))

    @property
    def joints(self) -> list[int]:
        """Entries of an action that are no openings."""
        return _without(self.dim, self._openings("action"))

    @property
    def state_joints(self) -> list[int]:
        """Entries of a state that are neither openings nor inputs nor instructions."""
        return _without(self.sensed.shape[1], [*self._openings("state"), *self.state_inputs])

    @property
    def state_grippers(self) -> list[int]:
        """Entries of a state that are openings."""
        return self._openings("state")

    @property
    def switching(self) -> list[int]:
        """Entries of an action whose switches divide an episode: openings that are measured, too.

        A policy sees by the state which switches are past.
        """
        return self._openings("action") if self._openings("state") else []

    @property
    def commanded_grippers(self) -> list[int]:
        """Entries of an action that command the openings of a state, one each; else none."""
        commanded = self._openings("action")
        return commanded if len(commanded) == len(self.state_grippers) else []

    def _openings(self, vector: Literal["state", "action"]) -> list[int]:
        if self.takes is not None:
            return gripper_columns(getattr(self.takes, vector))
        return list(range(self.dim - GRIPPERS_N, self.dim))

    @property
    def cameras(self) -> list[str]:
        """Sorted camera names."""
        return sorted(self.images)

    def episode_bounds(self) -> dict[int, tuple[int, int]]:
        """Return {episode: (first row, one past the last)}."""
        episodes, starts = np.unique(self.episode_index, return_index=True)
        stops = [*starts[1:].tolist(), len(self)]
        bounds: dict[int, tuple[int, int]] = {}
        for episode, start, stop in zip(episodes, starts, stops, strict=True):
            bounds[int(episode)] = (int(start), int(stop))
        return bounds

    def rows_of(self, episodes: list[int]) -> Rows:
        """Return their rows."""
        bounds = self.episode_bounds()
        rows = [np.arange(*bounds[episode]) for episode in episodes]
        return np.concatenate([np.empty(0, np.int64), *rows])

    def _check(self) -> None:
        if len(self) == 0:
            raise DataError("the dataset holds no ticks", remedy="minidual teleop-record")
        is_own = self.takes is None or self.takes.radians
        measured = (len(self.state), self.sensed.shape[1] - sum(self.inputs.values()))
        if is_own and (measured != self.action.shape or self.dim <= GRIPPERS_N):
            raise DataError(
                f"dataset column 'action' has shape {self.action.shape}, "
                f"'state' {self.state.shape}",
            )
        if not self.images:
            raise DataError(
                "the dataset has no camera images, which the policies here look at",
                remedy="record with a camera: minidual teleop-record, or another recorder's option",
            )
        if np.any(np.diff(self.episode_index) < 0):
            raise DataError(
                "dataset column 'episode_index' is not ascending: episodes must be contiguous",
            )


def load_demonstrations(
    root: Path,
    cameras: Sequence[str],
    progress: Callable[[int], None] | None = None,
    *,
    folder: Path | None = None,
    height: int | None = None,
    inputs: Sequence[str] = (),
) -> Demonstrations:
    """Read a LeRobot dataset with `cameras` (all if empty).

    `folder` takes images for which memory is short; higher images than `height` are scaled down.
    `inputs` are recorded signals that follow joints and openings in each state.

    Raises:
        DataError: Missing or corrupt dataset, or one without a signal.
        UsageError: Unknown camera, or a signal that no policy senses.
    """
    tables = read_dataset(root)
    signals = {name: read_input(root, name) for name in inputs}
    instructions = instructions_of(tables)
    images = {
        camera: tables.images(camera, progress, folder=folder, height=height)
        for camera in sorted(cameras or tables.cameras)
    }
    takes = Takes(
        state=tables.names,
        action=tables.action_names,
        inputs={name: values.shape[1] for name, values in signals.items()},
        instructions=instructions,
        rate_hz=tables.fps,
        robot=tables.info.robot,
        radians=is_own(root),
    )
    sizes = {name: (array.shape[1], array.shape[2]) for name, array in images.items()}
    takes = takes.with_cameras(sizes)
    return Demonstrations(
        images,
        np.concatenate([tables.state, *signals.values(), _told(tables, instructions)], axis=1),
        tables.action,
        tables.episode_index,
        takes,
        _driver(root),
    )


def instructions_of(tables: LeRobotTables) -> tuple[str, ...]:
    """Return the instructions that a policy has to read: none if all are the same, or too many."""
    found = sorted(set(tables.instructions()))
    return tuple(found) if 1 < len(found) <= INSTRUCTIONS_MAX else ()


def _told(tables: LeRobotTables, instructions: Sequence[str]) -> NDArray[np.float32]:
    """Return an entry for each instruction (N, entries): 1 for the one of the tick's episode."""
    told = np.zeros((len(tables), len(instructions)), dtype=np.float32)
    if instructions:
        spans = zip(tables.starts, tables.stops, tables.instructions(), strict=True)
        for start, stop, instruction in spans:
            told[start:stop, instructions.index(instruction)] = 1.0
    return told


def _driver(root: Path) -> Rows | None:
    """Return the driver of each tick (N,), None if it was not recorded."""
    values = read_signal(root, "driver")
    if values is None:
        return None
    driver = values[:, 0].astype(np.int64)
    if np.any(driver != values[:, 0]) or np.any((driver < 0) | (driver >= len(DRIVERS))):
        raise DataError(f"{root}: 'driver' holds other numbers than 0 to {len(DRIVERS) - 1}")
    return driver


def joined(parts: Sequence[Demonstrations]) -> Demonstrations:
    """Return the episodes of several datasets as one; ticks of unknown drivers are a leader's.

    Raises:
        DataError: They have other joints, cameras or sizes of pictures.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.dim != first.dim or part.state.shape[1] != first.state.shape[1]:
            raise DataError(
                f"the datasets hold {first.dim} and {part.dim} entries an action, and "
                f"{first.state.shape[1]} and {part.state.shape[1]} a state; "
                "corrections need the arms and the signals of the demonstrations",
            )
        for camera, images in first.images.items():
            other = part.images.get(camera)
            if other is None or other.shape[1:] != images.shape[1:]:
                size = "no pictures" if other is None else f"pictures of {other.shape[1:]}"
                raise DataError(
                    f"camera '{camera}' has pictures of {images.shape[1:]} and {size}; "
                    "record corrections with the cameras of the demonstrations",
                )
    episodes: list[Rows] = []
    drivers: list[Rows] = []
    begun_n = 0
    for part in parts:
        _, numbers = np.unique(part.episode_index, return_inverse=True)
        episodes.append(numbers.astype(np.int64) + begun_n)
        begun_n += int(numbers.max()) + 1
        if part.driver is None:
            drivers.append(np.zeros(len(part), dtype=np.int64))
        else:
            drivers.append(part.driver)
    return Demonstrations(
        {name: np.concatenate([part.images[name] for part in parts]) for name in first.images},
        np.concatenate([part.state for part in parts]),
        np.concatenate([part.action for part in parts]),
        np.concatenate(episodes),
        first.takes,
        np.concatenate(drivers),
    )


def _without(count: int, columns: Collection[int]) -> list[int]:
    return [k for k in range(count) if k not in columns]


def gripper_switches(gripper: NDArray[np.float32], span: NDArray[np.float32]) -> list[int]:
    """Return ticks where a gripper command (T, 2) crosses mid-range.

    Crossings within 25 ticks count once; grippers moving less than half of `span` (2,) are ignored.
    """
    crossings: list[int] = []
    for values, largest in zip(gripper.T, span, strict=True):
        if largest > 1e-6 and np.ptp(values) >= SWITCH_SHARE_MIN * largest:
            crossings += grip_changes(values)
    switches: list[int] = []
    for tick in sorted(crossings):
        if not switches or tick - switches[-1] > SWITCH_TICKS_MIN:
            switches.append(tick)
    return switches


class Split(NamedTuple):
    """Episodes for training and for validation."""

    training: list[int]
    validation: list[int]


def split_episodes(
    episodes: Collection[int],
    fraction: float,
    rng: np.random.Generator,
) -> Split:
    """Draw the validation episodes; at least one episode trains."""
    count = min(round(fraction * len(episodes)), len(episodes) - 1)
    if fraction > 0 and len(episodes) > 1:
        count = max(count, 1)
    held_out = set(rng.permutation(len(episodes))[:count].tolist())
    split = Split([], [])
    for index, episode in enumerate(episodes):
        part = split.validation if index in held_out else split.training
        part.append(episode)
    return split
