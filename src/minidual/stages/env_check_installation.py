"""The libraries found, without importing any of them: for the environment check and for bug reports."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_DISTRIBUTION = "minidual"


@dataclass(frozen=True)
class Library:
    """One distribution that the toolkit requires.

    Attributes:
        name: As on the package index.
        wanted: Version range, e.g. `>=4.0.0,<4.1`; empty if any will do.
        found: Installed version, None if it is not installed.
    """

    name: str
    wanted: str
    found: str | None

    @property
    def fits(self) -> bool:
        """Whether it is installed in a version that the toolkit works with."""
        from packaging.specifiers import SpecifierSet

        return self.found is not None and SpecifierSet(self.wanted).contains(self.found, prereleases=True)


def required_libraries(distribution: str = _DISTRIBUTION) -> list[Library]:
    """Return what the installed distribution requires, with the versions found; extras are left out.

    Raises:
        importlib.metadata.PackageNotFoundError: The distribution itself is not installed.
    """
    libraries = []
    for line in importlib.metadata.requires(distribution) or []:
        requirement, _, marker = line.partition(";")
        match = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^\]]*\])?\s*\(?([^)]*)\)?", requirement)
        if match is None or "extra" in marker:
            continue
        name, wanted = match.group(1), match.group(2).strip()
        try:
            found = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found = None
        libraries.append(Library(name, wanted, found))
    return sorted(libraries, key=lambda library: library.name)


@dataclass(frozen=True)
class Package:
    """A Debian package that drawing without a screen needs.

    Attributes:
        name: As for apt-get.
        version: Installed version, None if it is not installed.
    """

    name: str
    version: str | None


def system_packages(names: Sequence[str] = ("libegl1", "libgl1-mesa-dri")) -> list[Package]:
    """Return which of the Debian packages are installed; an empty list where there is no dpkg to ask."""
    query = shutil.which("dpkg-query")
    if query is None:
        return []
    packages = []
    for name in names:
        done = subprocess.run(
            [query, "--show", "--showformat=${db:Status-Status} ${Version}", name],
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )
        status, _, version = done.stdout.partition(" ")
        packages.append(Package(name, version if done.returncode == 0 and status == "installed" else None))
    return packages


def system_name() -> str:
    """Return the name of the distribution."""
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", "")
    except OSError:
        return ""


def processor() -> str:
    """Return the processor's name."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def machine() -> dict[str, str]:
    """Return the interpreter, operating system, processor and GL backend in words."""
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "mujoco_gl": os.environ.get("MUJOCO_GL", ""),
    }
