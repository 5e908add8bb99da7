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
    match = _PARTIAL.match(path.name)
    if match is None:
        return False
    import psutil  # takes 40 ms, which a plan does not need

    try:
        written_at = path.stat().st_mtime
        started_at = psutil.Process(int(match["pid"])).create_time()
        return written_at < started_at - 1.0
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
    elif os.path.lexists(path):  # on a read-only disk, unlinking a missing file fails
        path.unlink(missing_ok=True)


def now_text(form: str = "%Y-%m-%dT%H:%M:%SZ") -> str:
    """Return the UTC time, by default in ISO 8601, to the second."""
    return datetime.now(UTC).strftime(form)


def set_aside(path: Path, name: str) -> Path:
    """Move `path` into the folder `set-aside` beside it; return its new path.

    It is called `name` and the UTC time there.
    """
    target = path.parent / "set-aside" / f"{name}-{now_text('%Y%m%d-%H%M%S-%f')}"
    make_folder(target.parent)
    path.rename(target)
    return target


def make_folder(path: Path) -> None:
    """Make a folder and its parents.

    Raises:
        EnvironmentMissingError: The disk is full or refuses.
        UsageError: It cannot be made for another reason.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refusal = disk_error(error, path)
        if refusal is not None:
            raise refusal from error
        raise UsageError(
            f"cannot make the folder {path}: {error}",
            remedy="choose another folder",
        ) from error


def unwritten(error: Exception, path: Path, remedy: str) -> MinidualError:
    """Return the error for a file that could not be written at `path`.

    It is that of the disk, or DataError with `remedy`.
    """
    refusal = disk_error(error, path)
    if refusal is not None:
        return refusal
    return DataError(f"{path} could not be written: {error}", remedy=remedy)


def disk_error(error: BaseException, path: Path) -> EnvironmentMissingError | None:
    """Return the error of a full disk or missing permission at `path`; None for another error."""
    code = _system_code(error)
    written = getattr(error, "filename", None) or path
    if code in _FULL:
        message = f"no space left on the disk of {path} (writing {written}: {os.strerror(code)})"
        remedy = "free some space"
    elif code in _FORBIDDEN:
        message = f"no permission for {written}: {os.strerror(code)}"
        remedy = "change its permissions"
    else:
        return None
    return EnvironmentMissingError(
        message,
        remedy=f"{remedy}, or point --runs-dir or MINIDUAL_RUNS at another disk or folder, "
        "then run the command again",
    )


def _system_code(error: BaseException) -> int | None:
    """Return the number of the operating system's error behind `error`, or None."""
    # Errors of HDF5, Arrow and safetensors carry the system's text but not always its number.
    for full in _FULL:
        if os.strerror(full) in str(error):
            return full
    return getattr(error, "errno", None)


@contextlib.contextmanager
def disk_errors(folder: Path) -> Generator[None]:
    """Turn the error of a full disk or missing permission into EnvironmentMissingError."""
    try:
        yield
    except MinidualError:
        raise
    except Exception as error:
        refusal = disk_error(error, folder)
        if refusal is None:
            raise
        raise refusal from error


def expanded(text: str) -> Path:
    """Return the path with the home folder for "~", which stays where none is known."""
    return Path(os.path.expanduser(text))  # noqa: PTH111 - Path.expanduser raises RuntimeError


def kind_of(path: Path) -> str:
    """Return the file status at a path, behind links.

    Returns:
        "file", "folder", "FIFO", "socket", "device", "broken link", or "" if nothing is there.

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
    present = kind_of(path)
    if not present:
        return
    if present != kind:
        raise DataError(
            f"{path} is a {present}; minidual keeps a {kind} there",
            remedy="move it away or delete it",
        )
    permissions = os.R_OK | os.X_OK if kind == "folder" else os.R_OK
    if not os.access(path, permissions):
        raise DataError(f"no permission to read {path}", remedy="change its permissions")


def regular_file(path: Path, bytes_max: int) -> Path:
    """Return `path`; DataError unless it is a regular file of at most `bytes_max`."""
    kind = kind_of(path)
    if not kind:
        raise DataError(f"{path} does not exist")
    if kind != "file":
        raise DataError(f"{path} is a {kind}, not a file")
    size = path.stat().st_size
    if size > bytes_max:
        raise DataError(f"{path} holds {size:,} bytes; at most {bytes_max:,} are read")
    return path


@contextlib.contextmanager
def reading(source: Path | str, remedy: str) -> Generator[None]:
    """Turn an error of damaged content into DataError."""
    try:
        yield
    except MinidualError as error:
        if isinstance(error, DataError):
            error.remedy = error.remedy or remedy
        raise
    except Exception as error:  # libraries raise anything over it
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise DataError(
            f"{source} is missing, cut or corrupt, and cannot be read: {reason:.300}",
            remedy=remedy,
        ) from error


def read_json(path: Path, bytes_max: int = JSON_BYTES_MAX) -> Any:
    """Parse a JSON file.

    Raises:
        DataError: It is none, or no regular file of at most `bytes_max`.
    """
    try:
        return json.loads(regular_file(path, bytes_max).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is not JSON: {error}") from error
