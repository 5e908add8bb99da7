"""docs/howto-stage.md: its code runs, from outside the package."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.support import howto


def test_a_stage_of_another_distribution_runs_behind_the_gate(tmp_path):
    (module,) = howto.blocks("howto-stage.md")
    (toml,) = howto.blocks("howto-stage.md", "toml")
    site = tmp_path / "site"
    site.mkdir()
    environment = howto.distribution(site, "steadiness", {"steadiness": module}, toml)

    def minidual(*words):
        command = [
            sys.executable,
            "-m",
            "minidual.cli",
            *words,
            "--profile",
            "smoke",
            "--runs-dir",
            str(tmp_path),
        ]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)

    done = minidual("steadiness", "--steps", "100", "--json")
    assert done.returncode == 0, done.stderr
    (check,) = json.loads(done.stdout)["verdict"]["checks"]
    assert (check["name"], check["passed"]) == ("drift_max_rad", True)
    assert (tmp_path / "smoke" / "steadiness" / "drift.csv").is_file()
    stages = {
        row["name"]: row["state"]
        for row in json.loads(minidual("status", "--json").stdout)["stages"]
    }
    assert stages["steadiness"] == "pass"
