"""docs/howto-arm.md: an arm of another distribution passes env-check."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.robot.models import ARM_MODELS
from minidual.stages.registry import STAGES, TOOLS
from tests.support import howto


def test_an_arm_of_another_distribution_passes_env_check(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (module,) = howto.blocks("howto-arm.md")
    (toml,) = howto.blocks("howto-arm.md", "toml")
    site = tmp_path / "site"
    site.mkdir()

    def env_check(arm: str) -> int:
        words = ["env-check", "--profile", "smoke", "--json", "--runs-dir", str(tmp_path)]
        words += ["--set", f"robot.arm={arm}", "--set", "env_check.sine_duration_s=2"]
        return run_command_line(words, STAGES, TOOLS)

    with howto.installed(ARM_MODELS, site, "ur3", {"ur3": module}, toml):
        assert env_check("ur4") == 2
        assert "did you mean" in capsys.readouterr().err
        status = env_check("ur3")
        printed = capsys.readouterr()
    checks = {check["name"]: check for check in json.loads(printed.out)["verdict"]["checks"]}
    assert checks["joints.count"]["observed"] == 12
    assert {check["passed"] for check in checks.values()} <= {True, None}, printed.err
    assert status == 0
