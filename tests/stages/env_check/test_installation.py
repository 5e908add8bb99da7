"""Required libraries, and the bill of versions for a bug report."""

import json
import platform
from pathlib import Path
from types import SimpleNamespace

import minidual
from minidual.cli.app import run_command_line
from minidual.stages.env_check import installation
from minidual.stages.env_check.installation import Library, required_libraries
from minidual.stages.registry import STAGES
from tests.support.env_check_samples import all_failing_checks


class TestLibraries:
    def test_everything_required_is_found(self):
        libraries = {library.name: library for library in required_libraries()}
        assert {"mujoco", "pin", "ompl", "torch", "lerobot"} <= set(libraries)
        assert all(library.fits for library in libraries.values())

    def test_missing_and_wrong_versions_do_not_fit(self):
        assert not Library("mujoco", ">=4.0.0,<4.1", None).fits
        assert not Library("mujoco", ">=4.0.0,<4.1", "3.9.0").fits
        assert Library("mujoco", ">=4.0.0,<4.1", "4.0.3").fits
        assert Library("anything", "", "0.1").fits

    def test_requirement_lines_are_read(self, monkeypatch):
        lines = ["a>=1,<2", "b[x]~=3.0", 'c; extra == "dev"', "D"]
        monkeypatch.setattr(installation.importlib.metadata, "requires", lambda _: lines)
        found = {"a": "1.5", "b": "2.0"}

        def version(name):
            if name not in found:
                raise installation.importlib.metadata.PackageNotFoundError(name)
            return found[name]

        monkeypatch.setattr(installation.importlib.metadata, "version", version)
        read = {
            library.name: (library.wanted, library.installed, library.fits)
            for library in required_libraries()
        }
        assert read == {
            "a": ("<2,>=1", "1.5", True),
            "b": ("~=3.0", "2.0", False),
            "D": ("", None, False),
        }


class TestBill:
    def test_it_names_versions_and_no_private_path(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setenv("HOME", "/home/somebody")
        assert (
            run_command_line(["env-check", "--markdown", "--runs-dir", str(tmp_path)], STAGES) == 0
        )
        out = capsys.readouterr().out
        assert out.startswith("### minidual environment\n")
        for word in (
            "| python | 3.12",
            "| gl renderer | ",
            "| mujoco | ",
            "| processor | ",
            "env-check has not run",
        ):
            assert word in out
        for private in (
            str(tmp_path),
            str(Path.home()),
            str(Path(minidual.__file__).parent),
            f" {platform.node()} ",
        ):
            assert private not in out
        assert list(tmp_path.iterdir()) == []

    def test_json_is_the_same_as_a_document(self, tmp_path, capsys):
        assert (
            run_command_line(
                ["env-check", "--markdown", "--json", "--runs-dir", str(tmp_path)],
                STAGES,
            )
            == 0
        )
        document = json.loads(capsys.readouterr().out)
        assert "mujoco" in {row["name"] for row in document["libraries"]}
        assert document["about"]["minidual"] == minidual.__version__

    def test_it_comes_out_without_opengl_too(self, tmp_path, capsys, monkeypatch):
        def broken(*_args):
            raise RuntimeError("no EGL")

        monkeypatch.setattr("minidual.plant.render.mujoco.Renderer", broken)
        assert (
            run_command_line(["env-check", "--markdown", "--runs-dir", str(tmp_path)], STAGES) == 0
        )
        assert "| gl renderer | none: cannot create" in capsys.readouterr().out

    def test_it_marks_what_is_unfit_and_what_failed(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(
            installation,
            "required_libraries",
            lambda: [Library("mujoco", ">=4", "3.9")],
        )
        verdict = SimpleNamespace(
            status="fail",
            finished_at="now",
            fingerprint=SimpleNamespace(profile="standard"),
        )
        verdict.failed_checks = all_failing_checks
        monkeypatch.setattr(installation, "read_verdict", lambda _path: (verdict, ""))
        assert (
            run_command_line(["env-check", "--markdown", "--runs-dir", str(tmp_path)], STAGES) == 0
        )
        lines = capsys.readouterr().out.splitlines()
        assert "| mujoco | >=4 | 3.9 | **unfit** |" in lines
        assert "env-check: **fail** on now, profile standard" in lines
        assert "- joints.count is 13, limit == 14" in lines
