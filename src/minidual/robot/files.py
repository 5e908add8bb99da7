"""Where robot descriptions and their meshes lie.

An address is an absolute path, file:// with an absolute path, or package://NAME/path. NAME is a
folder that the user names (`robot.packages`), else an installed distribution.
"""

import functools
import importlib.metadata
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from minidual.errors import EnvironmentMissingError, UsageError

Packages = tuple[tuple[str, str], ...]
"""(name, folder) of each package that the user names."""

_PACKAGE = "package://"
_FILE = "file://"
_PREFIX = "cmeel.prefix/share"
"""Data folder of cmeel wheels."""
_LOCKED = "example-robot-data"
"""Distribution of the built-in arms; requirements.lock installs it."""


def packages_of(folders: Mapping[str, str]) -> Packages:
    """Return the folders of packages, hashable."""
    return tuple(sorted(folders.items()))


@functools.cache
def file_at(address: str, packages: Packages = ()) -> Path:
    """Return the file at an address.

    Raises:
        UsageError: There is no such package or file.
        EnvironmentMissingError: The distribution of the built-in arms is missing or incomplete.
    """
    return _existing(_path(address, packages), address)


def mesh_at(address: str, folder: Path, packages: Packages = ()) -> Path:
    """Return the file of a mesh; a relative address counts from the URDF's `folder`.

    Raises:
        UsageError: As `file_at`.
        EnvironmentMissingError: As `file_at`.
    """
    is_relative = "://" not in address and not Path(address).is_absolute()
    if is_relative:
        return _existing((folder / address).resolve(), address)
    return file_at(address, packages)


def _path(address: str, packages: Packages) -> Path:
    """Return the path of an absolute address; the file may be missing."""
    if address.startswith(_PACKAGE):
        return _in_package(address, packages)
    if address.startswith(_FILE):
        local = address.removeprefix(_FILE).removeprefix("localhost")
        return _absolute(Path(unquote(local)), address)
    if "://" in address:
        scheme = address.partition("://")[0]
        raise UsageError(
            f"'{address}': no files are read from {scheme}://; there are {_PACKAGE}, {_FILE} and "
            "absolute paths",
        )
    return _absolute(Path(address), address)


def _absolute(path: Path, address: str) -> Path:
    if not path.is_absolute():
        raise UsageError(
            f"'{address}' is no absolute path",
            remedy=f"give an absolute path or {_PACKAGE}NAME/path",
        )
    return path


def _existing(path: Path, address: str) -> Path:
    if path.is_file():
        return path
    if address.startswith(f"{_PACKAGE}{_LOCKED}/"):
        raise EnvironmentMissingError(
            f"'{_LOCKED}' has no file {path}",
            remedy="pip install -r requirements.lock",
        )
    there = "" if str(path) == address else f" (address '{address}')"
    raise UsageError(f"there is no file {path}{there}", remedy=_nearest_folder(path))


def _nearest_folder(path: Path) -> str:
    """Say which part of a missing path exists."""
    folder = path.parent
    while not folder.is_dir():
        folder = folder.parent
    return f"correct the address: {folder} is the deepest of its folders that exists"


def _in_package(address: str, packages: Packages) -> Path:
    """Return the path of package://NAME/path."""
    location = address.removeprefix(_PACKAGE).lstrip("/")  # some descriptions write ///
    name, _, inner = location.partition("/")
    folders = dict(packages)
    if not name:
        raise UsageError(f"'{address}' names no package: write {_PACKAGE}NAME/path or {_FILE}/path")
    if name in folders:
        folder = Path(folders[name]).expanduser()
        if not folder.is_dir():
            raise UsageError(
                f"robot.packages.{name}: there is no folder {folder}",
                remedy=f"--set robot.packages.{name}=FOLDER, the one that holds {inner}",
            )
        return folder / inner
    try:
        distribution = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError as error:
        raise _unknown_package(name, inner, folders) from error
    path = Path(str(distribution.locate_file(f"{_PREFIX}/{location}"))).resolve()
    beside = Path(str(distribution.locate_file(location))).resolve()
    return beside if beside.is_file() else path


def _unknown_package(
    name: str,
    inner: str,
    folders: Mapping[str, str],
) -> UsageError | EnvironmentMissingError:
    if name == _LOCKED:
        return EnvironmentMissingError(
            f"the distribution '{name}' is not installed",
            remedy="pip install -r requirements.lock",
        )
    named = ", ".join(folders) or "none"
    return UsageError(
        f"nothing says where the package '{name}' of {_PACKAGE}{name}/{inner} lies; "
        f"robot.packages names {named}",
        remedy=f"--set robot.packages.{name}=FOLDER, the one that holds {inner}",
    )
