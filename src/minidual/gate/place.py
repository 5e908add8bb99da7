"""The place of one result on disk."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from minidual.durable import require
from minidual.errors import DataError
from minidual.gate.verdict import VERDICT_FILE

ASIDE = "set-aside"


@dataclass(frozen=True)
class ResultPlace:
    """The place of one result.

    Attributes:
        name: `runs/<run>/<stage>`. If it is a link to a folder elsewhere, the result lies and is
            replaced there.
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
        """Check that nothing is in the way of reading the result, or of `replacing` it.

        Raises:
            DataError: Links, files, mount points or permissions are.
        """
        paths = [self.folder, self.temporary, self.old]
        if replacing:
            paths.append(self.folder.with_name(ASIDE))
        for path in paths:
            require(self.name if path == self.folder and self.name.exists() else path, "folder")
            if path.is_symlink():
                raise DataError(
                    f"{path} is a link; minidual keeps a folder there",
                    remedy="remove the link",
                )
            if replacing and path.exists() and not os.access(path, os.W_OK):
                raise DataError(
                    f"no permission to write in {path}",
                    remedy="change its permissions",
                )
        if self.folder != self.name:
            self._check_target()
        if replacing and self.folder.is_mount():
            raise DataError(
                f"{self.folder} is a mount point, which cannot be replaced",
                remedy="mount that disk elsewhere and make a link to a folder on it",
            )

    def _check_target(self) -> None:
        reason = self._unfit_target()
        if reason:
            raise DataError(
                f"{self.name} is a link to {self.folder}, {reason}",
                remedy="make it a link to an empty folder elsewhere",
            )

    def _unfit_target(self) -> str:
        """Return why the folder that the link leads to is none for a result; "" if it is."""
        run = self.name.parent
        for path in run.glob("*"):
            other_link = path.is_symlink() and path != self.name
            if other_link and _overlap(path.resolve(), self.folder):
                return f"where the link {path.name} leads, too"
        if _overlap(self.folder, run.resolve()):
            return "in or above its own run"
        if not self.folder.parent.is_dir():
            return f"but {self.folder.parent} is no folder (is its disk mounted?)"
        if _holds_something_else(self.folder):
            return "whose files are no result of minidual"
        return ""


def _overlap(one: Path, other: Path) -> bool:
    return one.is_relative_to(other) or other.is_relative_to(one)


def _holds_something_else(folder: Path) -> bool:
    """Return whether a folder has files but no verdict."""
    if not folder.is_dir() or not any(folder.iterdir()):
        return False
    return not (folder / VERDICT_FILE).exists()
