"""Publishing files so that a name either holds the whole thing or does not exist.

The work is done under a temporary name in the same folder, brought to the disk, and renamed. The temporary
name carries the writer's process id, so what a killed writer left behind can be told from work in progress.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from pathlib import Path

import psutil

from minidual.errors import UsageError

_PARTIAL = re.compile(r"^\.(?P<name>.+)\.(?P<pid>\d+)\.partial$")


def partial_path(path: Path) -> Path:
    """Return the temporary name, in the same folder, under which this process builds `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def is_partial(path: Path) -> bool:
    """Tell whether a name is one that `partial_path` gives."""
    return _PARTIAL.match(path.name) is not None


def is_stale(path: Path) -> bool:
    """Tell whether a temporary name belongs to no living writer.

    A process that took over the id of a dead writer started after the file was last written to.
    """
    match = _PARTIAL.match(path.name)
    if match is None:
        return False
    try:
        started = psutil.Process(int(match["pid"])).create_time()
        return path.stat().st_mtime < started - 1.0
    except (psutil.NoSuchProcess, FileNotFoundError):
        return True
    except psutil.AccessDenied:
        return False


def remove_stale(path: Path) -> None:
    """Remove what killed writers of `path` left behind."""
    for left in path.parent.glob(f".{path.name}.*.partial"):
        if is_stale(left):
            remove(left)


def fsync_file(path: Path) -> None:
    """Bring a file's content to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fsync_dir(path: Path) -> None:
    """Bring a folder's entries to the disk, so that a rename survives a power cut."""
    fsync_file(path)


def fsync_tree(root: Path) -> None:
    """Bring every file and folder below `root`, and `root`, to the disk."""
    for folder, _, files in os.walk(root):
        for name in files:
            fsync_file(Path(folder) / name)
        fsync_dir(Path(folder))


def publish(partial: Path, path: Path) -> None:
    """Give a finished temporary file or folder its final name, durably.

    A file replaces one of that name at once. A folder needs the name to be free (see `remove`).
    """
    if partial.is_dir():
        fsync_tree(partial)
    else:
        fsync_file(partial)
    partial.replace(path)
    fsync_dir(path.parent)


def remove(path: Path) -> None:
    """Remove a file or a whole folder if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        with contextlib.suppress(NotADirectoryError):  # no folder, so nothing in it
            path.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make a folder and those above it; raise UsageError where that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {path}: {error}", remedy="choose another folder") from error
