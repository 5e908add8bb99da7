"""Files and folders that are either whole under their name or absent, even after a kill or a power cut.

The work is done under a temporary name in the same folder, brought to the disk (fsync) and renamed. The temporary name
carries the writer's process id, so that what a killed writer left can be told from work in progress.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Generator
from pathlib import Path

import psutil

from minidual.errors import UsageError

_PARTIAL = re.compile(r"^\..+\.(?P<pid>\d+)\.partial$")


def partial_path(path: Path) -> Path:
    """Return the temporary name under which this process makes `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


@contextlib.contextmanager
def replacing(path: Path) -> Generator[Path]:
    """Yield a temporary name; publish what was made under it when the block ends, remove it when the block raises."""
    partial = partial_path(path)
    try:
        yield partial
        publish(partial, path)
    finally:
        remove(partial)


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8): a reader sees the old file or the whole new one."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def publish(partial: Path, path: Path) -> None:
    """Bring a finished temporary file or folder to the disk and rename it.

    A file replaces one of that name; for a folder the name must be free.
    """
    for folder, _, files in os.walk(partial):
        for name in files:
            sync(Path(folder) / name)
        sync(Path(folder))
    if partial.is_file():
        sync(partial)
    partial.replace(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """Bring a file's content, or a folder's entries, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_stale(path: Path) -> bool:
    """Return whether `path` is a temporary name whose writer is dead.

    A process that reuses the id of a dead writer started after the file was last written.
    """
    match = _PARTIAL.match(path.name)
    if match is None:
        return False
    try:
        return path.stat().st_mtime < psutil.Process(int(match["pid"])).create_time() - 1.0
    except (psutil.NoSuchProcess, FileNotFoundError):
        return True
    except psutil.AccessDenied:
        return False


def remove_stale(path: Path) -> None:
    """Remove what killed writers of `path` left."""
    for left in path.parent.glob(f".{path.name}.*.partial"):
        if is_stale(left):
            remove(left)


def remove(path: Path) -> None:
    """Remove a file or a whole folder if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        with contextlib.suppress(NotADirectoryError):  # a part of the path is a file: nothing to remove
            path.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make a folder and its parents; raise UsageError where that is impossible."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {path}: {error}", remedy="choose another folder") from error
