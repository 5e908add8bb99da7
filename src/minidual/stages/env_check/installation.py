"""Libraries and machine, without importing libraries."""

import importlib.metadata
import os
import platform
from dataclasses import asdict, dataclass

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from minidual.errors import DataError, EnvironmentMissingError
from minidual.gate.circumstances import circumstances_now, installed_version
from minidual.gate.stage import ToolContext, ToolResult, markdown
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
        return self.found is not None and SpecifierSet(self.wanted).contains(
            self.found,
            prereleases=True,
        )


def required_libraries() -> list[Library]:
    """Return the requirements of minidual without extras, and installed versions.

    Raises:
        importlib.metadata.PackageNotFoundError: minidual is not installed.
    """
    wanted = map(Requirement, importlib.metadata.requires("minidual") or [])
    always = (r for r in wanted if "extra" not in str(r.marker or ""))
    libraries = [Library(r.name, str(r.specifier), installed_version(r.name)) for r in always]
    return sorted(libraries, key=lambda library: library.name)


def print_bill(context: ToolContext) -> ToolResult:
    """Return versions, renderer and last verdict for a bug report; no paths or personal names."""
    try:
        # A broken installation must still print its versions.
        from minidual.stages.env_check.pictures import renderer_name

        renderer = renderer_name()
    except (EnvironmentMissingError, ImportError) as error:
        renderer = f"none: {error}"
    now = circumstances_now(())
    about = {
        "minidual": now.version,
        "commit": now.commit or "none (installed package)",
        **now.machine,
    }
    about |= {
        "platform": platform.platform(),
        "mujoco_gl": os.environ.get("MUJOCO_GL", ""),
        "gl_renderer": renderer,
    }
    libraries = required_libraries()
    verdict = None
    lines = ["### minidual environment", ""]
    lines += [*markdown([{"what": k.replace("_", " "), "value": v} for k, v in about.items()]), ""]
    lines += markdown(
        [
            {**asdict(library), "state": "fits" if library.fits else "**unfit**"}
            for library in libraries
        ],
    )
    try:
        verdict, _ = read_verdict(context.run_folder / "env-check" / "verdict.json")
        status = f"env-check: **{verdict.status}** on {verdict.finished_at}, profile {verdict.fingerprint.profile}"
        lines += ["", status, *(f"- {check.sentence()}" for check in verdict.failed_checks())]
    except DataError:
        lines += ["", "env-check has not run here."]
    data = {"about": about, "libraries": [asdict(library) for library in libraries]}
    return ToolResult(lines=lines, data={**data, "env_check": verdict.status if verdict else None})
