"""Libraries, system packages and machine, without importing libraries."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from minidual.errors import DataError, EnvironmentMissingError
from minidual.gate.fingerprint import circumstances_now
from minidual.gate.tool import ToolContext, ToolResult
from minidual.gate.verdict import read_verdict


@dataclass(frozen=True)
class Library:
    """A required distribution.

    Attributes:
        wanted: Version range, e.g. `>=4.0.0,<4.1`; empty for any.
        found: Installed version, or None.
    """

    name: str
    wanted: str
    found: str | None

    @property
    def fits(self) -> bool:
        """Whether the installed version is supported."""
        return self.found is not None and SpecifierSet(self.wanted).contains(self.found, prereleases=True)


@dataclass(frozen=True)
class Package:
    """A Debian package for off-screen rendering; `version` is None if missing."""

    name: str
    version: str | None


def required_libraries(distribution: str = "minidual") -> list[Library]:
    """Return requirements of `distribution` without extras, and installed versions.

    Raises:
        importlib.metadata.PackageNotFoundError: The distribution is not installed.
    """
    libraries = []
    for requirement in map(Requirement, importlib.metadata.requires(distribution) or []):
        if "extra" in str(requirement.marker or ""):
            continue
        try:
            found = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            found = None
        libraries.append(Library(requirement.name, str(requirement.specifier), found))
    return sorted(libraries, key=lambda library: library.name)


def system_packages(names: Sequence[str] = ("libegl1", "libgl1-mesa-dri")) -> list[Package]:
    """Return the Debian packages' versions; empty without dpkg."""
    query = shutil.which("dpkg-query")
    if query is None:
        return []
    packages = []
    for name in names:
        words = [query, "--show", "--showformat=${db:Status-Status} ${Version}", name]
        done = subprocess.run(words, capture_output=True, text=True, timeout=20, check=False)
        status, _, version = done.stdout.partition(" ")
        packages.append(Package(name, version if done.returncode == 0 and status == "installed" else None))
    return packages


def machine() -> dict[str, str]:
    """Return interpreter, system, processor and GL backend."""
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "mujoco_gl": os.environ.get("MUJOCO_GL", ""),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _system_name() -> str:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", "")
    except OSError:
        return ""


def print_bill(context: ToolContext) -> ToolResult:
    """Return versions, renderer and last verdict for a bug report; no paths or personal names."""
    try:
        # A broken installation must still print its versions.
        from minidual.stages.env_check.pictures import renderer_name

        renderer = renderer_name()
    except EnvironmentMissingError as error:
        renderer = f"none: {error.message}"
    except ImportError as error:
        renderer = f"none: {error}"
    now = circumstances_now(())
    about = {
        "minidual": now["version"],
        "commit": now["commit"] or "none (installed package)",
        **machine(),
        "distribution": _system_name(),
        "memory": f"{psutil.virtual_memory().total / 2**30:.1f} GiB",
        "gl_renderer": renderer,
    }
    libraries, packages, verdict = required_libraries(), system_packages(), _last_verdict(context)
    document = {
        "about": about,
        "libraries": {lib.name: {"wanted": lib.wanted, "found": lib.found, "fits": lib.fits} for lib in libraries},
        "packages": {package.name: package.version for package in packages},
        "env_check": verdict,
    }
    return ToolResult(lines=markdown(about, libraries, packages, verdict), data=document)


def _last_verdict(context: ToolContext) -> dict[str, Any] | None:
    path = context.run_folder / "env-check" / "verdict.json"
    try:
        verdict = read_verdict(path)[0] if path.is_file() else None
    except DataError:
        return None
    if verdict is None:
        return None
    failed = [check.sentence() for check in verdict.failed_checks()]
    return {"status": verdict.status, "finished_at": verdict.finished_at, "profile": verdict.profile, "failed": failed}


def markdown(
    about: Mapping[str, str],
    libraries: Sequence[Library],
    packages: Sequence[Package],
    env_check: Mapping[str, Any] | None,
) -> list[str]:
    """Return the report as Markdown lines."""
    lines = ["### minidual environment", "", "| | |", "|---|---|"]
    lines += [f"| {name.replace('_', ' ')} | {_cell(value)} |" for name, value in about.items() if value]
    lines += ["", "| library | wanted | found | |", "|---|---|---|---|"]
    for lib in libraries:
        unfit = "" if lib.fits else "**unfit**"
        lines.append(f"| {lib.name} | {_cell(lib.wanted or 'any')} | {lib.found or 'none'} | {unfit} |")
    if packages:
        lines += ["", "| Debian package | found |", "|---|---|"]
        lines += [f"| {package.name} | {package.version or '**none**'} |" for package in packages]
    if env_check is None:
        return [*lines, "", "env-check has not run here."]
    status = f"env-check: **{env_check['status']}** on {env_check['finished_at']}, profile {env_check['profile']}"
    return [*lines, "", status, *(f"- {sentence}" for sentence in env_check["failed"])]


def _cell(text: object) -> str:
    return str(text).replace("|", "\\|").replace("\n", " ")
