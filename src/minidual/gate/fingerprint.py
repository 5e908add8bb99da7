"""What a verdict depends on, and what differs now."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, cast

import minidual
from minidual.gate.canonical import canonical
from minidual.gate.code import Code

UNSEEN = "(absent)"
_FULL_HASH = re.compile(r"^([0-9a-f]{10})[0-9a-f]+")


@dataclass(frozen=True)
class Fingerprint:
    """What a verdict depends on.

    A difference in the last five fields, the circumstances, only warns.

    Attributes:
        inputs: sha256 of input artefacts by "stage/path".
        upstream: sha256 of every upstream verdict; None if missing.
    """

    parameters: dict[str, Any]
    options: dict[str, Any]
    inputs: dict[str, str]
    upstream: dict[str, str | None]
    seed: int
    profile: str
    version: str
    commit: str | None
    machine: dict[str, Any]
    libraries: dict[str, str]
    code: Code = field(default_factory=Code)

    def choices(self, now: Fingerprint) -> list[str]:
        """Return differences of parameters, options, seed and profile."""
        typed = {"parameter": self.parameters, "option": self.options}
        current = {"parameter": canonical(now.parameters), "option": canonical(now.options)}
        reasons = [f"{n.replace('.', ' ', 1)} was {_short(a)}, is {_short(b)}" for n, a, b in changes(typed, current)]
        both = (("seed", self.seed, now.seed), ("profile", self.profile, now.profile))
        return reasons + [f"the {name} was {a!r}, is {b!r}" for name, a, b in both if a != b]

    def differences(self, now: Fingerprint) -> list[str]:
        """Return why a verdict with this fingerprint is stale."""
        reasons = self.choices(now)
        for name, then, _ in changes(self.inputs, now.inputs):
            reasons.append(f"input {name} {'is new' if then == UNSEEN else 'changed or is gone'}")
        for name, then, current in changes(self.upstream, now.upstream):
            if current is None:
                reasons.append(f"the verdict of upstream stage {name} is gone")
            else:
                reasons.append(f"upstream stage {name} {'has run' if then is None else 'ran again'} since")
        return reasons

    def circumstances(self, now: Fingerprint) -> list[str]:
        """Return a warning per changed circumstance."""
        warnings: list[str] = []
        if self.version != now.version:
            warnings.append(f"made by minidual {self.version}, this is {now.version}")
        if self.commit != now.commit:
            then, current = (_FULL_HASH.sub(r"\1", commit or "none") for commit in (self.commit, now.commit))
            warnings.append(f"made at commit {then}, this is {current}")
        before = {"machine": self.machine, "library": self.libraries}
        after = {"machine": now.machine, "library": now.libraries}
        warnings += [f"{n.replace('.', ' ', 1)}: was {_short(a)}, is {_short(b)}" for n, a, b in changes(before, after)]
        changed = self.code.changes(now.code)
        if changed:
            more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
            warnings.append(f"made by other code: {', '.join(changed[:3])}{more} changed since")
        return warnings


def changes(before: Mapping[str, Any], after: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any, Any]]:
    """Yield (dotted name, before, after) for each differing leaf."""
    for key in [*before, *(key for key in after if key not in before)]:
        then, current = before.get(key, UNSEEN), after.get(key, UNSEEN)
        if isinstance(then, dict) and isinstance(current, dict):
            yield from changes(cast(dict[str, Any], then), cast(dict[str, Any], current), f"{prefix}{key}.")
        elif then != current or isinstance(then, bool) is not isinstance(current, bool):
            yield f"{prefix}{key}", then, current


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


@cache
def circumstances_now(libraries: tuple[str, ...]) -> dict[str, Any]:
    """Return version, commit, machine and versions of distributions."""
    return {
        "version": minidual.__version__,
        "commit": _commit(),
        "machine": {
            "system": platform.system(),
            "architecture": platform.machine(),
            "processor": _processor(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
        },
        "libraries": {name: installed_version(name) or "not installed" for name in libraries},
    }


def installed_version(name: str) -> str | None:
    """Return the version of a distribution, or None."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    package = Path(minidual.__file__).parent

    def git(*words: str) -> str:
        command = ["git", "-C", str(package), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        # An installed wheel may lie inside somebody else's repository: check that git tracks this file.
        git("ls-files", "--error-unmatch", "__init__.py")
        commit = git("rev-parse", "HEAD")
        return f"{commit}+changes" if git("status", "--porcelain", "--", ".") else commit
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()
