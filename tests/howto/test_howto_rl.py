"""docs/howto-rl.md: a lesson from outside the package is trained for a few actions and tried."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import howto

pytestmark = [pytest.mark.torch, pytest.mark.slow]


def test_a_lesson_of_another_distribution_is_trained_as_printed(tmp_path: Path) -> None:
    (module,) = howto.blocks("howto-rl.md")
    (toml,) = howto.blocks("howto-rl.md", "toml")
    page = (howto.DOCS / "howto-rl.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^minidual (train .*)$", page, re.MULTILINE)
    site = tmp_path / "site"
    site.mkdir()
    environment = howto.distribution(site, "rod_lesson", {"rod_lesson": module}, toml)
    words = [sys.executable, "-m", "minidual.cli", *shlex.split(command)]
    done = subprocess.run(
        [*words, "--runs-dir", str(tmp_path / "runs")],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "runs" / "standard" / "train" / "rl" / "rod_carry"
    record = json.loads((folder / "training.json").read_text())
    assert record["steps"] >= 128
    assert record["success"]["clean"]["trials"] == 1
    assert json.loads((folder / "checkpoint" / "config.json").read_text())["task"] == "rod_carry"
