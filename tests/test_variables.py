"""Variables of the process: what libraries read before they are imported."""

import ast
import os
import pwd
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from minidual import variables

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("LOGNAME", "USER", "LNAME", "USERNAME")


def nobody(_: int) -> pwd.struct_passwd:
    raise KeyError("getpwuid(): uid not found: 1234")


@pytest.fixture
def stranger(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A container's user without a passwd entry; returns the folder for temporary files."""
    monkeypatch.setattr(pwd, "getpwuid", nobody)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    for name in (*NAMES, "HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def test_a_user_without_an_entry_gets_a_name_and_a_home(stranger: Path) -> None:
    variables.prepare()
    assert os.environ["LOGNAME"] == f"uid-{os.getuid()}"
    assert Path(os.environ["HOME"]) == stranger / f"minidual-{os.getuid()}"
    assert Path(os.environ["HOME"]).stat().st_mode & 0o777 == 0o700


def test_names_that_are_set_stay(stranger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("USER", "robot")
    monkeypatch.setenv("HOME", str(stranger))
    variables.prepare()
    assert "LOGNAME" not in os.environ
    assert os.environ["HOME"] == str(stranger)
    assert list(stranger.iterdir()) == []


def test_a_home_that_cannot_be_written_is_replaced(
    stranger: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Docker gives a user without an entry the home folder "/"."""
    monkeypatch.setenv("HOME", "/no/such/home")
    variables.prepare()
    assert os.environ["HOME"] == str(stranger / f"minidual-{os.getuid()}")


def test_a_user_with_an_entry_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pwd, "getpwuid", lambda _: pwd.struct_passwd(("a", "", 1, 1, "", "/", "")))
    for name in (*NAMES, "HOME"):
        monkeypatch.delenv(name, raising=False)
    variables.prepare()
    assert not {*NAMES, "HOME"} & set(os.environ)


@pytest.mark.torch
def test_a_policy_loads_for_a_user_without_an_entry(tmp_path: Path) -> None:
    program = """
import pwd
def nobody(_):
    raise KeyError("getpwuid(): uid not found: 1234")
pwd.getpwuid = nobody
import minidual.policies.act
import torch._inductor.runtime.cache_dir_utils as folders
import torch._dynamo.config
print(folders.default_cache_dir())
"""
    without = {name: value for name, value in os.environ.items() if name not in NAMES}
    del without["HOME"]
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=without | {"TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip().endswith(f"torchinductor_uid-{os.getuid()}")


def test_a_folder_of_somebody_else_is_not_used(stranger: Path) -> None:
    folder = stranger / f"minidual-{os.getuid()}"
    folder.symlink_to(stranger)
    assert variables.private_folder() is None
    folder.unlink()
    folder.mkdir()
    folder.chmod(0o777)
    assert variables.private_folder() is None
    folder.chmod(0o700)
    assert variables.private_folder() == folder


def test_without_a_place_for_temporary_files_there_is_no_folder(
    stranger: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(stranger / "none"))
    assert variables.private_folder() is None
    variables.prepare()
    assert "HOME" not in os.environ


@pytest.mark.parametrize(
    ("device", "reason", "remedy"),
    [
        (None, "no EGL", variables.INSTALL_RENDERING),
        ("7", "The MUJOCO_EGL_DEVICE_ID environment variable must be", "no rendering device"),
        ("gpu", "invalid literal for int()", "unset MUJOCO_EGL_DEVICE_ID, which is 'gpu'"),
        ("0", "no EGL", f"if that does not help, {variables.INSTALL_RENDERING}"),
    ],
)
def test_a_variable_that_picks_the_device_is_named_before_packages(
    device: str | None,
    reason: str,
    remedy: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("MUJOCO_EGL_DEVICE_ID", raising=False)
    if device is not None:
        monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", device)
    told = variables.rendering_remedy(reason)
    assert remedy in told
    assert ("apt-get" in told) == (device in (None, "0"))


def test_a_command_without_libopengl_names_the_packages(tmp_path: Path) -> None:
    """A slim container lacks it, and libegl1 does not bring it."""
    program = """
import sys
import OpenGL.platform.ctypesloader as loader
load = loader.loadLibrary
def missing(dll, name, mode=None):
    if name in ("OpenGL", "GL", "GLESv2", "GLESv1_CM"):
        raise OSError(name + " cannot be opened")
    return load(dll, name, mode=mode)
loader.loadLibrary = missing
sys.argv = ["minidual", "plan", "--acm"]
from minidual.cli.process import main
main()
"""
    environment = {**os.environ, "PYOPENGL_PLATFORM": "egl", "MUJOCO_GL": "egl"}
    environment.pop("MUJOCO_EGL_DEVICE_ID", None)
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 4, done.stderr[-2000:]
    assert variables.INSTALL_RENDERING in done.stderr
    assert "libopengl0" in variables.RENDERING_PACKAGES


def test_another_tools_variables_are_overridden_or_named() -> None:
    program = """
import minidual, mujoco
from minidual.plant.render import off_screen
try:
    off_screen(mujoco.MjModel.from_xml_string("<mujoco/>"), 32, 32)
except Exception as error:
    print(error.remedy)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYOPENGL_PLATFORM": "osmesa", "MUJOCO_EGL_DEVICE_ID": "999"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith("unset MUJOCO_EGL_DEVICE_ID, which is '999'")
    assert "apt-get" not in done.stdout


def deciding_asserts(source: str) -> list[int]:
    """Return the lines of assertions that do more than tell a type checker about a value."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Assert):
            continue
        is_type = isinstance(node.test, ast.Call) and ast.unparse(node.test.func) == "isinstance"
        is_present = isinstance(node.test, ast.Compare) and isinstance(node.test.ops[0], ast.IsNot)
        if not (is_type or is_present):
            lines.append(node.lineno)
    return lines


def test_nothing_is_decided_by_an_assertion_that_pythonoptimize_drops() -> None:
    assert deciding_asserts("assert x is not None\nassert isinstance(x, int)\nassert x > 0") == [3]
    files = {path: path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py")}
    assert len(files) > 200
    assert {
        path.name: deciding_asserts(text) for path, text in files.items() if deciding_asserts(text)
    } == {}


def test_tests_are_not_run_without_assertions() -> None:
    done = subprocess.run(
        [sys.executable, "-O", "-m", "pytest", "-q", "--collect-only", __file__],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 4
    assert "PYTHONOPTIMIZE drops assertions" in done.stderr
