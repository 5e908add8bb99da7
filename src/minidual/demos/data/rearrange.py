"""Join demonstrations into new ones, and divide them into parts."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, cast

from minidual import durable
from minidual.config.seeds import stream
from minidual.demos.data.hdf5_source import Hdf5Source
from minidual.demos.data.lerobot_source import LeRobotSource
from minidual.demos.data.source import DataEpisode, DataSource
from minidual.demos.lerobot_reader import read_dataset
from minidual.errors import DataError, UsageError, shortened
from minidual.robot.pair import Robot

EPISODES = "episodes"
DATASET = "lerobot"
"""Folders of a recording."""


class Format(NamedTuple):
    """The format that all episodes of a dataset share."""

    rate_hz: float
    state: tuple[str, ...]
    action: tuple[str, ...]
    cameras: tuple[tuple[str, tuple[int, int]], ...]


def merge(sources: Sequence[DataSource], out: Path, robot: Robot) -> int:
    """Write all episodes into the new folder `out`; return their number.

    Episodes of this program become a recording (episodes and dataset), LeRobot datasets one
    dataset, and others a dataset.

    Raises:
        UsageError: The folder exists, or the formats differ.
        DataError: An episode is damaged.
    """
    _require_new(out)
    _require_one_format(sources)
    with durable.replacing(out) as partial:
        if all(isinstance(source, LeRobotSource) for source in sources):
            _edit().join_datasets([source.root for source in sources], partial)
            read_dataset(partial)
        elif all(isinstance(source, Hdf5Source) and source.is_own for source in sources):
            own = cast(Sequence[Hdf5Source], sources)
            paths = [path for source in own for path in source.paths]
            names = [f"episode_{k:06d}.hdf5" for k in range(len(paths))]
            _write_recording(paths, names, partial, robot)
        else:
            partial.mkdir(parents=True)
            _edit().write_dataset(sources, partial / DATASET)
            read_dataset(partial / DATASET)
    return sum(map(len, sources))


def split(
    source: DataSource,
    parts: Mapping[str, Sequence[int]],
    out: Path,
    robot: Robot,
) -> None:
    """Write each part's episodes into the new folder `out`/NAME.

    Raises:
        UsageError: The folder exists.
    """
    _require_new(out)
    with durable.replacing(out) as partial:
        if isinstance(source, LeRobotSource):
            _edit().divide_dataset(source.root, parts, partial)
            for name in parts:
                read_dataset(partial / name)
            return
        files = cast(Hdf5Source, source)
        for name, numbers in parts.items():
            paths = [files.paths[number] for number in sorted(numbers)]
            names = [path.name for path in paths]
            if files.is_own:
                _write_recording(paths, names, partial / name, robot)
            else:
                _copy(paths, names, partial / name)


def drawn_parts(shares: Mapping[str, float], count: int, seed: int) -> dict[str, list[int]]:
    """Draw which episodes belong to each part.

    Args:
        shares: Of all episodes, by part; together at most 1.
        count: Number of episodes.
        seed: Of the draw.

    Raises:
        UsageError: A share is out of bounds, or too small for one episode.
    """
    total = sum(shares.values())
    if not shares or min(shares.values()) <= 0.0 or total > 1.0 + 1e-9:
        text = ", ".join(f"{name}={share:g}" for name, share in shares.items())
        raise UsageError(f"parts {text or 'none'}: shares are above 0, and together at most 1")
    order = stream(seed, "data.split").permutation(count).tolist()
    parts: dict[str, list[int]] = {}
    used = 0.0
    for name, share in shares.items():
        first = round(used * count)
        used += share
        parts[name] = sorted(order[first : round(used * count)])
        if not parts[name]:
            raise UsageError(f"part '{name}' of {share:g} has no episode: there are {count}")
    return parts


def parsed_shares(text: str) -> dict[str, float]:
    """Return {part: share} of "train=0.9,test=0.1"; UsageError for another form."""
    shares: dict[str, float] = {}
    for word in text.split(","):
        name, _, number = word.strip().partition("=")
        try:
            share = float(number)
        except ValueError as error:
            raise UsageError(f"--parts {text}: type NAME=SHARE,NAME=SHARE") from error
        if not name.isidentifier() or name in shares:
            raise UsageError(f"--parts {text}: '{name}' is no name of its own")
        shares[name] = share
    return shares


def _require_new(out: Path) -> None:
    if out.exists():
        raise UsageError(f"{out} exists already", remedy="name another folder")
    durable.make_folder(out.absolute().parent)


def _require_one_format(sources: Sequence[DataSource]) -> None:
    """Raise UsageError unless all episodes have one rate, names and cameras."""
    first: tuple[str, Format] | None = None
    for source in sources:
        for reading in source.episodes():
            if reading.episode is None:
                raise DataError(
                    f"{source.root}: {reading.name} cannot be read: {reading.faults[0]}",
                    remedy=f"minidual data check {source.root}; take the file out, or mend it",
                )
            label = f"{source.root} ({reading.name})"
            own = _format_of(reading.episode)
            if first is None:
                first = label, own
            elif own != first[1]:
                raise UsageError(f"{_difference(first, (label, own))}; one dataset has one format")
    if first is None:
        raise UsageError("there is no episode to merge")


def _format_of(episode: DataEpisode) -> Format:
    cameras = tuple(sorted(episode.cameras.items()))
    return Format(episode.rate_hz, episode.state_names, episode.action_names, cameras)


def _difference(first: tuple[str, Format], second: tuple[str, Format]) -> str:
    """Return in words how two formats differ, which must."""
    label, one = first
    other_label, other = second
    key = next(key for key in Format._fields if getattr(one, key) != getattr(other, key))
    return f"{label} has {_text(one)[key]}, {other_label} has {_text(other)[key]}"


def _text(one: Format) -> dict[str, str]:
    cameras = [f"{name} {size[0]} x {size[1]}" for name, size in one.cameras]
    return {
        "rate_hz": f"{one.rate_hz:g} Hz",
        "state": f"the state {shortened(one.state)} ({len(one.state)})",
        "action": f"the action {shortened(one.action)} ({len(one.action)})",
        "cameras": f"the cameras {', '.join(cameras) or 'none'}",
    }


def _write_recording(
    paths: Sequence[Path],
    names: Sequence[str],
    folder: Path,
    robot: Robot,
) -> None:
    """Copy episodes under new names, and make the dataset of them."""
    from minidual.demos import lerobot_adapter  # takes seconds

    copies = _copy(paths, names, folder / EPISODES)
    lerobot_adapter.convert(copies, folder / DATASET, robot)


def _copy(paths: Sequence[Path], names: Sequence[str], folder: Path) -> list[Path]:
    folder.mkdir(parents=True)
    copies: list[Path] = []
    for path, name in zip(paths, names, strict=True):
        copies.append(folder / name)
        shutil.copyfile(path, copies[-1])
    return copies


def _edit() -> ModuleType:
    """Return the module that imports LeRobot, which takes seconds."""
    from minidual.demos.data import lerobot_edit

    return lerobot_edit
