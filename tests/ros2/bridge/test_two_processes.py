"""The bridge and another process on one DDS domain: rates, ages, and an arm that is led."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.registry import STAGES, TOOLS
from tests.support.documents import ROOT
from tests.support.ros2_listener import CAMERAS, STEP_RAD

pytest.importorskip("cyclonedds")

ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}"}


def started(module: str, *words: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", module, *words],
        env=ENVIRONMENT,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_another_process_hears_the_arms_and_leads_one(tmp_path: Path) -> None:
    domain = 100 + os.getpid() % 100
    options = ["--domain", str(domain), "--json", "--runs-dir", str(tmp_path)]
    bridge = started("minidual.cli", "bridge", *options, folder=tmp_path)
    try:
        listener = started("tests.support.ros2_listener", str(domain), folder=ROOT)
        heard_text, trouble = listener.communicate(timeout=300)
        assert listener.returncode == 0, trouble
        bridge.send_signal(signal.SIGINT)
        sent_text, said = bridge.communicate(timeout=60)
    finally:
        bridge.kill()
    assert bridge.returncode == 0, said
    heard = json.loads(heard_text)
    sent = json.loads(sent_text)
    print(json.dumps({"heard": heard["rates_hz"], "p99_s": heard["p99_s"], "sent": sent}))
    assert heard["names"][:14] == list(DUAL_PANDA.joint_names)
    assert "teleop" in heard["modes"]
    assert any("no mode 'fly'" in line for line in heard["refusals"])
    assert any("3 numbers; send 14" in line for line in heard["refusals"])
    assert heard["moved_rad"][0] == pytest.approx(STEP_RAD, abs=0.03)
    assert heard["command"][0] == pytest.approx(DUAL_PANDA.home[0] + STEP_RAD, abs=0.01)
    rates = heard["rates_hz"]
    assert all(rates[f"/camera_{camera}/image_raw"] > 0.0 for camera in CAMERAS)
    if sent["behind_s"] == 0.0:  # the machine kept up
        assert rates["/joint_states"] == pytest.approx(100.0, rel=0.05)


def test_a_wrong_time_is_refused(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["bridge", "--for-s", "0"], STAGES, TOOLS) == 2
    assert "--for-s is 0; it must be above 0" in capsys.readouterr().err
