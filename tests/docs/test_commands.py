"""The commands that README and docs print, typed in order on the smoke profile; counts are cut to two."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.documents import ROOT, printed_commands
from tests.support.late import late

SEAMS = ("ur3", "wind", "sway", "open_loop", "gentle_carry", "nearest", "steadiness")
"""Rows of other distributions; the test of their how-to types those commands."""
SERVERS = ("minidual plant serve --pace client",)
"""They serve until they are stopped; tests/plant/franka/test_client.py types them."""
FORMS = list(
    dict.fromkeys(
        command
        for _, command in printed_commands()
        if not any(word in command for word in SEAMS) and command not in SERVERS
    ),
)
"""In the order of pages and lines: a command may go on from the one before."""


SMALLER = {
    r"--(trials|episodes) \d+": r"--\1 2",
    r"perturbed_trials_n=\d+": "perturbed_trials_n=1",
    r"train\.steps=\d+": "train.steps=210",
    r"teleop\.episodes_n=\d+": "teleop.episodes_n=4",
    "(runs/|--run )standard": r"\1smoke",
    "run --profile configs/mine.yaml": r"\g<0> --until env-check",
    "^minidual bridge(?!.*--for-s)": r"\g<0> --for-s 1",
    "^minidual view(?! --for-s)": r"\g<0> --for-s 1",
    r"--for-s \d+": "--for-s 1",
    "teleop.leader=browser": r"\g<0> --set teleop.person.wait_max_s=1",
}
"""What makes a printed command short, and work on the smoke run."""
REFUSED = {
    "minidual teleop-record --set teleop.leader=keyboard": (
        4,
        "the keyboard leader needs a terminal",
    ),
    "minidual teleop-record --profile smoke --set teleop.leader=browser": (
        2,
        "nobody pressed start after 1 s",
    ),
    "minidual teleop-record --profile smoke --set teleop.leader=browser --episodes 5": (
        2,
        "nobody pressed start after 1 s",
    ),
    "minidual teleop-record --run fixes --correct runs/standard/train-act/checkpoint "
    "--set teleop.leader=browser --episodes 20": (2, "nobody pressed start after 1 s"),
    "minidual teleop-record --set teleop.leader=gello": (2, "gello.yaml cannot be read"),
    "minidual teleop-record --set teleop.leader=replay --set teleop.replay.path=episodes": (
        2,
        "where there is nothing",
    ),
    "minidual try rod_carry --method act --checkpoint outputs/train/checkpoints/last/pretrained_model": (
        2,
        "there is no policy (config.json) in that folder",
    ),
    "minidual deploy --policy outputs/train/checkpoints/last/pretrained_model": (
        2,
        "there is no policy (config.json) in that folder",
    ),
    "minidual benchmark --methods moveit,theirs "
    "--policy theirs=outputs/train/checkpoints/last/pretrained_model": (
        2,
        "benchmark.policies.theirs: there is no policy (config.json)",
    ),
    "minidual try rod_carry --method act --checkpoint ws://127.0.0.1:8000": (
        4,
        "no policy server answers at ws://127.0.0.1:8000",
    ),
    "minidual benchmark --methods moveit,theirs --policy theirs=ws://127.0.0.1:8000": (
        4,
        "no policy server answers at ws://127.0.0.1:8000",
    ),
    "minidual env-check --plant franka://127.0.0.1,127.0.0.2": (4, "no Franka controller answers"),
    "minidual migrate --plant franka://127.0.0.1,127.0.0.2": (4, "no Franka controller answers"),
    "minidual migrate --plant franka://LEFT,RIGHT --confirm estop-button,mains,cable "
    "--signed-by NAME": (4, "no Franka controller answers"),
    "minidual stop": (2, "nothing to stop: no command is working"),
    "minidual run --run cuda --set train.device=cuda": (4, "torch finds no CUDA device"),
    "minidual run --profile gpu": (4, "torch finds no CUDA device"),
}
"""Commands that a test cannot type to the end."""
STOPPED = {"minidual modes": "ENDED TOO EARLY: reflex "}
"""Commands that the policy of a smoke run, which knows next to nothing, may end: exit 1, and the reflex is named."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the examples, a profile, a key and a finished smoke run."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "configs").mkdir()
    (folder / "configs" / "mine.yaml").write_text("extends: smoke\n\ncarry:\n  trials_n: 3\n")
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "results_key"],
        cwd=folder,
        check=True,
    )
    done = typed(folder, ["run", "--profile", "smoke"], timeout_s=1500)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def typed(
    folder: Path,
    words: list[str],
    timeout_s: float = 600.0,
) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "HF_HUB_OFFLINE": "1"}
    command = [sys.executable, "-m", "minidual.cli", *words]
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )


def test_every_exception_is_a_printed_command() -> None:
    printed = {command for _, command in printed_commands()}
    assert {*REFUSED, *STOPPED, *SERVERS} - printed == set()


@pytest.mark.slow
@pytest.mark.parametrize("command", FORMS, ids=lambda command: command.replace("/", "."))
def test_a_printed_command_does_its_work(desk: Path, command: str) -> None:
    smaller = command
    for long, short in SMALLER.items():
        smaller = re.sub(long, short, smaller)
    words = shlex.split(smaller)[1:]
    if "--profile" not in words:
        words += ["--profile", "smoke"]
    before = {path: path.read_bytes() for path in desk.glob("runs/smoke/*/verdict.json")}
    code, said = REFUSED.get(command, (0, ""))
    if "CUDA" in said and late("torch").cuda.is_available():
        pytest.skip("there is a CUDA device here; these runs take hours")
    done = typed(desk, words)
    if done.returncode == 1 and command in STOPPED:
        code = 1
        said = STOPPED[command]
    assert done.returncode == code, f"{' '.join(words)}: {done.returncode}\n{done.stderr[-3000:]}"
    assert said in done.stderr
    assert len(before) == 8
    replaced = [path.parent.name for path, text in before.items() if path.read_bytes() != text]
    assert not replaced, f"{' '.join(words)} replaced {replaced}"
