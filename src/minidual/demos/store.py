"""A folder of episodes. The files are the truth: nothing is counted that cannot be found on the disk."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from minidual import durable
from minidual.demos.episode import EpisodeWriter, read_meta
from minidual.demos.schema import EpisodeMeta
from minidual.demos.validate import check_structure

_NAME = re.compile(r"^episode_(?P<index>\d{6})\.hdf5$")

#: Folder, inside the store, that takes files which cannot be used.
QUARANTINE = "quarantine"


@dataclass(frozen=True)
class RepairReport:
    """What a repair did.

    Attributes:
        removed: Half-written temporaries of dead writers, now gone.
        quarantined: Where broken files lie now, each with its reason.
    """

    removed: tuple[Path, ...]
    quarantined: tuple[tuple[Path, str], ...]

    @property
    def changed(self) -> bool:
        """Whether anything was done."""
        return bool(self.removed or self.quarantined)


class EpisodeStore:
    """Episodes named ``episode_000000.hdf5`` and up in one folder, which is made if missing."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        durable.make_folder(self.folder)

    def __len__(self) -> int:
        return len(self.indices())

    def indices(self) -> list[int]:
        """Return the indices of the episodes on the disk, ascending."""
        return sorted(int(match["index"]) for path in self.folder.iterdir() if (match := _NAME.match(path.name)))

    def path(self, index: int) -> Path:
        """Return the path of an episode, whether or not it exists."""
        return self.folder / f"episode_{index:06d}.hdf5"

    def paths(self, *, success: bool | None = None) -> list[Path]:
        """Return the episodes in order; with `success`, only those that did or did not achieve the task.

        Raises:
            DataError: `success` is given and a file cannot be read; `repair` sets such files aside.
        """
        paths = [self.path(index) for index in self.indices()]
        return paths if success is None else [path for path in paths if read_meta(path)[0].success is success]

    def metas(self) -> list[EpisodeMeta]:
        """Return what each episode is, in order; raises DataError as `paths`."""
        return [read_meta(path)[0] for path in self.paths()]

    def next_index(self) -> int:
        """Return one past the highest index on the disk, those set aside included."""
        return max([*self.indices(), *self._quarantined_indices()], default=-1) + 1

    def missing(self, count: int) -> list[int]:
        """Return the indices below `count` that have no episode: what is left to record."""
        present = set(self.indices())
        return [index for index in range(count) if index not in present]

    def writer(self, meta: EpisodeMeta, index: int | None = None) -> EpisodeWriter:
        """Return a writer for an episode; the next free index when None."""
        return EpisodeWriter(self.path(self.next_index() if index is None else index), meta)

    def repair(self, *, cameras: Sequence[str] | None = None) -> RepairReport:
        """Remove what dead writers left half-written, and set unusable files aside with the reason.

        No finished file is ever deleted. Running it again changes nothing.

        Args:
            cameras: Cameras that every episode must hold, in order; not checked when None.
        """
        removed = [path for path in sorted(self.folder.iterdir()) if durable.is_stale(path)]
        for path in removed:
            durable.remove(path)
        quarantined: list[tuple[Path, str]] = []
        for path in self.paths():
            problems = check_structure(path, cameras=cameras)
            if problems:
                reason = "\n".join(str(problem) for problem in problems)
                quarantined.append((self._set_aside(path, reason), reason))
        return RepairReport(tuple(removed), tuple(quarantined))

    def _set_aside(self, path: Path, reason: str) -> Path:
        folder = self.folder / QUARANTINE
        folder.mkdir(exist_ok=True)
        target = folder / path.name
        copy = 1
        while target.exists():
            target = folder / f"{path.stem}.{copy}{path.suffix}"
            copy += 1
        # The reason first: a file set aside without one would be a riddle.
        target.with_name(f"{target.name}.reason.txt").write_text(reason + "\n", encoding="utf-8")
        path.rename(target)
        durable.sync(folder)
        durable.sync(self.folder)
        return target

    def _quarantined_indices(self) -> list[int]:
        folder = self.folder / QUARANTINE
        if not folder.is_dir():
            return []
        found = (re.match(r"^episode_(\d{6})(\.\d+)?\.hdf5$", path.name) for path in folder.iterdir())
        return [int(match[1]) for match in found if match]
