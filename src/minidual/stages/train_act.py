"""`minidual train-act`: train a policy and check its checkpoint."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from minidual.demos.schema import GRIPPERS_N
from minidual.gate.check import Check, Number, Op
from minidual.gate.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.learning import TrainConfig
    from minidual.policies.acceptance import EmittedActions
    from minidual.policies.records import TrainResult
    from minidual.robot.pair import Robot

_WORDS = {
    "loss_ratio": (
        "",
        "training L1 at the end over that of the first steps; it must have learned something",
        "raise train.steps, or look at loss.png for a learning rate that is too high",
    ),
    "actions_in_limits": (
        "",
        "share of joint targets inside the limits as the network gives them, before any clamping",
        "train longer; check that recording and normalisation use the same joint order",
    ),
    "targets_n": ("", "joint and gripper targets in one action of the reloaded policy", "record with these arms"),
    "train_s": ("s", "time spent in training steps", "lower train.steps, or train on a faster machine"),
    "steps_done": ("", "training must not have been cut by its time limit", "raise train.time_limit_s"),
}
"""Unit, reason and remedy of each limited check."""


def train_checks(result: TrainResult, emitted: EmittedActions, config: TrainConfig, robot: Robot) -> list[Check]:
    """Return the stage's checks."""
    limits: tuple[tuple[str, Number, Op, Number], ...] = (
        ("loss_ratio", result.loss_ratio, "<", config.loss_ratio_max),
        ("actions_in_limits", emitted.in_limits, ">=", config.actions_in_limits_min),
        ("targets_n", emitted.targets_n, "==", robot.dof + GRIPPERS_N),
        ("train_s", result.train_s, "<=", config.train_s_max),
        ("steps_done", result.steps, "==", result.steps_asked),
    )
    checks = [
        *(Check(name, observed, op, limit, *_WORDS[name]) for name, observed, op, limit in limits),
        Check("samples_per_s", result.samples_per_s, unit="1/s", why="training rate"),
        Check("parameters", result.parameters, why="trainable parameters"),
        Check("overshoot_max_rad", emitted.overshoot_max_rad, unit="rad", why="worst raw target outside its limit"),
        Check("inference_hz", emitted.inference_hz, unit="Hz", why="whole inferences a second, one thread"),
    ]
    if result.validation_l1 is not None:
        why = "held-out episodes, in std of the actions; L1 does not tell how a policy does in closed loop"
        checks.append(Check("validation_l1", result.validation_l1, why=why))
    if result.validation_keyframe_rad is not None:
        why = "mean joint error of the grasp and release postures predicted from images of held-out episodes"
        checks.append(Check("validation_keyframe_rad", result.validation_keyframe_rad, unit="rad", why=why))
    return checks


def run(context: StageContext) -> StageResult:
    """Train, reload the checkpoint as deployment does, and write records."""
    from minidual.policies import records
    from minidual.policies.acceptance import exercise_checkpoint
    from minidual.policies.demonstrations import load_demonstrations
    from minidual.policies.kinds import POLICIES
    from minidual.robot.arms import robot_from

    config, folder, robot = context.config.train, context.folder, robot_from(context.config.robot)
    kind = POLICIES[config.policy]
    kind.require(config.device)  # before the dataset is read: this is quick to mend
    with context.progress.task("reading frames") as task:
        demos = load_demonstrations(context.upstream["teleop-record"] / "lerobot", config.cameras, task.advance)
    # Kept outside the temporary folder, so that an interrupted training resumes. A fingerprint of data, settings and
    # seed prevents reuse by another training.
    resume = folder.parent / ".train-act.progress"
    with context.progress.task("training steps", config.steps) as task:

        def advance(steps: int, loss: float) -> None:
            task.advance(steps, f"loss {loss:.4f}")

        result = kind.train(demos, config, context.seed, folder / "checkpoint", resume_dir=resume, advance=advance)
    emitted = exercise_checkpoint(folder / "checkpoint", demos, robot, device=config.device)
    records.write_loss_csv(result.curve, folder / "loss.csv")
    records.draw_loss(result, folder / "loss.png")
    extra = {
        "policy": config.policy,
        "seed": context.seed,
        "cameras": {c: list(demos.images[c].shape[1:3]) for c in demos.cameras},
        "inference_hz": emitted.inference_hz,
    }
    record = records.write_train_json(result, extra, folder / "train.json")
    shutil.rmtree(resume, ignore_errors=True)
    notes = [f"policy: {config.policy}, {'bfloat16' if result.bf16 else 'float32'} image encoder"]
    if result.resumed_from_step:
        notes.append(f"continued an interrupted training from step {result.resumed_from_step}")
    if result.set_aside:
        notes.append(f"the progress of an interrupted training was damaged; it was moved to {result.set_aside}")
    return StageResult(checks=train_checks(result, emitted, config, robot), data=record, notes=notes)
