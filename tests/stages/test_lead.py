"""`minidual lead`: a leader drives any plant, without a task's judge."""

from __future__ import annotations

import csv
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from minidual.config.root import changed
from minidual.demos.station import NO_STATION, Station
from minidual.errors import ExitCode, UsageError
from minidual.gate.stage import ToolContext
from minidual.robot.pair import DUAL_PANDA
from minidual.show.view.overlay import Overlay
from minidual.stages.lead import lead
from tests.support.tool_contexts import tool_context

ARMS = "tests.support.position_plant:Follower"
PORT = 47655


def context(tmp_path: Path, settings: dict[str, Any], **options: Any) -> ToolContext:
    made = tool_context(tmp_path, "lead", "rod_carry", **options)
    return replace(made, config=changed(made.config, settings))


@contextmanager
def program(may_start: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """Send targets 50 times a second: press start until the session runs, then swing two joints."""
    stop = threading.Event()

    def send() -> None:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.settimeout(0.02)
        elapsed_s = 0.0
        for k in range(100_000):
            if stop.wait(0.02):
                break
            q = DUAL_PANDA.home.copy()
            q[[3, 10]] += 0.1 * (1.0 - np.cos(2.0 * elapsed_s))
            message = {
                "version": 1,
                "sender": "test",
                "sequence": k,
                "stamp_s": time.monotonic(),
                "q": q.tolist(),
                "openings": [1.0, 1.0],
                "pressed": ["start"] if elapsed_s == 0.0 and may_start() else [],
            }
            link.sendto(json.dumps(message).encode(), ("127.0.0.1", PORT))
            with suppress(OSError):
                elapsed_s = json.loads(link.recv(65535))["stamp_s"]
        link.close()

    sending = threading.Thread(target=send)
    sending.start()
    try:
        yield
    finally:
        stop.set()
        sending.join()


def test_a_program_on_the_network_leads_a_plant_of_another_module(tmp_path: Path) -> None:
    settings = {
        "plant.address": ARMS,
        "teleop.leader": "network",
        "teleop.network.host": "127.0.0.1",
        "teleop.network.port": PORT,
        "teleop.network.silence_max_s": 10.0,  # a busy machine is no silent program
        "arbiter.stop_after_s": 60.0,
    }
    tool = context(tmp_path, settings, seconds=3)
    with program():
        result = lead(tool)
    tool.publish()
    assert result.exit_code == ExitCode.PASS
    data = result.data
    assert (data["place"], data["leader"], data["ended_by"]) == ("test double", "network", "time")
    assert data["ticks"] == 150.0
    assert data["turned_rad"] > 0.05
    assert 0.0 <= data["lag_s"] < 0.1
    assert data["age_p99_s"] < 1.0
    with (tmp_path / "run" / "lead" / "lead.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 150
    assert float(rows[-1]["left_panda_joint4 commanded"]) != pytest.approx(DUAL_PANDA.home[3])


def test_a_scripted_leader_leads_the_simulator(tmp_path: Path) -> None:
    result = lead(context(tmp_path, {"teleop.leader": "scripted"}, seconds=2))
    assert result.data["place"] == "simulator"
    assert result.data["rate_hz"] == pytest.approx(50.0, abs=0.1)
    assert result.data["late_ticks"] == 0.0
    assert result.data["refusals"] == []


class Screen:
    """A view that remembers the hands' joints and the objects' heights of each picture."""

    speed_max = 0.0

    def __init__(self) -> None:
        self.model: mujoco.MjModel | None = None
        self.shown: list[tuple[float, float, float, str]] = []

    def open(self, model: mujoco.MjModel) -> None:
        self.model = model

    def due(self) -> bool:
        return True

    def lead_page(self) -> Station:
        return NO_STATION

    def update(self, data: mujoco.MjData, words: Overlay) -> None:
        assert self.model is not None
        joint = data.qpos[self.model.joint("left_panda_joint4").qposadr[0]]
        height = float(data.xpos[self.model.body("rod").id, 2])
        self.shown.append((words.time_s, float(joint), height, words.title))


@pytest.mark.parametrize(("address", "has_objects"), [("sim-position", True), (ARMS, False)])
def test_a_view_shows_the_plant_before_the_start_and_as_it_moves(
    tmp_path: Path,
    address: str,
    has_objects: bool,
) -> None:
    settings = {
        "plant.address": address,
        "teleop.leader": "network",
        "teleop.network.host": "127.0.0.1",
        "teleop.network.port": PORT,
        "teleop.network.silence_max_s": 10.0,
        "teleop.person.wait_max_s": 20.0,
        "arbiter.stop_after_s": 60.0,
    }
    screen = Screen()
    tool = replace(context(tmp_path, settings, seconds=2), view=screen)
    with program(may_start=lambda: bool(screen.shown)):  # who leads looks at it first
        lead(tool)
    times_s = [time_s for time_s, *_ in screen.shown]
    joints = [joint for _, joint, *_ in screen.shown]
    assert times_s[-1] - times_s[0] > 1.9
    assert np.ptp(joints) > 0.02
    assert {title for *_, title in screen.shown} == {"lead"}
    assert all((height > 0.0) == has_objects for _, _, height, _ in screen.shown)


def test_a_time_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--seconds is 0"):
        lead(context(tmp_path, {}, seconds=0.0))
