"""LeRobot's own commands, unmodified and offline, with the plug-ins in an environment of their own."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.support import lerobot_env

POLICY = lerobot_env.ROOT / "src" / "minidual" / "policies" / "shipped" / "act" / "rod_carry"
SMALL_NETWORK = (
    "--policy.chunk_size=20",
    "--policy.n_action_steps=20",
    "--policy.dim_model=64",
    "--policy.n_heads=4",
    "--policy.dim_feedforward=128",
    "--policy.n_encoder_layers=1",
    "--policy.use_vae=false",
    "--policy.device=cpu",
    "--policy.push_to_hub=false",
)
pytestmark = pytest.mark.slow


class Station:
    """An environment with the plug-ins, and a folder for what its commands write."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = lerobot_env.build(folder)
        self.dataset = folder / "rods"
        self.recorded = ""

    def run(self, name: str, *options: str, timeout_s: float = 900.0) -> str:
        """Run a command of LeRobot; return what it printed."""
        done = subprocess.run(
            [*lerobot_env.command(self.python, name), *options],
            cwd=self.folder,
            env=lerobot_env.environment(self.folder),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=timeout_s,
            check=False,
        )
        assert done.returncode == 0, done.stdout[-4000:]
        return done.stdout

    def train(self, policy: str, *options: str) -> Path:
        """Train three steps on the recorded dataset; return the checkpoint."""
        folder = self.folder / f"train-{policy}"
        self.run(
            "lerobot-train",
            "--dataset.repo_id=local/rods",
            f"--dataset.root={self.dataset}",
            f"--policy.type={policy}",
            *SMALL_NETWORK,
            *options,
            "--batch_size=4",
            "--steps=3",
            "--num_workers=0",
            "--env_eval_freq=0",
            f"--output_dir={folder}",
        )
        return folder / "checkpoints" / "last" / "pretrained_model"


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Station:
    """After `lerobot-record` of one scripted episode, long enough for a slow machine."""
    station = Station(tmp_path_factory.mktemp("lerobot"))
    station.recorded = station.run(
        "lerobot-record",
        "--robot.type=bi_minidual",
        "--teleop.type=minidual_leader",
        "--dataset.repo_id=local/rods",
        "--dataset.no_stamp=true",
        f"--dataset.root={station.dataset}",
        "--dataset.single_task=Carry the rod",
        "--dataset.fps=50",
        "--dataset.num_episodes=1",
        "--dataset.episode_time_s=90",
        "--dataset.push_to_hub=false",
        "--play_sounds=false",
    )
    return station


def test_record_writes_a_dataset_in_which_the_script_succeeds(station: Station) -> None:
    assert "rod_carry, start 0: success after" in station.recorded
    info = json.loads((station.dataset / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["robot_type"] == "bi_minidual"
    assert info["fps"] == 50
    assert info["features"]["action"]["names"][0] == "left_panda_joint1.pos"
    assert info["features"]["observation.images.cam_high"]["shape"] == [96, 128, 3]


def test_replay_does_what_was_recorded(station: Station) -> None:
    printed = station.run(
        "lerobot-replay",
        "--robot.type=bi_minidual",
        "--dataset.repo_id=local/rods",
        f"--dataset.root={station.dataset}",
        "--dataset.episode=0",
        "--play_sounds=false",
    )
    assert "rod_carry, start 0: success after" in printed


def test_teleoperate_moves_the_arms(station: Station) -> None:
    printed = station.run(
        "lerobot-teleoperate",
        "--robot.type=bi_minidual",
        "--robot.task=pot_lift",
        "--teleop.type=minidual_leader",
        "--fps=50",
        "--teleop_time_s=5",
    )
    assert "pot_lift, start 0: no success after" in printed


def test_eval_of_a_policy_of_the_package_succeeds(station: Station) -> None:
    station.run(
        "lerobot-eval",
        f"--policy.path={POLICY}",
        "--env.type=minidual",
        "--env.task=rod_carry",
        "--eval.n_episodes=1",
        "--eval.batch_size=1",
        f"--output_dir={station.folder / 'eval'}",
    )
    record = json.loads((station.folder / "eval" / "eval_info.json").read_text(encoding="utf-8"))
    assert record["overall"]["pc_success"] == 100.0


@pytest.mark.parametrize("policy", ["act", "spatial_act"])
def test_train_writes_a_checkpoint(station: Station, policy: str) -> None:
    weights = ["--policy.pretrained_backbone_weights=null"] if policy == "act" else []
    checkpoint = station.train(policy, *weights)
    config = json.loads((checkpoint / "config.json").read_text(encoding="utf-8"))
    assert config["type"] == policy
    assert (checkpoint / "model.safetensors").is_file()


def test_a_plug_in_that_is_not_installed_is_not_known(tmp_path: Path) -> None:
    """The environment of the tests themselves has none: the commands above found their own."""
    done = subprocess.run(
        [*lerobot_env.command(Path(lerobot_env.sys.executable), "lerobot-replay"), "--help"],
        env=lerobot_env.environment(tmp_path),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    installed = any("minidual" in path.name for path in installed_plugins())
    assert ("bi_minidual" in done.stdout) == installed


def installed_plugins() -> list[Path]:
    """Return what `make plugins` has put beside the libraries."""
    libraries = Path(lerobot_env.sysconfig.get_path("purelib"))
    return sorted(libraries.glob("lerobot_robot_minidual-*"))
