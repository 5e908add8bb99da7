"""A policy behind a socket: it drives, its time counts, and what does not fit is named."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from minidual.config.learning import DeployConfig, TrainConfig
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.policies.facts import Place
from minidual.policies.kinds import POLICIES, load_policy
from minidual.policies.pilot import load_runtime
from minidual.policies.plausible import PolicyStoppedError
from minidual.policies.policy import Latency, PolicyRuntime
from minidual.policies.server import SERVER, ServerPolicy
from minidual.policies.server_address import folder_of, is_address
from minidual.policies.shipped import shipped_policy
from minidual.robot.pair import DUAL_PANDA
from tests.support.documents import ROOT
from tests.support.policy_server import CHUNK, HELLO, served

PLACE = Place((96, 128), 50.0)
STATE = np.r_[DUAL_PANDA.home, 1.0, 1.0]
IMAGES = {"high": np.zeros((96, 128, 3), np.uint8)}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINIDUAL_CACHE", str(tmp_path / "cache"))


def test_an_address_stands_where_a_folder_does() -> None:
    assert is_address("ws://127.0.0.1:8000")
    assert not is_address("runs/standard/train-act/checkpoint")
    folder = folder_of("ws://127.0.0.1:8000")
    assert folder == folder_of("ws://127.0.0.1:8000")
    assert folder != folder_of("ws://127.0.0.1:8001")
    assert json.loads((folder / "config.json").read_text())["type"] == "server"


def test_it_sends_what_is_measured_and_gets_a_chunk() -> None:
    with served() as (address, messages):
        policy = load_policy(folder_of(address))
        policy.instruct("Carry the rod")
        policy.reset()
        chunk = policy.predict(IMAGES, STATE.astype(np.float32))
        policy.predict(IMAGES, STATE.astype(np.float32))
        policy.close()
    assert chunk.shape == (CHUNK, 16)
    np.testing.assert_allclose(chunk[0], STATE, atol=1e-6)
    assert [message["reset"] for message in messages] == [True, False]
    assert messages[0]["task"] == "Carry the rod"
    assert messages[0]["images"]["high"].shape == (96, 128, 3)
    assert messages[0]["state"].dtype == np.float32


def test_a_server_gets_the_inputs_that_it_asks_for() -> None:
    def stay(message: dict) -> dict:
        return {"actions": np.repeat(message["state"][None, :16], CHUNK, axis=0)}

    asking = {**HELLO, "inputs": {"hand_wrench": 12}}
    with served(stay, hello=asking) as (address, messages):
        runtime = load_runtime(folder_of(address), DeployConfig(), DUAL_PANDA, PLACE)
        with pytest.raises(DataError, match=r"not \(28,\): .*hand_wrench \(12\)"):
            runtime.act(IMAGES, STATE)
        runtime.predict_chunk(IMAGES, runtime.with_usual_inputs(STATE))
        runtime.policy.close()
    assert messages[0]["state"].shape == (28,)


def test_the_time_of_an_answer_is_measured_and_passes_in_the_simulation() -> None:
    """An answer that takes 0.1 s comes after at least five ticks of 50 Hz; the arms hold meanwhile."""

    def ahead(message: dict) -> dict:
        return {"actions": np.repeat((STATE + 0.001)[None], CHUNK, axis=0)}

    with served(ahead, takes_s=0.1) as (address, _):
        runtime = load_runtime(folder_of(address), DeployConfig(), DUAL_PANDA, PLACE)
        actions = [runtime.act(IMAGES, STATE) for _ in range(20)]
        assert runtime.policy.answer_s >= 0.1
        runtime.policy.close()
    moved = [abs(action[0] - STATE[0]) > 1e-6 for action in actions]
    assert moved.index(True) >= 5


def test_a_given_time_replaces_the_measured_one() -> None:
    with served() as (address, _):
        policy = ServerPolicy(address)
        runtime = PolicyRuntime(policy, latency=Latency(50.0, 0.04))
        runtime.act(IMAGES, STATE)
        assert runtime._delay_ticks() == 2
        policy.close()


def test_an_answer_that_is_later_than_its_chunk_lasts_stops_the_arms() -> None:
    with served() as (address, _):
        policy = ServerPolicy(address)
        runtime = PolicyRuntime(policy, latency=Latency(50.0, 0.6))
        with pytest.raises(PolicyStoppedError, match=r"late_answer: .* 0\.600 s; limit 0\.5 s"):
            runtime.act(IMAGES, STATE)
        policy.close()


@pytest.mark.parametrize(
    ("hello", "fault"),
    [
        ({"cameras": {"wrist": [96, 128]}}, "a camera 'wrist'; there are high, left, right"),
        ({"cameras": {"high": [224, 224]}}, "are 224 x 224, here they are 128 x 96"),
        ({"dim": 14}, "it drives 14 numbers, here are 16"),
        ({"rate_hz": 10.0}, "trained at 10 Hz, actions here come at 50 Hz"),
        ({"units": "deg"}, "its joints are in 'deg'"),
        ({"names": ["waist"] * 16}, "its number 0 is 'waist'"),
    ],
)
def test_what_does_not_fit_is_named_before_the_first_step(
    hello: dict[str, object],
    fault: str,
) -> None:
    with served(hello={**HELLO, **hello}) as (address, messages):
        with pytest.raises(UsageError, match="does not fit this robot") as refused:
            load_runtime(folder_of(address), DeployConfig(), DUAL_PANDA, PLACE)
        assert fault in str(refused.value)
        assert messages == []


@pytest.mark.parametrize(
    ("answer", "fault"),
    [
        ({"error": "out of memory"}, "says: out of memory"),
        ({"actions": np.zeros((3, 16))}, r"answers 'actions' \(3, 16\)"),
        ({"action": np.zeros((25, 16))}, "answers 'actions' NoneType"),
    ],
)
def test_a_wrong_answer_is_refused(answer: dict[str, object], fault: str) -> None:
    with served(lambda message: answer) as (address, _):
        policy = ServerPolicy(address)
        with pytest.raises(DataError, match=fault):
            policy.predict(IMAGES, STATE.astype(np.float32))
        policy.close()


def test_a_server_that_hangs_up_is_named() -> None:
    with served() as (address, _):
        policy = ServerPolicy(address)
        policy.close()
        with pytest.raises(EnvironmentMissingError, match="has hung up"):
            policy.predict(IMAGES, STATE.astype(np.float32))


def test_an_address_where_nobody_answers_is_named() -> None:
    with pytest.raises(EnvironmentMissingError, match="no policy server answers at ws://"):
        load_policy(folder_of("ws://127.0.0.1:9"))


def test_what_is_no_policy_server_is_refused() -> None:
    refused = pytest.raises(DataError, match="does not describe its policy")
    with served(hello={"welcome": True}) as (address, _), refused:
        ServerPolicy(address)


def test_it_is_not_trained_here() -> None:
    assert "server" not in POLICIES
    with pytest.raises(UsageError, match="cannot be trained from here"):
        SERVER.train(None, Path())  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="no policy 'server'"):
        POLICIES.names([TrainConfig(policy="server").policy])


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@contextmanager
def example_server(script: str, *words: str) -> Generator[Path]:
    """Run a server of examples/ in a process of its own; yield the folder that stands for it."""
    port = free_port()
    server = subprocess.Popen(
        [sys.executable, str(ROOT / "examples" / script), *words, "--port", str(port)],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert server.stdout is not None
        assert server.stdout.readline().strip() == f"serving at ws://127.0.0.1:{port}"
        yield folder_of(f"ws://127.0.0.1:{port}")
    finally:
        server.kill()
        server.wait(timeout=30)
        if server.stdout is not None:
            server.stdout.close()


def test_the_example_is_a_server_of_another_process() -> None:
    """It moves the wrists towards the brighter half of the picture."""
    with example_server("policy_server.py") as folder:
        runtime = load_runtime(folder, DeployConfig(), DUAL_PANDA, PLACE)
        bright = {"high": IMAGES["high"].copy()}
        bright["high"][:, :64] = 255
        chunk = runtime.predict_chunk(bright, STATE)
        assert chunk[0, 6] == pytest.approx(STATE[6] + 0.1)
        assert chunk[0, 0] == pytest.approx(STATE[0])
        runtime.policy.close()


def test_a_checkpoint_that_is_not_there_is_named(tmp_path: Path) -> None:
    script = ROOT / "examples" / "serve_checkpoint.py"
    server = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "nothing")],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert server.returncode == 2
    assert "there is no checkpoint folder" in server.stderr
    assert "Traceback" not in server.stderr


@pytest.mark.torch
def test_a_served_checkpoint_gives_the_actions_that_it_gives_here() -> None:
    checkpoint = shipped_policy("rod_carry")
    assert checkpoint is not None
    own = load_policy(checkpoint)
    state = STATE.astype(np.float32)
    pictures = {"high": np.full((*own.cameras["high"], 3), 90, np.uint8)}
    with example_server("serve_checkpoint.py", str(checkpoint)) as folder:
        served_policy = load_policy(folder)
        assert served_policy.cameras == own.cameras
        assert served_policy.dim == own.dim
        own.reset()
        served_policy.reset()
        expected = own.predict(pictures, state)
        np.testing.assert_allclose(served_policy.predict(pictures, state), expected, atol=1e-6)
        with pytest.raises(DataError, match="nothing"):
            served_policy.predict({"nothing": pictures["high"]}, state)
        served_policy.close()
