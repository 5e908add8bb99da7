"""Demonstrations as a recording for the viewer rerun (.rrd)."""

import importlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from minidual.demos.data.source import DataEpisode, DataSource
from minidual.errors import EnvironmentMissingError

_TIME = "time"
_QUALITY = 85
"""Of the JPEG pictures."""


def write_rerun(source: DataSource, numbers: Sequence[int], path: Path) -> None:
    """Write the episodes with these numbers; each begins at time 0 of its own timeline.

    Raises:
        EnvironmentMissingError: rerun is not installed.
    """
    rr = _rerun()
    recording = rr.RecordingStream("minidual_data", recording_id=path.stem)
    recording.save(path)
    rates: dict[int, float] = {}
    for number, reading in enumerate(source.episodes()):
        if number in numbers and reading.episode is not None:
            rates[number] = reading.episode.rate_hz
            _log_numbers(rr, recording, number, reading.episode)
    for camera in source.cameras():
        for number, images in source.pictures(camera):
            if number not in rates:
                continue
            for tick, image in enumerate(images):
                recording.set_time(_TIME, duration=tick / rates[number])
                picture = rr.Image(image).compress(jpeg_quality=_QUALITY)
                recording.log(f"episode_{number}/{camera}", picture)
    recording.flush()
    recording.disconnect()


def _log_numbers(rr: Any, recording: Any, number: int, episode: DataEpisode) -> None:
    """Log states, actions and efforts, one curve each."""
    columns = {f"state/{name}": episode.state[:, k] for k, name in enumerate(episode.state_names)}
    for k, name in enumerate(episode.action_names):
        columns[f"action/{name}"] = episode.action[:, k]
    if episode.effort is not None:
        for k in range(episode.effort.shape[1]):
            columns[f"effort/{k}"] = episode.effort[:, k]
    times = rr.TimeColumn(_TIME, duration=episode.times_s)
    for name, values in columns.items():
        scalars = rr.Scalars.columns(scalars=values)
        recording.send_columns(f"episode_{number}/{name}", indexes=[times], columns=scalars)


def _rerun() -> Any:
    if importlib.util.find_spec("rerun") is None:
        raise EnvironmentMissingError(
            "--rrd needs the library rerun-sdk, which is not installed",
            remedy="pip install 'minidual[rerun]' (in a checkout: uv pip install rerun-sdk)",
        )
    return importlib.import_module("rerun")
