"""The libraries found, without importing any of them: for the environment check and for bug reports."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from dataclasses import dataclass

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


def machine() -> dict[str, str]:
    """Return the interpreter, operating system, processor and GL backend in words."""
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "cores": str(os.cpu_count()),
        "mujoco_gl": os.environ.get("MUJOCO_GL", ""),
    }
