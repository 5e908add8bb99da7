"""Make a policy that comes with the package, from that of a run, and measure it.

python -m scripts.ship_policy runs/standard --trials 100
python -m scripts.ship_policy runs/standard --method rl --task pot_lift --trials 100
"""

import argparse
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from minidual.config.loader import load_config
from minidual.config.root import changed
from minidual.durable import read_json, remove, write_text
from minidual.errors import UsageError
from minidual.gate.canonical import file_sha256
from minidual.policies.act import ActKind
from minidual.policies.halved import halve
from minidual.policies.kinds import POLICIES
from minidual.policies.shipped import BYTES_MAX, FOLDER, RECORD
from minidual.tasks.catalogue import make_task
from minidual.trials.benchmark import draw_under
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import run_trials
from minidual.trials.statistics import wilson_interval

PURPOSE = "shipped"
"""Random stream of the starts, used by no stage and no training."""
WORKERS = 2


class Trained(NamedTuple):
    """A policy of a run.

    Attributes:
        method, task: What it drives.
        conditions: On which it is measured.
        write: Writes its checkpoint into a new folder.
        training: What the record says of its training.
    """

    method: str
    task: str
    conditions: tuple[str, ...]
    write: Callable[[Path], None]
    training: dict[str, Any]


def by_imitation(run: Path) -> Trained:
    """Return the policy of train-act; its weights are halved."""
    recorded = yaml.safe_load((run / "teleop-record" / "config.yaml").read_text("utf-8"))
    checkpoint = run / "train-act" / "checkpoint"
    training = read_json(run / "train-act" / "train.json")
    return Trained(
        "act",
        recorded["task"],
        (CLEAN, "room"),
        lambda folder: halve(checkpoint, folder),
        {
            "training": read_json(run / "train-act" / "verdict.json")["digest"],
            "network": network_of(checkpoint),
            "parameters": training["parameters"],
            "training_steps": training["steps"],
            "episodes": len(training["training_episodes"]) + len(training["validation_episodes"]),
        },
    )


def by_reinforcement(run: Path, task: str) -> Trained:
    """Return the policy of `train rl`."""
    trained = run / "train" / "rl" / task
    training = read_json(trained / "training.json")
    return Trained(
        "rl",
        task,
        (CLEAN, "randomised"),
        lambda folder: copy(trained / "checkpoint", folder),
        {
            "training": file_sha256(trained / "checkpoint" / "model.safetensors"),
            "network": "two layers",
            "parameters": training["parameters"],
            "training_steps": training["steps"],
            "demonstrated_actions": training["demonstrated_actions"],
        },
    )


def copy(checkpoint: Path, folder: Path) -> None:
    """Copy a checkpoint."""
    shutil.copytree(checkpoint, folder)


def main() -> None:
    """Write the policy's folder and its record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--method", choices=("act", "rl"), default="act")
    parser.add_argument("--task", default="pot_lift", help="of --method rl")
    parser.add_argument("--trials", type=int, default=100)
    options = parser.parse_args()
    run: Path = options.run
    trained = by_imitation(run) if options.method == "act" else by_reinforcement(run, options.task)
    folder = FOLDER / trained.method / trained.task
    remove(folder)
    trained.write(folder)
    record: dict[str, object] = {
        "task": trained.task,
        "made_by": f"python -m scripts.ship_policy RUN --method {trained.method}",
        "measured_at": git_commit(),
        **trained.training,
    }
    record["success"] = {
        condition: measure(trained, folder, condition, options.trials)
        for condition in trained.conditions
    }
    write_text(folder / RECORD, json.dumps(record, indent=2) + "\n")
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(json.dumps(record, indent=2))
    print(f"{folder}: {size} bytes; at most {BYTES_MAX}")
    if size > BYTES_MAX:
        raise SystemExit(1)


def network_of(checkpoint: Path) -> str:
    """Return the name of a checkpoint's network.

    Raises:
        UsageError: The policy is of a kind that is not shipped.
    """
    name = read_json(checkpoint / "config.json")["type"]
    kind = POLICIES[name]
    if not isinstance(kind, ActKind):
        raise UsageError(f"a policy of the kind '{name}' is not shipped")
    return kind.architecture(kind.read(checkpoint).policy.config).name


def measure(
    trained: Trained,
    checkpoint: Path,
    condition: str,
    trials_n: int,
) -> dict[str, object]:
    """Return the success of a policy on starts that nothing else uses."""
    config = changed(load_config("standard", []).config, {"task": trained.task})
    task = make_task(config)
    inputs = MethodInputs(task.config, config.seed, checkpoint, trained.task)
    draw = draw_under(inputs, condition, PURPOSE)
    trials = [draw(index) for index in range(trials_n)]
    results = list(run_trials(trained.method, inputs, trials, workers=WORKERS, condition=condition))
    successes_n = sum(result.success for result in results)
    low, high = wilson_interval(successes_n, trials_n)
    return {
        "successes": successes_n,
        "trials": trials_n,
        "interval_95": [round(low, 3), round(high, 3)],
        "starts": f"{PURPOSE} 0 to {trials_n - 1}",
    }


def git_commit() -> str:
    """Return the commit that the working tree stands at."""
    words = ["git", "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()
