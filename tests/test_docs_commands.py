"""The commands that README and docs print, typed in order on the smoke profile; counts are cut to two."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from test_docs import ROOT, printed_commands

SEAMS = ("ur3", "wind", "sway", "open_loop", "gentle_carry", "nearest", "steadiness")
"""Rows of other distributions; the test of their how-to types those commands."""
FORMS = sorted({command for page, command in printed_commands() if not any(word in command for word in SEAMS)})


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the examples and a finished smoke run."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "examples").symlink_to(ROOT / "examples")
    done = typed(folder, ["run", "--profile", "smoke"], timeout_s=1500)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def typed(folder: Path, words: list[str], timeout_s: float = 600.0) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "HF_HUB_OFFLINE": "1"}
    command = [sys.executable, "-m", "minidual.cli", *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s)


@pytest.mark.slow
@pytest.mark.parametrize("command", FORMS, ids=lambda command: command.replace("/", "."))
def test_a_printed_command_does_its_work(desk: Path, command: str) -> None:
    words = shlex.split(re.sub(r"--(trials|episodes) \d+", r"--\1 2", command).replace("runs/standard", "runs/smoke"))[
        1:
    ]
    if "--profile" not in words:
        words += ["--profile", "smoke"]
    if words[0] == "view":
        words += [] if "--for-s" in words else ["--for-s", "1"]
        words = [("1" if before == "--for-s" else word) for before, word in zip(["", *words], words, strict=False)]
    before = {path: path.read_bytes() for path in desk.glob("runs/smoke/*/verdict.json")}
    done = typed(desk, words)
    assert done.returncode == 0, f"{' '.join(words)}: {done.returncode}\n{done.stderr[-3000:]}"
    assert len(before) == 8
    replaced = [path.parent.name for path, text in before.items() if path.read_bytes() != text]
    assert not replaced, f"{' '.join(words)} replaced {replaced}"
