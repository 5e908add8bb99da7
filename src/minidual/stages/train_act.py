"""`minidual train-act`: train a policy and check its checkpoint."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from minidual import durable, emergency
from minidual.config.learning import TrainConfig
from minidual.config.seeds import subseed
from minidual.gate.canonical import digest
from minidual.gate.check import Check
from minidual.gate.code import code_of
from minidual.gate.criterion import Criterion
from minidual.gate.stage import StageContext, StageResult
from minidual.policies.demonstrations import Demonstrations, joined, load_demonstrations
from minidual.policies.kinds import (
    POLICIES,
    Training,
    TrainResult,
    write_loss_csv,
    write_train_json,
)
from minidual.policies.policy import EmittedActions, exercise_checkpoint
from minidual.robot.pair import GRIPPERS_N, Robot, robot_from
from minidual.show.figures.training import draw_loss

LOSS_RATIO = Criterion(
    "loss_ratio",
    "<",
    why="training L1 at the end over that of the first steps; it must have learned something",
    remedy="raise train.steps, or look at loss.svg for a learning rate that is too high",
)
ACTIONS_IN_LIMITS = Criterion(
    "actions_in_limits",
    ">=",
    why="share of joint targets inside the limits as the network gives them, before any clamping",
    remedy="train longer; check that recording and normalisation use the same joint order",
)
TARGETS_N = Criterion(
    "targets_n",
    "==",
    why="joint and gripper targets in one action of the reloaded policy",
    remedy="record with these arms",
)
STEPS_DONE = Criterion(
    "steps_done",
    "==",
    why="training must not have been cut by its time limit",
    remedy="raise train.time_limit_s",
)
TRAIN_TIME = Criterion("train_s", unit="s", why="time spent in training steps", clocked=True)
SAMPLE_RATE = Criterion("samples_per_s", unit="1/s", why="training rate", clocked=True)
PARAMETERS = Criterion("parameters", why="trainable parameters")
OVERSHOOT_MAX = Criterion(
    "overshoot_max_rad",
    unit="rad",
    why="worst raw target outside its limit",
)
INFERENCE_RATE = Criterion(
    "inference_hz",
    unit="Hz",
    why="whole inferences in a second of processor time, one thread",
    clocked=True,
)
VALIDATION_L1 = Criterion(
    "validation_l1",
    why="held-out episodes, in std of the actions; "
    "L1 does not tell how a policy does in closed loop",
)
VALIDATION_KEYFRAME = Criterion(
    "validation_keyframe_rad",
    unit="rad",
    why="mean joint error of the grasp and release postures "
    "predicted from images of held-out episodes",
)


def train_checks(
    result: TrainResult,
    emitted: EmittedActions,
    config: TrainConfig,
    robot: Robot,
) -> list[Check]:
    """Return the checks of one training; validation only with held-out episodes."""
    checks = [
        LOSS_RATIO.check(result.loss_ratio, config.loss_ratio_max),
        *action_checks(emitted, config, robot),
        STEPS_DONE.check(result.steps, result.steps_asked),
        TRAIN_TIME.report(result.train_s),
        SAMPLE_RATE.report(result.samples_per_s),
        PARAMETERS.report(result.parameters),
        OVERSHOOT_MAX.report(emitted.overshoot_max_rad),
        INFERENCE_RATE.report(emitted.inference_hz),
    ]
    if result.validation_l1 is not None:
        checks.append(VALIDATION_L1.report(result.validation_l1))
    if result.validation_keyframe_rad is not None:
        checks.append(VALIDATION_KEYFRAME.report(result.validation_keyframe_rad))
    return checks


def action_checks(emitted: EmittedActions, config: TrainConfig, robot: Robot) -> list[Check]:
    """Return the checks of a reloaded checkpoint's commands."""
    return [
        ACTIONS_IN_LIMITS.check(emitted.in_limits, config.actions_in_limits_min),
        TARGETS_N.check(emitted.targets_n, robot.dof + GRIPPERS_N),
    ]


