"""docs/howto-arm.md: an arm of another distribution passes env-check."""

from __future__ import annotations

import json
import subprocess
import sys

import howto


def test_an_arm_of_another_distribution_passes_env_check(tmp_path):
    (module,), (toml,) = howto.blocks("howto-arm.md"), howto.blocks("howto-arm.md", "toml")
    site = tmp_path / "site"
    site.mkdir()
    environment = howto.distribution(site, "ur3", {"ur3": module}, toml)

    def env_check(arm):
        quick = {"sine_duration_s": 2}
        command = [sys.executable, "-m", "minidual.cli", "env-check", "--profile", "smoke", "--json"]
        command += ["--runs-dir", str(tmp_path), "--set", f"robot.arm={arm}"]
        for name, value in quick.items():
            command += ["--set", f"env_check.{name}={value}"]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)

    unknown = env_check("ur4")
    assert unknown.returncode == 2
    assert "did you mean" in unknown.stderr
    done = env_check("ur3")
    assert done.returncode == 0, done.stderr
    checks = {check["name"]: check for check in json.loads(done.stdout)["verdict"]["checks"]}
    assert checks["joints.count"]["observed"] == 12
    assert {check["passed"] for check in checks.values()} <= {True, None}
