"""Error messages for a full disk or missing permissions."""

from __future__ import annotations

import errno
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from minidual.errors import EnvironmentMissingError

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)
_ELSEWHERE = "point --runs-dir or MINIDUAL_RUNS at"


@contextmanager
def disk_errors(folder: Path) -> Generator[None]:
    """Turn OSError for a full disk or a missing permission into EnvironmentMissingError."""
    try:
        yield
    except OSError as error:
        what = error.filename or folder
        # HDF5 and Arrow errors carry the system's text but not always its errno.
        if error.errno in _FULL or "No space left on device" in str(error):
            raise EnvironmentMissingError(
                f"no space left on the disk of {folder} (writing {what})",
                remedy=f"free some space, or {_ELSEWHERE} another disk, then run the command again",
            ) from error
        if error.errno in _FORBIDDEN:
            raise EnvironmentMissingError(
                f"no permission for {what}: {error.strerror}",
                remedy=f"change its permissions, or {_ELSEWHERE} a folder you may write",
            ) from error
        raise
