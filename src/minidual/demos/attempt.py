"""Attempts at a demonstration, and their files in a recording's folder."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import Field, ValidationError

from minidual import durable
from minidual.config.base import StrictModel
from minidual.demos.checks import Thumbnails
from minidual.demos.lag import Lag
from minidual.demos.quality import EpisodeQuality
from minidual.errors import DataError
from minidual.tasks.task import Trial, placement

KEPT = "episodes"
REJECTED = "rejected"
ATTEMPTS = "attempts"
"""Folders of a recording: demonstrations, other episodes, and one JSON file for each attempt."""
MEASURES = ("completion_s", "goal_error_m", "tilt_max_rad", "lag_s")


@dataclass(frozen=True)
class Attempt:
    """One trial that was run.

    Attributes:
        reason: Why it is no demonstration, or "".
        latencies_s: Wall time per tick, see `SessionResult`.
        wall_s: Wall time to plan, run, write and read back.
        adopted: Whether an interrupted recording ran it.
        quality, lag, sync_error_max_s, faults, views: Of the file, read back; `views` are thumbnails.
    """

    trial: Trial
    success: bool
    reason: str
    path: Path | None = None
    measures: Mapping[str, float] = field(default_factory=dict)
    latencies_s: Sequence[float] = ()
    wall_s: float = 0.0
    adopted: bool = False
    quality: EpisodeQuality | None = None
    lag: Lag | None = None
    sync_error_max_s: float = float("nan")
    faults: tuple[str, ...] = ()
    views: Thumbnails = field(default_factory=dict)

    @property
    def kept(self) -> bool:
        """Whether it became a demonstration."""
        return not self.reason

    def row(self) -> dict[str, object]:
        """Return a flat CSV row."""
        x, y, yaw = placement(next(iter(self.trial.start.values())))
        row: dict[str, object] = {
            "trial": self.trial.index,
            "start_x_m": x,
            "start_y_m": y,
            "start_yaw_rad": yaw,
            "success": self.success,
            "kept": self.kept,
            "reason": self.reason,
        }
        row |= dict.fromkeys(MEASURES, float("nan"))
        row |= self.measures
        if self.quality is None:
            row["file"] = ""
            row |= dict.fromkeys(EpisodeQuality._fields, "")
        else:
            row["file"] = "" if self.path is None else self.path.name
            row |= self.quality._asdict()
        return {name: _rounded(value) for name, value in row.items()}


def _rounded(value: object) -> object:
    return round(value, 6) if isinstance(value, float) else value


class AttemptRecord(StrictModel):
    """An attempt's JSON file.

    Attributes:
        path: The episode's file within the recording's folder, None if there is none.
    """

    success: bool
    reason: str
    measures: dict[str, float]
    latencies_s: tuple[float, ...]
    wall_s: float
    path: str | None = Field(pattern=rf"^({KEPT}|{REJECTED})/episode_\d{{6}}\.hdf5$")


class AttemptFiles:
    """The files of attempts in a recording's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @staticmethod
    def episode_name(index: int) -> str:
        """Return the name of a trial's episode."""
        return f"episode_{index:06d}.hdf5"

    def record_path(self, index: int) -> Path:
        """Return the path of a trial's JSON file."""
        return self.folder / ATTEMPTS / f"{index:06d}.json"

    def link_path(self, index: int) -> Path:
        """Return the path of the log of a trial's link (CSV)."""
        return self.folder / ATTEMPTS / f"{index:06d}-link.csv"

    def write(self, attempt: Attempt) -> None:
        """Write an attempt's JSON file."""
        path = attempt.path
        record = {
            "success": attempt.success,
            "reason": attempt.reason,
            "measures": attempt.measures,
            "latencies_s": attempt.latencies_s,
            "wall_s": attempt.wall_s,
            "path": None if path is None else f"{path.parent.name}/{path.name}",
        }
        durable.make_folder(self.folder / ATTEMPTS)
        durable.write_text(self.record_path(attempt.trial.index), json.dumps(record) + "\n")

    def read(self, trial: Trial) -> Attempt | None:
        """Return a trial's attempt from its JSON file, None if it has none.

        The files of a damaged one are set aside.
        """
        path = self.record_path(trial.index)
        if not path.exists():
            return None
        try:
            record = AttemptRecord.model_validate(durable.read_json(path))
        except (DataError, ValidationError):
            episodes = self.folder.glob(f"*/{self.episode_name(trial.index)}")
            for damaged in (path, *episodes):
                durable.set_aside(damaged, damaged.name)
            return None
        return Attempt(
            trial=trial,
            success=record.success,
            reason=record.reason,
            path=None if record.path is None else self.folder / record.path,
            measures=record.measures,
            latencies_s=record.latencies_s,
            wall_s=record.wall_s,
            adopted=True,
        )
