"""Libraries and machine, without importing libraries."""

import importlib.metadata
import os
import platform
from dataclasses import asdict, dataclass
from typing import Any

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from minidual.errors import DataError, EnvironmentMissingError
from minidual.gate.circumstances import circumstances_now, installed_version
from minidual.gate.stage import ToolContext, ToolResult, markdown
from minidual.gate.verdict import Verdict, read_verdict


@dataclass(frozen=True)
class Library:
    """A required distribution.

    Attributes:
        wanted: Version range, e.g. `>=4.0.0,<4.1`; empty for any.
        installed: Version, or None.
    """

    name: str
    wanted: str
    installed: str | None

    @property
    def fits(self) -> bool:
        """Whether the installed version is supported."""
        if self.installed is None:
            return False
        return SpecifierSet(self.wanted).contains(self.installed, prereleases=True)


def required_libraries() -> list[Library]:
    """Return the requirements of minidual without extras, and installed versions.

    Raises:
        importlib.metadata.PackageNotFoundError: minidual is not installed.
    """
    requirements = [Requirement(text) for text in importlib.metadata.requires("minidual") or []]
    libraries = [
        Library(r.name, str(r.specifier), installed_version(r.name))
        for r in requirements
        if "extra" not in str(r.marker or "")
    ]
    return sorted(libraries, key=lambda library: library.name)


def print_bill(context: ToolContext) -> ToolResult:
    """Return versions, renderer and last verdict for a bug report; no paths or personal names."""
    machine = _machine()
    libraries = required_libraries()
    verdict = _last_verdict(context)
    machine_rows = [{"what": k.replace("_", " "), "value": v} for k, v in machine.items()]
    library_rows = [
        {**asdict(library), "state": "fits" if library.fits else "**unfit**"}
        for library in libraries
    ]
    lines = [
        "### minidual environment",
        "",
        *markdown(machine_rows),
        "",
        *markdown(library_rows),
        "",
        *_verdict_lines(verdict),
    ]
    data = {
        "about": machine,
        "libraries": [asdict(library) for library in libraries],
        "env_check": None if verdict is None else verdict.status,
    }
    return ToolResult(lines=lines, data=data)


def _machine() -> dict[str, Any]:
    circumstances = circumstances_now(())
    return {
        "minidual": circumstances.version,
        "commit": circumstances.commit or "none (installed package)",
        **circumstances.machine,
        "platform": platform.platform(),
        "mujoco_gl": os.environ.get("MUJOCO_GL", ""),
        "gl_renderer": _renderer(),
    }


def _renderer() -> str:
    """Return the renderer, or why there is none: a broken installation still has its bill."""
    try:
        from minidual.stages.env_check.pictures import renderer_name

        return renderer_name()
    except (EnvironmentMissingError, ImportError) as error:
        return f"none: {error}"


def _last_verdict(context: ToolContext) -> Verdict | None:
    try:
        verdict, _ = read_verdict(context.run_folder / "env-check" / "verdict.json")
    except DataError:
        return None
    return verdict


def _verdict_lines(verdict: Verdict | None) -> list[str]:
    if verdict is None:
        return ["env-check has not run here."]
    status = (
        f"env-check: **{verdict.status}** on {verdict.finished_at}, "
        f"profile {verdict.fingerprint.profile}"
    )
    return [status, *(f"- {check.sentence()}" for check in verdict.failed_checks())]
