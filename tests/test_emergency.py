"""The emergency stop: pressed by a command, a signal, a button or a key.

Nothing moves again before a new command.
"""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from minidual import emergency
from minidual.cli.app import run_command_line
from minidual.config.learning import TeleopConfig
from minidual.config.root import ViewConfig
from minidual.config.scene import SceneConfig
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leaders.keyboard import KeyboardLeader
from minidual.demos.session import TeleopSession
from minidual.errors import ExitCode
from minidual.gate.lock import run_lock
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.show.view import make_view
from minidual.show.view.web import WebView
from minidual.stages.registry import STAGES, TOOLS
from minidual.workers import in_workers
from tests.support.browser import CAMERA, unused_port
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.control_plant import ArmsPlant
from tests.support.panda import DOF, HOME
from tests.support.stacks import hand_over, move, stack_on, trajectory

WORKING = """
import sys, time
from pathlib import Path
from minidual import emergency
from minidual.gate.lock import run_lock
from minidual.workers import in_workers

def move(item):
    Path(sys.argv[1], f"moving-{item}").touch()
    end = time.monotonic() + 30.0
    while not emergency.pressed() and time.monotonic() < end:
        time.sleep(0.01)
    Path(sys.argv[1], f"moving-{item}").write_text(emergency.pressed() or "went on")
    time.sleep(0.5)  # the first that ends ends the other

emergency.listen()
with run_lock(Path(sys.argv[1]), "minidual carry"):
    list(in_workers(move, [0, 1], 2))
"""
"""A command whose two workers move until the stop is pressed, and fail to notice it after 30 s."""


@pytest.fixture(autouse=True)
def _released() -> Iterator[None]:
    yield
    emergency.release()


def _stop(runs: Path, *words: str) -> int:
    return run_command_line(["stop", *words, "--runs-dir", str(runs)], STAGES, TOOLS)


def test_the_command_stop_stops_a_running_command_and_its_workers(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "busy"
    folder.mkdir()
    command = [sys.executable, "-c", WORKING, str(folder)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        _until(lambda: len(list(folder.glob("moving-*"))) == 2)
        assert _stop(tmp_path, "--json") == ExitCode.PASS
        assert json.loads(capsys.readouterr().out)["stopped"] == [process.pid]
        _, said = process.communicate(timeout=60)
    assert "EmergencyStop: emergency stop (signal SIGUSR1)" in said
    assert [path.read_text() for path in folder.glob("moving-*")] == ["signal SIGUSR1"] * 2


def test_stop_says_when_nothing_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with run_lock(tmp_path / "ended", "minidual carry"):
        (tmp_path / "ended" / "config.yaml").write_text("seed: 1")
    # Another process has the id that the lock of a container names.
    (tmp_path / "ended" / ".lock").write_text(
        json.dumps({"pid": 1, "command": "minidual carry", "since": "now"}),
    )
    for words in ((), ("ended",), ("never",)):
        assert _stop(tmp_path, *words) == ExitCode.USAGE
        said = capsys.readouterr().err
        place = f"run '{words[0]}' of" if words else "the runs in"
        assert f"nothing to stop: no command is working in {place}" in said
        assert "Traceback" not in said


@pytest.mark.parametrize("words_that_stop", [("--run", "busy"), ()])
def test_stop_stops_no_other_run_than_the_one_that_is_meant(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words_that_stop: tuple[str, ...],
) -> None:
    """A profile or a run names one run; a misspelt name says which runs are working."""
    folder = tmp_path / "busy"
    folder.mkdir()
    (tmp_path / "damaged" / ".lock").mkdir(parents=True)  # it keeps nothing else from being stopped
    with subprocess.Popen(
        [sys.executable, "-c", WORKING, str(folder)],
        stderr=subprocess.DEVNULL,
    ) as process:
        _until(lambda: len(list(folder.glob("moving-*"))) == 2)
        for words, said in (
            (("--profile", "smoke"), "no command is working in run 'smoke'"),
            (
                ("bussy",),
                "remedy: a command is working in busy; minidual stop, without a name, stops all",
            ),
            (("busy", "--run", "other"), "two runs are named, 'busy' and 'other'"),
            (("",), "the name of the run is empty"),
        ):
            assert _stop(tmp_path, *words) == ExitCode.USAGE
            assert said in capsys.readouterr().err
        assert process.poll() is None
        assert _stop(tmp_path, *words_that_stop) == ExitCode.PASS
        out = capsys.readouterr().out
        assert "emergency stop sent to process" in out
        assert "--runs-dir" not in out, "what another process was told is not rewritten"
        process.wait(60)
    assert _stop(tmp_path / "nowhere") == ExitCode.USAGE
    assert "which is no folder" in capsys.readouterr().err


def test_a_process_that_has_not_the_lock_open_is_left_alone(tmp_path: Path) -> None:
    with run_lock(tmp_path / "held", "minidual carry"), subprocess.Popen(["sleep", "20"]) as other:
        lock = tmp_path / "held" / ".lock"
        lock.write_text(json.dumps({"pid": other.pid, "command": "minidual carry", "since": "now"}))
        assert _stop(tmp_path, "held") == ExitCode.USAGE
        assert other.poll() is None
        other.kill()


def test_a_press_stops_supervised_arms_and_nothing_moves_again(scene: SceneConfig) -> None:
    plant = ArmsPlant(scene)
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8)))
    for _ in range(400):
        stack.step()
    emergency.press("red button")
    with pytest.raises(ReflexError, match=r"emergency_stop at .*: red button"):
        stack.step()
    while stack.stopping:
        stack.step()
    assert np.abs(plant.v).max() < 0.05
    for again in (stack.recover, stack.reset, lambda: Supervisor(dt_s=plant.dt)):
        with pytest.raises(emergency.EmergencyStop, match=r"emergency stop \(red button\)"):
            again()
    assert stack.reflex is not None
    emergency.release()
    stack.recover()
    hand_over(stack, "moveit")


