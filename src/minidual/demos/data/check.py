"""Named faults of demonstrations of any origin."""

import zlib
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from minidual.demos import checks
from minidual.demos.checks import Thumbnails, camera_references, check_swapped, thumbnails
from minidual.demos.data.hdf5_source import Hdf5Source
from minidual.demos.data.lerobot_source import LeRobotSource
from minidual.demos.data.source import DataEpisode, DataSource, EpisodeReading, Image
from minidual.demos.episode import TICKS_MIN
from minidual.demos.faults import EpisodeFault
from minidual.demos.lerobot_video import BRIGHTNESS_MAX, colour_difference

JUMP_SHARE = 0.5
"""Of an entry's range: a reading that changes by more between two ticks has jumped."""
JUMP_TICKS_MIN = 10
"""Shorter episodes have no usual change."""


class Finding(NamedTuple):
    """A fault of an episode."""

    episode: str
    fault: EpisodeFault


class _PictureRecord(NamedTuple):
    """Checksums and a thumbnail of an episode's pictures, by camera."""

    checksums: dict[str, tuple[int, ...]]
    views: dict[str, np.ndarray]


def check_data(source: DataSource) -> list[Finding]:
    """Return every fault of every episode, in order.

    Raises:
        DataError: The pictures of a dataset are damaged.
    """
    readings = list(source.episodes())
    faults: list[list[EpisodeFault]] = [list(reading.faults) for reading in readings]
    own = isinstance(source, Hdf5Source) and source.is_own
    for number, reading in enumerate(readings):
        if reading.episode is not None and not own:
            faults[number] += check_numbers(reading.episode)
    records = _check_pictures(source, readings, faults, own=own)
    _check_across(records, faults, own=own)
    return [
        Finding(reading.name, fault)
        for reading, of_episode in zip(readings, faults, strict=True)
        for fault in of_episode
    ]


def check_numbers(episode: DataEpisode) -> Iterator[EpisodeFault]:
    """Report faults of states and actions of unknown units."""
    if len(episode) < TICKS_MIN:
        detail = f"{len(episode)} ticks; an episode has at least {TICKS_MIN}"
        yield EpisodeFault("too_short", detail)
        return
    arrays = {"state": episode.state, "action": episode.action}
    not_finite = list(checks.check_finite(arrays))
    yield from not_finite
    if not_finite:
        return
    yield from checks.check_monotonic(episode.times_s, "timestamps")
    if episode.state.shape == episode.action.shape:
        yield from checks.check_action_is_command(episode.state, episode.action)
    for name, values in arrays.items():
        if not np.ptp(values, axis=0).any():
            yield EpisodeFault("nothing_moves", f"no entry of the {name} changes")
    yield from _check_jumps(episode)


def _check_jumps(episode: DataEpisode) -> Iterator[EpisodeFault]:
    """Report readings that jump: a wrapped encoder, or a tick that was lost."""
    if len(episode) < JUMP_TICKS_MIN:
        return
    span = np.ptp(episode.state, axis=0)
    steps = np.abs(np.diff(episode.state, axis=0))
    usual = np.median(steps, axis=0)
    for k, name in enumerate(episode.state_names):
        largest = float(steps[:, k].max())
        # A gripper that only opens and closes changes by its whole range; its usual change is none.
        if usual[k] > 0.0 and largest > JUMP_SHARE * span[k] and largest > 20.0 * usual[k]:
            tick = int(np.argmax(steps[:, k]))
            yield EpisodeFault(
                "state_jumps",
                f"{name} changes by {largest:.4g} between ticks {tick} and {tick + 1}; "
                f"usually by {usual[k]:.2g}",
            )


def _check_pictures(
    source: DataSource,
    readings: list[EpisodeReading],
    faults: list[list[EpisodeFault]],
    *,
    own: bool,
) -> list[_PictureRecord]:
    """Add the faults of pictures; return the record of each episode's."""
    records = [_PictureRecord({}, {}) for _ in readings]
    for camera in source.cameras():
        for number, images in source.pictures(camera):
            episode = readings[number].episode
            if episode is None or not len(images):
                continue
            if not own:
                faults[number] += checks.check_images({camera: images}, episode.state)
            if isinstance(source, LeRobotSource):
                faults[number] += _check_colour(source, camera, number, images)
            records[number].checksums[camera] = tuple(
                zlib.crc32(np.ascontiguousarray(image)) for image in images
            )
            records[number].views[camera] = thumbnails({camera: images})[camera]
    return records


def _check_colour(
    source: LeRobotSource,
    camera: str,
    number: int,
    images: Image,
) -> Iterator[EpisodeFault]:
    recorded = source.tables.recorded_colour(camera, number)
    if recorded is None:
        return
    difference = colour_difference(images, recorded)
    if not difference <= BRIGHTNESS_MAX:
        yield EpisodeFault(
            "images_changed",
            f"camera '{camera}': the mean colour is {difference:.3f} from the recorded one, "
            f"limit {BRIGHTNESS_MAX:g}",
        )


def _check_across(
    records: list[_PictureRecord], faults: list[list[EpisodeFault]], *, own: bool
) -> None:
    """Add the faults that two cameras or several episodes show."""
    views: list[Thumbnails] = [record.views for record in records]
    references = camera_references(views)
    for number, record in enumerate(records):
        if not own:
            for first, second in combinations(record.checksums, 2):
                if record.checksums[first] == record.checksums[second]:
                    detail = f"cameras '{first}' and '{second}' hold the same images"
                    faults[number].append(EpisodeFault("cameras_identical", detail))
        if len(records) > 1:
            faults[number] += check_swapped(record.views, references)
