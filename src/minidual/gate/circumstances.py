"""The circumstances of a verdict: version, commit, machine and libraries."""

import os
import platform
import re
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import minidual

_GIT_TIMEOUT_S = 10.0


class Circumstances(NamedTuple):
    """The circumstances of a verdict.

    Attributes:
        commit: Of the checkout, with "+changes" if files differ from it; None outside a checkout.
        libraries: {distribution: version or "not installed"}.
    """

    version: str
    commit: str | None
    machine: dict[str, Any]
    libraries: dict[str, str]


@cache
def circumstances_now(libraries: tuple[str, ...]) -> Circumstances:
    """Return the circumstances of this process, with the versions of some distributions."""
    machine: dict[str, Any] = {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }
    versions = {name: installed_version(name) or "not installed" for name in libraries}
    return Circumstances(minidual.__version__, _commit(), machine, versions)


def installed_version(name: str) -> str | None:
    """Return the version of a distribution, or None."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    try:
        # An installed wheel may lie inside another project's repository: git must track this file.
        _git("ls-files", "--error-unmatch", "__init__.py")
        commit = _git("rev-parse", "HEAD")
        changed = _git("status", "--porcelain", "--", ".")
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}+changes" if changed else commit


def _git(*words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(Path(minidual.__file__).parent), *words],
        capture_output=True,
        text=True,
        check=True,
        timeout=_GIT_TIMEOUT_S,
    )
    return done.stdout.strip()


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor()
    match = re.search("^model name.*?:(.*)", text, re.MULTILINE)
    return platform.processor() if match is None else match[1].strip()