def _under_way(scene: SceneConfig) -> tuple[ArmsPlant, ControlStack]:
    plant = ArmsPlant(scene)
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8))) is None
    for _ in range(300):
        stack.step()
    return plant, stack


@pytest.mark.parametrize("how", ["stop", "overwritten", "process"])
def test_a_press_that_gives_no_reason_is_a_press(scene: SceneConfig, how: str) -> None:
    """An empty reason takes no earlier one back."""
    plant, stack = _under_way(scene)
    assert stack.supervisor is not None
    if how == "process":
        emergency.press("")
    else:
        if how == "overwritten":
            stack.supervisor.estop("operator")
        stack.supervisor.estop("")
    try:
        with pytest.raises(ReflexError, match="emergency_stop"):
            stack.step()
    finally:
        emergency.release()
    for _ in range(600):
        stack.step()
    assert np.abs(plant.v).max() < 1e-3


def test_a_second_press_outlives_the_recovery_from_the_first(scene: SceneConfig) -> None:
    _, stack = _under_way(scene)
    assert stack.supervisor is not None
    stack.supervisor.estop("first")
    with pytest.raises(ReflexError, match="first"):
        stack.step()
    for _ in range(800):
        stack.step()
    stack.supervisor.estop("second")
    stack.recover()
    with pytest.raises(ReflexError, match="second"):
        stack.step()
    for _ in range(800):
        stack.step()
    stack.recover()
    hand_over(stack, "teleop")


def test_a_press_stops_arms_whose_supervisor_bounds_nothing_and_ends_further_work(
    scene: SceneConfig,
) -> None:
    stack = stack_on(ArmsPlant(scene))
    stack.step()
    work = in_workers(lambda item: item, [1, 2, 3], 1)
    assert next(work) == 1
    emergency.press("red button")
    with pytest.raises(emergency.EmergencyStop):
        next(work)
    with pytest.raises(ReflexError, match="emergency_stop"):
        stack.step()


