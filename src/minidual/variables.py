"""Environment variables that libraries read, and their required values.

`import minidual` calls `prepare` before any library is imported. Worker processes inherit what it
sets.
"""

import os
import pwd
import stat
from pathlib import Path

RENDERING_PACKAGES = ("libegl1", "libgl1-mesa-dri", "libopengl0")
"""Debian packages that rendering without a screen needs; PyOpenGL looks for the last one."""
INSTALL_RENDERING = f"apt-get install -y {' '.join(RENDERING_PACKAGES)}"

_DEVICE = "MUJOCO_EGL_DEVICE_ID"
_USER_NAMES = ("LOGNAME", "USER", "LNAME", "USERNAME")
"""Where `getpass.getuser` looks before it asks for the entry of the user."""


def prepare() -> None:
    """Set the variables that the libraries of minidual read at their import."""
    # mujoco and PyOpenGL pick their platform at their first import; with another one it may fail.
    os.environ["MUJOCO_GL"] = "egl"
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    if _user_name() is not None:
        return
    if not any(os.environ.get(name) for name in _USER_NAMES):
        # PyTorch asks for the user's name at its import, and ends with KeyError.
        os.environ["LOGNAME"] = f"uid-{os.getuid()}"
    home = os.environ.get("HOME")
    if home is None or not os.access(home, os.W_OK):
        # Libraries would write to a folder named "~", or end with an error. Docker says "/".
        folder = private_folder()
        if folder is not None:
            os.environ["HOME"] = str(folder)


def _user_name() -> str | None:
    """Return the name of this user in the password database, or None in some containers."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return None


def private_folder() -> Path | None:
    """Return a folder for temporary files that only this user can write, or None.

    What lies there may be compiled code: a folder or link of somebody else is not used.
    """
    import tempfile  # late: every command imports this module

    try:
        folder = Path(tempfile.gettempdir()) / f"minidual-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    is_own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    is_closed = not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if is_own and is_closed and is_writable(folder) else None


def is_writable(folder: Path) -> bool:
    """Return whether a file can be made in a folder, which is made if it is absent."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def rendering_remedy(reason: str) -> str:
    """Return the remedy for an OpenGL context that cannot be made; `reason` is its error."""
    device = os.environ.get(_DEVICE)
    if device is None:
        return INSTALL_RENDERING
    if _DEVICE in reason or not device.strip().isdigit():
        return f"unset {_DEVICE}, which is '{device}': no rendering device has that number"
    return f"unset {_DEVICE}, which is '{device}'; if that does not help, {INSTALL_RENDERING}"
