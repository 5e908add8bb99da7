"""Errors of the disk."""

from __future__ import annotations

import errno
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from minidual.errors import EnvironmentMissingError

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


@contextmanager
def disk_errors(folder: Path) -> Generator[None]:
    """Turn an OSError of a full disk or missing permission into EnvironmentMissingError."""
    try:
        yield
    except OSError as error:
        what = error.filename or folder
        # HDF5 and Arrow errors carry the system's text but not always its errno.
        if error.errno in _FULL or "No space left on device" in str(error):
            message, remedy = f"no space left on the disk of {folder} (writing {what})", "free some space"
        elif error.errno in _FORBIDDEN:
            message, remedy = f"no permission for {what}: {error.strerror}", "change its permissions"
        else:
            raise
        remedy += ", or point --runs-dir or MINIDUAL_RUNS at another disk or folder, then run the command again"
        raise EnvironmentMissingError(message, remedy=remedy) from error
