"""An environment of its own in which LeRobot finds the plug-ins of `plugins/`."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

from tests.support.documents import ROOT, code_lines

PAGES = ("README.md", "docs/lerobot.md")
PLUGINS = sorted((ROOT / "plugins").glob("lerobot_*"))


def build(folder: Path) -> Path:
    """Build every plug-in, install the wheels in a new environment; return its Python.

    It sees the libraries of this process behind its own.
    """
    wheels = folder / "wheels"
    for plugin in PLUGINS:
        subprocess.run(
            [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheels)],
            cwd=plugin,
            check=True,
            capture_output=True,
            timeout=120,
        )
    venv.create(folder / "env", with_pip=False, symlinks=True)
    python = folder / "env" / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "env")}))
    # A .pth file inside these libraries is read too: minidual itself may be one.
    libraries = sysconfig.get_path("purelib")
    (site / "libraries.pth").write_text(f"import site; site.addsitedir({libraries!r})\n")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run(
        [*install, "--target", str(site), *map(str, sorted(wheels.glob("*.whl")))],
        check=True,
        capture_output=True,
        timeout=120,
    )
    return python


def environment(folder: Path) -> dict[str, str]:
    """Return environment variables: offline, caches in a folder, and this checkout's sources."""
    return {
        **os.environ,
        "HF_HUB_OFFLINE": "1",
        "HF_HOME": str(folder / "huggingface"),
        "HF_LEROBOT_HOME": str(folder / "lerobot"),
        "MUJOCO_GL": "egl",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(ROOT / "src"),
        "WANDB_MODE": "disabled",
    }


def command(python: Path, name: str) -> list[str]:
    """Return the beginning of a command of LeRobot: its own script, unmodified."""
    return [str(python), str(Path(sys.executable).with_name(name))]


def printed_lines() -> list[str]:
    """Return the lines of LeRobot's commands that the pages print, each once and in order."""
    lines = [line for page in PAGES for line in code_lines((ROOT / page).read_text("utf-8"))]
    return list(dict.fromkeys(line for line in lines if line.startswith("lerobot-")))
