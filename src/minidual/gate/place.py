"""Where the result of a stage or tool lies while it is made, finished and replaced."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from minidual.durable import require
from minidual.errors import DataError
from minidual.gate.manifest import VERDICT_FILE

ASIDE = "set-aside"


@dataclass(frozen=True)
class Place:
    """The place of one result.

    Attributes:
        name: `runs/<run>/<stage>`. If it is a link to a folder elsewhere, the result lies and is replaced there.
    """

    name: Path

    @cached_property
    def folder(self) -> Path:
        """Folder of the finished result; need not exist."""
        return Path(os.path.realpath(self.name)) if self.name.is_symlink() else self.name

    @property
    def temporary(self) -> Path:
        """Folder of the unfinished result."""
        return self.folder.with_name(f".{self.folder.name}.tmp")

    @property
    def old(self) -> Path:
        """Folder of the previous result during replacement."""
        return self.folder.with_name(f".{self.folder.name}.old")

    def check(self, *, replacing: bool = True) -> None:
        """Raise DataError if links, files, mount points or permissions are in the way of reading, or `replacing`, it."""
        aside = (self.folder.with_name(ASIDE),) if replacing else ()
        for path in (self.folder, self.temporary, self.old, *aside):
            require(self.name if path == self.folder and self.name.exists() else path, "folder")
            if path.is_symlink():
                raise DataError(f"{path} is a link; minidual keeps a folder there", remedy="remove the link")
            if replacing and path.exists() and not os.access(path, os.W_OK):
                raise DataError(f"no permission to write in {path}", remedy="change its permissions")
        if self.folder != self.name and (why := self._unfit_target()):
            remedy = "make it a link to an empty folder elsewhere"
            raise DataError(f"{self.name} is a link to {self.folder}, {why}", remedy=remedy)
        if replacing and self.folder.is_mount():
            remedy = "mount that disk elsewhere and make a link to a folder on it"
            raise DataError(f"{self.folder} is a mount point, which cannot be replaced", remedy=remedy)

    def _unfit_target(self) -> str:
        """Return why the target of the link cannot hold the result, or ""."""
        run = self.name.parent.resolve()
        others = (path for path in self.name.parent.glob("*") if path.is_symlink() and path != self.name)
        if same := [path.name for path in others if _overlap(path.resolve(), self.folder)]:
            return f"where the link {same[0]} leads, too"
        if _overlap(self.folder, run):
            return "in or above its own run"
        if not self.folder.parent.is_dir():
            return f"but {self.folder.parent} is no folder (is its disk mounted?)"
        if self.folder.is_dir() and any(self.folder.iterdir()) and not (self.folder / VERDICT_FILE).exists():
            return "whose files are no result of minidual"
        return ""


def _overlap(one: Path, other: Path) -> bool:
    return one.is_relative_to(other) or other.is_relative_to(one)
