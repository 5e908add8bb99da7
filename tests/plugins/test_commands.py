"""LeRobot's own commands, unmodified and offline, with the plug-ins in an environment of their own."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.support import lerobot_env

POLICY = lerobot_env.ROOT / "src" / "minidual" / "policies" / "shipped" / "act" / "rod_carry"
CHECKPOINT = Path("outputs/train/checkpoints/last/pretrained_model")
SMALL_NETWORK = (
    "--policy.dim_model=64",
    "--policy.n_heads=4",
    "--policy.dim_feedforward=128",
    "--policy.n_encoder_layers=1",
    "--policy.use_vae=false",
)
FEW_STEPS = ("--batch_size=4", "--steps=3", "--num_workers=0", *SMALL_NETWORK)
SMALLER = {
    r"lerobot-record .*": r"\g<0> --dataset.num_episodes=1 --dataset.episode_time_s=90 --robot.episode_time_s=90",
    r"lerobot-train .*": rf"\g<0> {' '.join(FEW_STEPS)}",
    r"lerobot-eval .*": r"\g<0> --eval.n_episodes=1 --eval.batch_size=1 --output_dir=outputs/eval",
    r"teleop_time_s=\d+": "teleop_time_s=5",
}
"""What makes a printed line short; an episode is long enough for a slow machine."""
SAYS = {
    "lerobot-record": "rod_carry, start 0: success after",
    "lerobot-replay": "rod_carry, start 0: success after",
    "lerobot-train": "End of training",
    "lerobot-eval": "End of eval",
    "lerobot-teleoperate": "pot_lift, start 0: no success after",
}
pytestmark = pytest.mark.slow


class Desk:
    """An environment with the plug-ins, and a folder for what its commands write."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = lerobot_env.build(folder)
        (folder / "examples").symlink_to(lerobot_env.ROOT / "examples")

    def lerobot(self, line: str) -> str:
        """Type a line of LeRobot; return what it printed."""
        name, *options = shlex.split(line)
        return self._typed([*lerobot_env.command(self.python, name), *options])

    def minidual(self, line: str) -> str:
        """Type a line of minidual, in the environment of the tests; return what it printed."""
        return self._typed([sys.executable, "-m", "minidual.cli", *shlex.split(line)])

    def _typed(self, words: list[str]) -> str:
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=lerobot_env.environment(self.folder),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=1200,
            check=False,
        )
        assert done.returncode == 0, done.stdout[-4000:]
        return done.stdout


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Desk:
    return Desk(tmp_path_factory.mktemp("lerobot"))


def shortened(line: str) -> str:
    for long, short in SMALLER.items():
        line = re.sub(long, short, line)
    return line


@pytest.mark.parametrize("line", lerobot_env.printed_lines(), ids=lambda line: line.split()[0])
def test_a_printed_line_does_its_work(desk: Desk, line: str) -> None:
    """In the order of the pages: what one records is trained on and replayed."""
    (desk.folder / "outputs").mkdir(exist_ok=True)
    name = line.split()[0]
    if name == "lerobot-train" and (desk.folder / "outputs" / "train").exists():
        pytest.skip("another page prints it too, and it has run")
    assert SAYS[name] in desk.lerobot(shortened(line))


def test_the_pages_print_each_command() -> None:
    assert {line.split()[0] for line in lerobot_env.printed_lines()} == set(SAYS)


def test_what_was_recorded_has_our_names(desk: Desk) -> None:
    path = desk.folder / "outputs" / "rods" / "meta" / "info.json"
    info = json.loads(path.read_text(encoding="utf-8"))
    assert info["robot_type"] == "bi_minidual"
    assert info["fps"] == 50
    assert info["features"]["action"]["names"][0] == "left_panda_joint1.pos"
    assert info["features"]["observation.images.cam_high"]["shape"] == [96, 128, 3]


def test_a_policy_of_the_package_succeeds_in_eval(desk: Desk) -> None:
    line = f"lerobot-eval --policy.path={POLICY} --env.type=minidual --output_dir=outputs/shipped"
    desk.lerobot(f"{line} --eval.n_episodes=1 --eval.batch_size=1")
    path = desk.folder / "outputs" / "shipped" / "eval_info.json"
    assert json.loads(path.read_text(encoding="utf-8"))["overall"]["pc_success"] == 100.0


def test_our_own_policy_is_trained_by_lerobot_train(desk: Desk) -> None:
    line = "lerobot-train --config_path=examples/lerobot-train.yaml --policy.type=spatial_act"
    desk.lerobot(f"{line} {' '.join(FEW_STEPS)} --output_dir=outputs/spatial")
    folder = desk.folder / "outputs" / "spatial" / "checkpoints" / "last" / "pretrained_model"
    assert json.loads((folder / "config.json").read_text())["type"] == "spatial_act"


def test_minidual_drives_with_what_lerobot_trained(desk: Desk) -> None:
    """Three steps teach nothing: the trial fails, and it is judged."""
    printed = desk.minidual(f"try rod_carry --method act --checkpoint {CHECKPOINT} --trials 1")
    assert "0 of 1" in printed


def test_a_plug_in_that_is_not_installed_is_not_known() -> None:
    """The environment of the tests itself has none: the commands above found their own."""
    installed = sorted(Path(sysconfig.get_path("purelib")).glob("lerobot_robot_minidual-*"))
    done = subprocess.run(
        [*lerobot_env.command(Path(sys.executable), "lerobot-replay"), "--help"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ("bi_minidual" in done.stdout) == bool(installed)
