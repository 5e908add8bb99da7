"""`minidual train-act --dataset PATH`: train on any LeRobot v3 dataset, without a gate."""

import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from minidual import durable
from minidual.durable import expanded
from minidual.errors import DataError, ExitCode, UsageError
from minidual.gate.check import Check
from minidual.gate.criterion import Criterion
from minidual.gate.stage import ToolContext, ToolResult, aligned
from minidual.policies.demonstrations import Demonstrations, load_demonstrations
from minidual.policies.kinds import (
    POLICIES,
    ChunkPolicy,
    Training,
    TrainResult,
    load_policy,
    write_loss_csv,
    write_train_json,
)
from minidual.show.figures.training import draw_loss
from minidual.stages.train_act import LOSS_RATIO, STEPS_DONE

_INFO = Path("meta/info.json")
_WITHIN = ("", "lerobot", "teleop-record/lerobot")
"""Where a dataset lies in the folder of a dataset, of a recording, or of a run."""
_SAMPLES_N = 64
_HIGH_PX = 200
"""Height from which the pictures make a training on a CPU slow."""
_HEIGHT_MIN_PX = 8

IMITATES = Criterion(
    "action_error",
    "<",
    why="error of the reloaded policy's next action on recorded ticks, in std of the actions; "
    "the limit is that of always commanding the mean",
    remedy="raise train.steps, or look at loss.svg",
)


class Imitation(NamedTuple):
    """A reloaded policy on recorded ticks; errors in standard deviations of the actions."""

    action_error: float
    mean_error: float
    inference_hz: float


def dataset_folder(text: str) -> Path:
    """Return the LeRobot dataset at a path, or within the recording or run at the path.

    Raises:
        UsageError: There is none.
    """
    folder = expanded(text)
    for inner in _WITHIN:
        if (folder / inner / _INFO).is_file():
            return folder / inner
    if not folder.exists():
        raise UsageError(
            f"--dataset {text}: there is no such folder",
            remedy="name a folder on this machine: nothing is downloaded",
        )
    raise UsageError(
        f"--dataset {text}: there is no LeRobot dataset ({_INFO}) in that folder",
        remedy="HDF5 episodes become one with: minidual data merge FOLDER --out NEW",
    )


def train_dataset(context: ToolContext) -> ToolResult:
    """Train on a dataset, reload the checkpoint, and report its inputs.

    Raises:
        UsageError: No such dataset or camera, or a number is out of range.
        DataError: The dataset is damaged, or holds what no policy here takes.
    """
    options = context.options
    root = dataset_folder(str(options["dataset"]))
    own = replace(context, name=f"train-dataset/{_name_of(root)}")
    own.begin()
    with own.progress.task("reading frames") as bar:
        demos = load_demonstrations(
            root,
            _words(str(options.get("cameras") or "")),
            bar.advance,
            folder=own.output,
            height=_height(options.get("height")),
            inputs=own.config.train.inputs,
        )
    for note in _notes(demos):
        own.progress.note(note)
    result = _trained(own, demos)
    imitation = exercised(load_policy(own.output / "checkpoint", threads=1), demos)
    _write_records(own, root, result, imitation)
    own.publish()
    own.progress.note(f"checkpoint: {own.folder / 'checkpoint'}")
    checks = dataset_checks(result, imitation, own.config.train.loss_ratio_max)
    passed = all(check.passed is not False for check in checks)
    return ToolResult(
        _lines(demos, result, checks),
        data={
            "checkpoint": str(own.folder / "checkpoint"),
            "checks": [check.to_json() for check in checks],
            "takes": demos.takes.model_dump(mode="json") if demos.takes else {},
        },
        exit_code=ExitCode.PASS if passed else ExitCode.ACCEPTANCE_FAILED,
    )


def dataset_checks(
    result: TrainResult,
    imitation: Imitation,
    loss_ratio_max: float,
) -> list[Check]:
    """Return the checks of a training on a dataset."""
    return [
        LOSS_RATIO.check(result.loss_ratio, loss_ratio_max),
        STEPS_DONE.check(result.steps, result.steps_asked),
        IMITATES.check(imitation.action_error, imitation.mean_error),
    ]


