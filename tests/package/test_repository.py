"""The repository: layers, the lock, the reasons for its dependencies, set-up."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def normal_name(requirement: str) -> str:
    return re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0].lower().replace("_", "-")


DIRECT = sorted(normal_name(item) for item in PROJECT["project"]["dependencies"])
DEVELOPMENT = sorted(normal_name(item) for item in PROJECT["dependency-groups"]["dev"])


def run_linter(folder: Path, configuration: Path) -> subprocess.CompletedProcess[str]:
    tool = Path(sys.executable).with_name("lint-imports")
    return subprocess.run(
        [str(tool), "--no-cache", "--config", str(configuration)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(folder / "src")},
    )


def test_imports_point_down() -> None:
    done = run_linter(ROOT, ROOT / "pyproject.toml")
    assert done.returncode == 0, done.stdout + done.stderr


def test_an_import_that_points_up_is_found(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    intruder = tmp_path / "src" / "minidual" / "robot" / "intruder.py"
    intruder.write_text("import minidual.motion\nimport minidual.gate.check\n", encoding="utf-8")
    done = run_linter(tmp_path, ROOT / "pyproject.toml")
    assert done.returncode == 1
    assert "minidual.robot.intruder -> minidual.motion" in done.stdout
    assert "minidual.robot.intruder -> minidual.gate.check" in done.stdout


def test_every_locked_distribution_has_hashes_and_none_an_address() -> None:
    blocks = re.split(r"\n(?=[A-Za-z0-9])", LOCK)
    assert len(blocks) > 50
    bare = [block.splitlines()[0] for block in blocks if "--hash=sha256:" not in block]
    assert bare == []
    assert "://" not in LOCK


@pytest.mark.parametrize("name", DIRECT + DEVELOPMENT)
def test_every_direct_dependency_is_locked_and_has_its_reason(name: str) -> None:
    assert re.search(rf"^{re.escape(name)}(\[[a-z,]+\])?==", LOCK, re.MULTILINE), (
        f"{name} is not locked"
    )
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    assert re.search(rf"^\| `{re.escape(name)}[`\[]", page, re.MULTILINE), (
        f"docs/dependencies.md lacks {name}"
    )


def test_the_page_of_dependencies_names_no_others() -> None:
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    named = [normal_name(name) for name in re.findall(r"^\| `([^`]+)`", page, re.MULTILINE)]
    assert sorted(named) == sorted(DIRECT + DEVELOPMENT)


@pytest.mark.parametrize("found", ["none", "old"])
def test_setup_without_python_312_says_what_to_do(tmp_path: Path, found: str) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in ("bash", "dirname", "cat", "head"):
        (tools / name).symlink_to(shutil.which(name) or name)
    if found == "old":
        old = tools / "python3"
        old.write_text("#!/bin/sh\necho Python 3.11.7\nexit 1\n", encoding="utf-8")
        old.chmod(0o755)
    scripts = tmp_path / "scripts"
    scripts.mkdir()
    shutil.copy(ROOT / "scripts" / "setup.sh", scripts)
    done = subprocess.run(
        [str(scripts / "setup.sh")],
        env={"PATH": str(tools)},
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.returncode == 1
    assert "minidual needs CPython 3.12" in done.stderr
    assert "PYTHON=/path/to/python3.12" in done.stderr
    assert ("Python 3.11.7" in done.stderr) == (found == "old")
    assert not (tmp_path / ".venv").exists()


def test_a_missing_gl_library_is_named_with_its_packages() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "check_egl.py")],
        env={**os.environ, "MUJOCO_GL": "egl", "__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 4
    assert "libegl1 libgl1-mesa-dri" in done.stderr


@pytest.mark.parametrize("platform", ["osmesa", "bogus"])
def test_another_opengl_platform_does_not_break_the_import(platform: str) -> None:
    """Only EGL is supported: another MUJOCO_GL, as on some headless machines, is overridden."""
    done = subprocess.run(
        [sys.executable, "-c", "import minidual, mujoco; print(mujoco.Renderer)"],
        env={**os.environ, "MUJOCO_GL": platform},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr


def test_the_readme_opens_with_a_picture_and_the_commands() -> None:
    head = (ROOT / "README.md").read_text(encoding="utf-8").split("\n## ")[0]
    (name,) = re.findall(r"!\[[^\]]+\]\((docs/\w+\.webp)\)", head)
    _, first_block, _ = head.split("```", 2)
    assert re.findall(r"^make (\w+)", first_block, re.MULTILINE) == ["setup", "all"]
    commands = re.findall(r"^\.venv/bin/minidual (\w+)", first_block, re.MULTILINE)
    assert commands == ["demo", "plan"]
    with Image.open(ROOT / name) as picture:
        assert picture.n_frames > 20, "it moves"
    assert (ROOT / name).stat().st_size < 700_000


def test_the_documents_name_every_stage_and_exit_code() -> None:
    from minidual.errors import ExitCode
    from minidual.stages.registry import STAGES

    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert [name for name in STAGES if f"| [`{name}`]({name}.md) |" not in page] == []
    assert [int(code) for code in ExitCode if f"| {int(code)} |" not in page] == []
