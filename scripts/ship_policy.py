"""Make the policy of a task that comes with the package, from that of a run, and measure it.

python -m scripts.ship_policy runs/standard --trials 100
"""

import argparse
import json
import subprocess
from pathlib import Path

import yaml

from minidual.config.loader import load_config
from minidual.config.root import changed
from minidual.durable import read_json, remove, write_text
from minidual.errors import UsageError
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
CONDITIONS = (CLEAN, "room")
WORKERS = 2


def main() -> None:
    """Write the policy's folder and its record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--trials", type=int, default=100)
    arguments = parser.parse_args()
    run: Path = arguments.run
    recorded = yaml.safe_load((run / "teleop-record" / "config.yaml").read_text("utf-8"))
    task = recorded["task"]
    folder = FOLDER / "act" / task
    remove(folder)
    halve(run / "train-act" / "checkpoint", folder)
    training = read_json(run / "train-act" / "train.json")
    record: dict[str, object] = {
        "task": task,
        "made_by": "python -m scripts.ship_policy RUN",
        "measured_at": git_commit(),
        "training": read_json(run / "train-act" / "verdict.json")["digest"],
        "network": network_of(folder),
        "parameters": training["parameters"],
        "training_steps": training["steps"],
        "episodes": len(training["training_episodes"]) + len(training["validation_episodes"]),
    }
    record["success"] = {name: measure(task, folder, name, arguments.trials) for name in CONDITIONS}
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


def measure(task_name: str, checkpoint: Path, condition: str, trials_n: int) -> dict[str, object]:
    """Return the success of a policy on starts that nothing else uses."""
    config = changed(load_config("standard", []).config, {"task": task_name})
    task = make_task(config)
    inputs = MethodInputs(task.config, config.seed, checkpoint, task_name)
    draw = draw_under(inputs, condition, PURPOSE)
    trials = [draw(index) for index in range(trials_n)]
    results = list(run_trials("act", inputs, trials, workers=WORKERS, condition=condition))
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