def run(context: StageContext) -> StageResult:
    """Train with every seed, reload each checkpoint as deployment does, and write records."""
    config = context.config.train
    dataset = context.upstream["teleop-record"] / "lerobot"
    with context.progress.task("reading frames") as task:
        demos = load_demonstrations(
            dataset,
            config.cameras,
            task.advance,
            folder=context.folder,
            inputs=config.inputs,
        )
        corrections = [
            load_demonstrations(
                durable.expanded(folder),
                config.cameras,
                task.advance,
                inputs=config.inputs,
            )
            for folder in config.corrections
        ]
        if corrections:
            demos = joined([demos, *corrections])
    places = _progress_places(context)
    checks: list[Check] = []
    records: list[dict[str, Any]] = []
    notes: list[str] = []
    for k, seed in enumerate(training_seeds(context.seed, config.seeds_n)):
        result, emitted = _train(context, demos, k, seed, places[k])
        records.append(_write_records(context, demos, k, seed, result, emitted))
        robot = robot_from(context.config.robot)
        prefix = f"seed_{k + 1}." if k else ""
        checks += [
            replace(check, name=prefix + check.name)
            for check in train_checks(result, emitted, config, robot)
        ]
        if k == 0:
            precision = "bfloat16" if result.bf16 else "float32"
            name = records[0]["architecture"]
            notes.append(f"policy: {name}, {precision} image encoder")
        notes += _interruption_notes(result, prefix)
    if config.seeds_n == 1:
        notes.append("one training is one draw; `make learn` trains three seeds and compares them")
    emergency.check()  # the progress goes last: a stopped stage publishes nothing
    for place in places:
        durable.remove(place)
    return StageResult(
        checks=checks,
        data={**records[0], "seeds": records[1:]},
        notes=notes,
    )


def _progress_places(context: StageContext) -> list[Path]:
    """Return where each training keeps its progress; set progress of other code aside.

    The files are outside the temporary folder, so that an interrupted training resumes. Their
    names prevent reuse by other code. A fingerprint of data, settings and seed inside prevents
    reuse by another training.
    """
    config = context.config.train
    kind = POLICIES[config.policy]
    code = digest(code_of([f"{type(kind).__module__}:train"]).modules)[:8]
    prefix = f"{context.folder.stem}.progress-{code}"
    for old in sorted(context.folder.parent.glob(f"{context.folder.stem}.progress*")):
        if not old.name.startswith(prefix):
            place = durable.set_aside(old, "train-act.progress")
            context.progress.note(f"a training of other code is now in {place}")
    return [context.folder.with_suffix(f".progress-{code}-{k + 1}") for k in range(config.seeds_n)]


def _training_folder(context: StageContext, k: int) -> Path:
    """Return the folder of the k-th training; the first is the stage's."""
    return context.folder if k == 0 else context.folder / f"seed-{k + 1}"


def _train(
    context: StageContext,
    demos: Demonstrations,
    k: int,
    seed: int,
    place: Path,
) -> tuple[TrainResult, EmittedActions]:
    """Train, and run the checkpoint on the dataset."""
    config = context.config.train
    folder = _training_folder(context, k)
    folder.mkdir(exist_ok=True)
    steps = config.steps if config.budget_s is None else None
    description = f"training steps, seed {k + 1}" if k else "training steps"
    with context.progress.task(description, steps) as task:

        def advance(steps: int, loss: float) -> None:
            task.advance(steps, f"loss {loss:.4f}")

        training = Training(demos, config, seed, place, advance)
        result = POLICIES[config.policy].train(training, folder / "checkpoint")
    robot = robot_from(context.config.robot)
    emitted = exercise_checkpoint(folder / "checkpoint", demos, robot, device=config.device)
    return result, emitted


def _write_records(
    context: StageContext,
    demos: Demonstrations,
    k: int,
    seed: int,
    result: TrainResult,
    emitted: EmittedActions,
) -> dict[str, Any]:
    """Write loss.csv, loss.svg and train.json; return the content of train.json."""
    folder = _training_folder(context, k)
    write_loss_csv(result.curve, folder / "loss.csv")
    draw_loss(result, folder / "loss.svg")
    cameras = {name: list(demos.images[name].shape[1:3]) for name in demos.cameras}
    extra = {
        "policy": context.config.train.policy,
        "architecture": result.architecture or context.config.train.policy,
        "seed": seed,
        "cameras": cameras,
        "inputs": demos.inputs,
        "inference_hz": emitted.inference_hz,
    }
    return write_train_json(result, extra, folder / "train.json")


def _interruption_notes(result: TrainResult, prefix: str) -> list[str]:
    notes = []
    if result.resumed_from_step:
        notes.append(
            f"{prefix}continued an interrupted training from step {result.resumed_from_step}",
        )
    if result.set_aside:
        notes.append(
            f"{prefix}an interrupted training did not fit; "
            f"its progress was moved to {result.set_aside}",
        )
    return notes


def training_seeds(seed: int, count: int) -> list[int]:
    """Return the seeds of the trainings; the first is the run's."""
    return [seed, *(subseed(seed, "train.seeds", k) for k in range(1, count))]
