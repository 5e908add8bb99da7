"""Files that survive: atomic writes, bounded reads, errors of the disk.

Files and folders get a temporary name with the process id, are synced (fsync) and renamed.
"""

import contextlib
import csv
import errno
import io
import json
import os
import re
import shutil
import stat
from collections.abc import Generator, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from minidual.errors import (
    DataError,
    EnvironmentMissingError,
    MinidualError,
    NothingEvaluatedError,
    UsageError,
)

JSON_BYTES_MAX = 2**24
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)
_KINDS = {"d": "folder", "-": "file", "p": "FIFO", "s": "socket", "c": "device", "b": "device"}
_PARTIAL = re.compile(r"^\..+\.(?P<pid>\d+)\.partial$")


def partial_path(path: Path) -> Path:
    """Return this process's temporary name for `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


@contextlib.contextmanager
def replacing(path: Path) -> Generator[Path]:
    """Yield a temporary path; publish it at `path` unless the block raises."""
    partial = partial_path(path)
    try:
        yield partial
        publish(partial, path)
    finally:
        remove(partial)


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) atomically."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_csv(path: Path, rows: Sequence[Mapping[str, object]], *, missing: str = "") -> Path:
    """Write a table atomically; `missing` fills absent values.

    Raises:
        NothingEvaluatedError: No rows.
    """
    if not rows:
        raise NothingEvaluatedError(f"no rows for {path}: nothing was evaluated")
    text = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, fieldnames=names, restval=missing, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    make_folder(path.parent)
    write_text(path, text.getvalue())
    return path


def publish(partial: Path, path: Path) -> None:
    """Sync a file or folder and rename it to `path`, which must be free for a folder."""
    for part in (*partial.rglob("*"), partial):
        sync(part)
    partial.replace(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """Sync a file's content or a folder's entries."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_stale(path: Path) -> bool:
    """Return whether `path` is a temporary name whose writer is dead.

    A living process with its id is another one if it started after the last write.
    """
    if (match := _PARTIAL.match(path.name)) is None:
        return False
    import psutil  # 40 ms that a plan does not need

    try:
        return path.stat().st_mtime < psutil.Process(int(match["pid"])).create_time() - 1.0
    except (psutil.NoSuchProcess, FileNotFoundError):
        return True
    except psutil.AccessDenied:
        return False


def remove_stale(paths: Iterable[Path]) -> list[Path]:
    """Remove the stale ones; return them."""
    stale = [path for path in paths if is_stale(path)]
    for path in stale:
        remove(path)
    return stale


def remove(path: Path) -> None:
    """Remove a file or folder if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):  # to unlink what is not there fails on a read-only disk
        path.unlink(missing_ok=True)


def now_text(form: str = "%Y-%m-%dT%H:%M:%SZ") -> str:
    """Return the UTC time, by default in ISO 8601, to the second."""
    return datetime.now(UTC).strftime(form)


def set_aside(path: Path, name: str) -> Path:
    """Move `path` into the folder `set-aside` beside it, as `name` and the UTC time; return the new path."""
    place = path.parent / "set-aside" / f"{name}-{now_text('%Y%m%d-%H%M%S-%f')}"
    make_folder(place.parent)
    path.rename(place)
    return place


def make_folder(path: Path) -> None:
    """Make a folder and its parents, or raise UsageError (EnvironmentMissingError if the disk refuses)."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refused = UsageError(
            f"cannot make the folder {path}: {error}",
            remedy="choose another folder",
        )
        raise disk_error(error, path) or refused from error


def unwritten(error: Exception, path: Path, remedy: str) -> MinidualError:
    """Return the error of what could not be written at `path`: that of the disk, or DataError with `remedy`."""
    return disk_error(error, path) or DataError(
        f"{path} could not be written: {error}",
        remedy=remedy,
    )


def disk_error(error: BaseException, path: Path) -> EnvironmentMissingError | None:
    """Return the error of a full disk or missing permission at `path`, or None if `error` is another."""
    code = getattr(error, "errno", None)
    what = getattr(error, "filename", None) or path
    # Errors of HDF5, Arrow and safetensors carry the system's text but not always its number.
    code = next((full for full in _FULL if os.strerror(full) in str(error)), code)
    if code in _FULL:
        message = f"no space left on the disk of {path} (writing {what}: {os.strerror(code)})"
        remedy = "free some space"
    elif code in _FORBIDDEN:
        message = f"no permission for {what}: {os.strerror(code)}"
        remedy = "change its permissions"
    else:
        return None
    remedy += ", or point --runs-dir or MINIDUAL_RUNS at another disk or folder, then run the command again"
    return EnvironmentMissingError(message, remedy=remedy)


@contextlib.contextmanager
def disk_errors(folder: Path) -> Generator[None]:
    """Turn the error of a full disk or missing permission into EnvironmentMissingError."""
    try:
        yield
    except Exception as error:
        if isinstance(error, MinidualError) or (found := disk_error(error, folder)) is None:
            raise
        raise found from error


def expanded(text: str) -> Path:
    """Return the path with the home folder for "~", which stays where none is known."""
    return Path(os.path.expanduser(text))  # noqa: PTH111 - Path.expanduser raises RuntimeError


def kind_of(path: Path) -> str:
    """Return "file", "folder", "FIFO", "socket", "device" or "broken link" behind links; "" if nothing is there.

    Raises:
        DataError: No permission, a loop of links, or a name that is too long.
    """
    try:
        return _KINDS[stat.filemode(path.stat().st_mode)[0]]
    except (FileNotFoundError, NotADirectoryError):
        return "broken link" if path.is_symlink() else ""
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}") from error


def require(path: Path, kind: str) -> None:
    """Raise DataError unless nothing or a readable `kind` ("file", "folder") is at `path`."""
    found = kind_of(path)
    if found not in ("", kind):
        raise DataError(
            f"{path} is a {found}; minidual keeps a {kind} there",
            remedy="move it away or delete it",
        )
    if found and not os.access(path, os.R_OK | (os.X_OK if kind == "folder" else 0)):
        raise DataError(f"no permission to read {path}", remedy="change its permissions")


def regular_file(path: Path, bytes_max: int) -> Path:
    """Return `path`; DataError unless it is a regular file of at most `bytes_max`."""
    if (kind := kind_of(path)) != "file":
        raise DataError(f"{path} {f'is a {kind}, not a file' if kind else 'does not exist'}")
    if (size := path.stat().st_size) > bytes_max:
        raise DataError(f"{path} holds {size:,} bytes; at most {bytes_max:,} are read")
    return path


@contextlib.contextmanager
def reading(what: Path | str, remedy: str) -> Generator[None]:
    """Turn an error of damaged content into DataError."""
    try:
        yield
    except MinidualError as error:
        if isinstance(error, DataError):
            error.remedy = error.remedy or remedy
        raise
    except Exception as error:  # libraries raise anything over it
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise DataError(
            f"{what} is missing, cut or corrupt, and cannot be read: {said:.300}",
            remedy=remedy,
        ) from error


def read_json(path: Path, bytes_max: int = JSON_BYTES_MAX) -> Any:
    """Parse a JSON file; DataError if it is none, or no regular file of at most `bytes_max`."""
    try:
        return json.loads(regular_file(path, bytes_max).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is not JSON: {error}") from error
