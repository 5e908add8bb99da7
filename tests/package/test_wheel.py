"""The wheel works on its own: outside the checkout, with the profiles and templates it ships."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "src" / "minidual"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        timeout=120,
    )
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--no-index",
            "--no-compile",
            "--target",
            str(folder),
            str(wheel),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    return folder


def run_installed(site: Path, cwd: Path, *words: str) -> str:
    """Run the installed console script in `cwd`, with the wheel first on the path."""
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, str(site / "bin" / "minidual"), *words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_data_file_of_the_package_is_in_the_wheel(wheel: Path) -> None:
    shipped = set(zipfile.ZipFile(wheel).namelist())
    data = [
        path.relative_to(SOURCES.parent).as_posix()
        for path in SOURCES.rglob("*")
        if path.is_file() and path.suffix != ".py" and path.parent.name != "__pycache__"
    ]
    assert any(name.startswith("minidual/configs/") for name in data)
    assert any(name.startswith("minidual/show/report/templates/") for name in data)
    assert sorted(set(data) - shipped) == []


def test_the_wheel_holds_the_package_and_nothing_beside_it(wheel: Path) -> None:
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"minidual"}


def test_the_console_script_tells_its_version(site: Path, tmp_path: Path) -> None:
    import minidual

    assert minidual.__version__ in run_installed(site, tmp_path, "--version")


def test_profiles_come_from_the_wheel(site: Path, tmp_path: Path) -> None:
    # A value that only the installed copy has proves where the profile was read.
    profile = site / "minidual" / "configs" / "smoke.yaml"
    text = profile.read_text(encoding="utf-8")
    profile.write_text("seed: 4711\n" + text, encoding="utf-8")
    try:
        shown = json.loads(
            run_installed(site, tmp_path, "config", "show", "--profile", "smoke", "--json"),
        )
    finally:
        profile.write_text(text, encoding="utf-8")
    assert "4711" in json.dumps(shown)
