"""`minidual env-check --markdown`: a bill of versions to paste into a bug report. No paths, no names of people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from minidual.errors import EnvironmentMissingError
from minidual.gate.tool import ToolContext, ToolResult

if TYPE_CHECKING:
    from minidual.gate.verdict import Verdict
    from minidual.stages.env_check_installation import Library, Package

_GIB = 2**30


def print_bill(context: ToolContext) -> ToolResult:
    """Collect versions, draw one picture to learn the renderer, and look at the last verdict of env-check."""
    import psutil

    from minidual.gate.fingerprint import circumstances_now
    from minidual.stages.env_check_environment_pictures import renderer_name
    from minidual.stages.env_check_installation import machine, required_libraries, system_name, system_packages

    try:
        renderer = renderer_name()
    except EnvironmentMissingError as error:
        renderer = f"none: {error.message}"
    now = circumstances_now(())
    about = {
        "minidual": now["version"],
        "commit": now["commit"] or "none (installed package)",
        **machine(),
        "distribution": system_name(),
        "memory": f"{psutil.virtual_memory().total / _GIB:.1f} GiB",
        "gl_renderer": renderer,
    }
    libraries, packages = required_libraries(), system_packages()
    verdict = _last_verdict(context)
    document = {
        "about": about,
        "libraries": {lib.name: {"wanted": lib.wanted, "found": lib.found, "fits": lib.fits} for lib in libraries},
        "packages": {package.name: package.version for package in packages},
        "env_check": None if verdict is None else _summary(verdict),
    }
    lines = markdown(about, libraries, packages, document["env_check"])
    return ToolResult(lines=lines, data=document)


def markdown(
    about: Mapping[str, str],
    libraries: Sequence[Library],
    packages: Sequence[Package],
    env_check: Mapping[str, Any] | None,
) -> list[str]:
    """Return the bill as lines of Markdown."""
    lines = ["### minidual environment", "", "| | |", "|---|---|"]
    lines += [f"| {name.replace('_', ' ')} | {_cell(value)} |" for name, value in about.items() if value]
    lines += ["", "| library | wanted | found | |", "|---|---|---|---|"]
    lines += [
        f"| {lib.name} | {_cell(lib.wanted or 'any')} | {lib.found or 'none'} | {'' if lib.fits else '**unfit**'} |"
        for lib in libraries
    ]
    if packages:
        lines += ["", "| Debian package | found |", "|---|---|"]
        lines += [f"| {package.name} | {package.version or '**none**'} |" for package in packages]
    lines.append("")
    if env_check is None:
        lines.append("env-check has not run here.")
        return lines
    lines.append(f"env-check: **{env_check['status']}** on {env_check['finished_at']}, profile {env_check['profile']}")
    lines += [f"- {sentence}" for sentence in env_check["failed"]]
    return lines


def _cell(text: object) -> str:
    return str(text).replace("|", "\\|").replace("\n", " ")


def _last_verdict(context: ToolContext) -> Verdict | None:
    from minidual.errors import DataError
    from minidual.gate.verdict import read_verdict

    path = context.run_folder / "env-check" / "verdict.json"
    try:
        return read_verdict(path)[0] if path.is_file() else None
    except DataError:
        return None  # a bill must come out of a broken installation too


def _summary(verdict: Verdict) -> dict[str, Any]:
    return {
        "status": verdict.status,
        "finished_at": verdict.finished_at,
        "profile": verdict.profile,
        "failed": [check.sentence() for check in verdict.failed_checks()],
    }
