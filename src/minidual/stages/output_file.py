"""Output files of a tool."""

import os
from pathlib import Path

from minidual.errors import UsageError


def target_file(option: str, text: str | None, ending: str) -> Path | None:
    """Return the file named by an option, or None without one.

    Args:
        option: Without the dashes, for messages.
        text: As typed, or None.
        ending: The ending that it must have, such as ".mp4".

    Raises:
        UsageError: It has another ending, or cannot be written.
    """
    if text is None:
        return None
    path = Path(text)
    if path.suffix != ending:
        raise UsageError(f"--{option} {path} must end in {ending}")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise UsageError(f"there is no folder {path.parent}", remedy="make it first")
    if path.is_dir():
        raise UsageError(f"--{option} {path} is a folder", remedy="name a file")
    written = path if path.exists() else folder
    if not os.access(written, os.W_OK):
        raise UsageError(
            f"--{option} {path} cannot be written: no permission",
            remedy="name another file",
        )
    return path