def exercised(policy: ChunkPolicy, demos: Demonstrations) -> Imitation:
    """Compare a policy's next actions with those recorded, on evenly spaced ticks.

    Raises:
        DataError: An action is not finite, or has other entries.
    """
    rows = np.linspace(0, len(demos) - 1, min(_SAMPLES_N, len(demos))).astype(np.int64)
    predicted: list[np.ndarray] = []
    started = time.perf_counter()
    for row in rows:
        policy.reset()
        images = {camera: demos.images[camera][row] for camera in demos.cameras}
        policy.instruct(demos.instruction(row))
        predicted.append(policy.predict(images, demos.sensed[row])[0])
    inference_hz = len(rows) / (time.perf_counter() - started)
    actions = np.array(predicted)
    recorded = demos.action[rows].astype(float)
    if actions.shape != recorded.shape or not np.isfinite(actions).all():
        raise DataError(f"the reloaded policy gives actions {actions.shape} that are not usable")
    mean = demos.action.mean(axis=0)
    std = demos.action.std(axis=0)
    moving = std > 1e-6 * max(1.0, float(np.abs(mean).max()))
    if not moving.any():
        raise DataError("no entry of the recorded actions changes: there is nothing to learn")
    scale = std[moving]
    return Imitation(
        action_error=float((np.abs(actions - recorded)[:, moving] / scale).mean()),
        mean_error=float((np.abs(mean - recorded)[:, moving] / scale).mean()),
        inference_hz=inference_hz,
    )


def _trained(context: ToolContext, demos: Demonstrations) -> TrainResult:
    config = context.config.train
    place = context.folder.with_name(f"{context.folder.name}.progress")
    durable.make_folder(place.parent)
    steps = config.steps if config.budget_s is None else None
    with context.progress.task("training steps", steps) as bar:

        def advance(steps: int, loss: float) -> None:
            bar.advance(steps, f"loss {loss:.4f}")

        training = Training(demos, config, context.seed, place, advance)
        result = POLICIES[config.policy].train(training, context.output / "checkpoint")
    if result.resumed_from_step:
        context.progress.note(f"went on from step {result.resumed_from_step}")
    durable.remove(place)
    return result


def _write_records(
    context: ToolContext,
    root: Path,
    result: TrainResult,
    imitation: Imitation,
) -> None:
    write_loss_csv(result.curve, context.output / "loss.csv")
    draw_loss(result, context.output / "loss.svg")
    extra = {
        "dataset": str(root),
        "policy": context.config.train.policy,
        "seed": context.seed,
        **imitation._asdict(),
    }
    write_train_json(result, extra, context.output / "train.json")


def _notes(demos: Demonstrations) -> list[str]:
    """Return the notes for a user before the training begins."""
    notes: list[str] = []
    heights = [demos.images[camera].shape[1] for camera in demos.cameras]
    if max(heights) > _HIGH_PX:
        notes.append(
            f"pictures of {max(heights)} rows make a training on a CPU slow: "
            "--height 96 scales them down",
        )
    if not demos.switching:
        notes.append("no entry named 'gripper' is measured and commanded: no keyframes are learned")
    return notes


def _lines(demos: Demonstrations, result: TrainResult, checks: Sequence[Check]) -> list[str]:
    rows = [
        {
            "check": check.name,
            "observed": f"{check.observed:.4g}",
            "limit": f"{check.op} {check.limit:.4g}",
            "result": "pass" if check.passed else "FAIL",
        }
        for check in checks
    ]
    takes = [] if demos.takes is None else demos.takes.text()
    episodes_n = len(result.training_episodes) + len(result.validation_episodes)
    return [
        f"trained on {episodes_n} episodes, {len(demos)} ticks",
        *(f"  {line}" for line in takes),
        *aligned(rows),
    ]


def _name_of(root: Path) -> str:
    """Return a name for the output: that of the dataset, or of the run that it lies in."""
    absolute = root.absolute()
    parts = [part for part in absolute.parts if part not in ("lerobot", "teleop-record")]
    return re.sub(r"[^\w.-]", "_", parts[-1]) or "dataset"


def _words(typed: str) -> list[str]:
    return [word.strip() for word in typed.split(",") if word.strip()]


def _height(typed: object) -> int | None:
    if typed is None:
        return None
    height = int(str(typed))
    if height < _HEIGHT_MIN_PX:
        raise UsageError(f"--height is {height}; pictures have at least {_HEIGHT_MIN_PX} rows")
    return height