def test_the_button_of_the_view_presses(capsys: pytest.CaptureFixture[str]) -> None:
    view = make_view("web", ViewConfig(port=unused_port()), say=lambda text: None)
    assert isinstance(view, WebView)
    try:
        address = str(view.url).replace("http:", "ws:")
        protocols = [Subprotocol(f"viser-v{viser.__version__}")]
        with connect(address, subprotocols=protocols, max_size=None) as client:
            client.send(msgspec.msgpack.encode(CAMERA))
            _until(lambda: bool(view._server.get_clients()))
            assert emergency.pressed() == ""
            button: Any = view.panel._stop
            message = {
                "type": "GuiUpdateMessage",
                "uuid": button._impl.uuid,
                "updates": {"value": True},
            }
            client.send(msgspec.msgpack.encode(message))
            _until(lambda: emergency.pressed() == "button of the view")
    finally:
        view.close()


@pytest.mark.parametrize("key", ["x", "X", "\x1b"])
def test_a_key_ends_an_episode_of_the_keyboard_leader_with_arms_at_rest(
    world: World,
    key: str,
) -> None:
    keys, screen = pty.openpty()
    config = TeleopConfig.model_validate({"person": {"wait_for_start": False}})
    leader = KeyboardLeader(world.robot, config, descriptor=screen)
    # Arrows and the like are neither escape nor the letters they end with.
    os.write(keys, b"\x1b[A\x1bOD\x1b[1;5C\x1b[F\x1b[3~")
    leader.read(0.0)
    assert emergency.pressed() == ""
    np.testing.assert_array_equal(leader._goals, leader._tracker.Ts_world_tcp)
    supervisor = Supervisor(dt_s=world.dt, kinematics=Kinematics())
    stack = ControlStack(world, Kinematics(), supervisor=supervisor)
    session = TeleopSession(stack, config)
    speeds_rad_s: list[float] = []

    def press(tick: object) -> None:
        speeds_rad_s.append(float(np.abs(world.v).max()))
        if len(speeds_rad_s) <= 40:
            os.write(keys, b"wwr")
        elif len(speeds_rad_s) == 41:
            os.write(keys, key.encode())

    try:
        trial = sample_trial(world.scene, 7, "demonstrations", 0)
        result = session.run(carry_task(world.scene), trial, leader, on_tick=press)
    finally:
        leader.close()
        os.close(keys)
        os.close(screen)
    assert result.ended_by == "reflex"
    assert "emergency_stop" in result.reason
    assert "key of the keyboard" in result.reason
    assert 41 <= len(speeds_rad_s) <= 47, "escape waits 60 ms for the rest of an arrow"
    assert speeds_rad_s[40] > 0.05, "the arms did not move"
    assert np.abs(world.v).max() < 0.05
    assert len(world.q) == DOF


@pytest.mark.slow
def test_a_real_carry_ends_with_its_arms_at_rest_and_is_marked_as_interrupted(
    tmp_path: Path,
) -> None:
    words = "carry --profile smoke --trials 20 --workers 2 --waive-gate test --runs-dir"
    command = [sys.executable, "-m", "minidual.cli", *words.split(), str(tmp_path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        # There is one line in ten seconds.
        assert any(re.match(r"carries: \d+/20, .* left", line) for line in lines)
        assert _stop(tmp_path, "smoke") == ExitCode.PASS
        _, said = process.communicate(timeout=60)
    assert process.returncode == ExitCode.INTERRUPTED
    assert "minidual: emergency stop (signal SIGUSR1)" in said
    assert "Traceback" not in said
    attempt = json.loads((tmp_path / "smoke" / ".carry.tmp" / "attempt.json").read_text())
    assert attempt["state"] == "interrupted"
    assert attempt["message"].startswith("emergency stop (signal SIGUSR1)")


def test_the_signal_is_the_one_that_is_documented() -> None:
    assert signal.SIGUSR1 == emergency.SIGNAL


def _until(condition: Any, limit_s: float = 30.0) -> None:
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, f"not within {limit_s} s"
        time.sleep(0.02)


def test_a_command_that_is_paused_and_goes_on_is_not_stopped() -> None:
    """Ctrl-Z and fg: CPython's sigtimedwait returns another signal then."""
    script = (
        "import sys, time\n"
        "from minidual import emergency\n"
        "emergency.listen()\n"
        "print('on', flush=True)\n"
        "time.sleep(1.2)\n"
        "print(repr(emergency.pressed()))\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "on\n"
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.5)
        process.send_signal(signal.SIGCONT)
        assert process.stdout.read() == "''\n"
