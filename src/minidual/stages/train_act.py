"""`minidual train-act`: train ACT on the recorded demonstrations and check what the checkpoint emits."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.learning import TrainConfig
    from minidual.policies.acceptance import EmittedActions
    from minidual.policies.train import TrainResult

JOINTS_N = 14
GRIPPERS_N = 2


def train_checks(result: TrainResult, emitted: EmittedActions, config: TrainConfig) -> list[Check]:
    """Return the checks of the stage: three acceptance limits, what guards them, and numbers without a limit."""
    checks = [
        Check(
            "loss_ratio",
            result.loss_ratio,
            "<",
            config.loss_ratio_max,
            "",
            "training L1 at the end over that of the first steps; it must have learned something",
            "raise train.steps, or look at loss.png for a learning rate that is too high",
        ),
        Check(
            "actions_in_limits",
            emitted.in_limits,
            ">=",
            config.actions_in_limits_min,
            "",
            "share of joint targets inside the limits as the network gives them, before any clamping",
            "train longer; check that recording and normalisation use the same joint order",
        ),
        Check(
            "train_s",
            result.train_s,
            "<=",
            config.train_s_max,
            "s",
            "time spent in training steps",
            "lower train.steps, or train on a faster machine",
        ),
        Check(
            "actions_in_limits_emitted",
            emitted.in_limits_emitted,
            "==",
            1.0,
            "",
            "share of joint targets inside the limits as they leave the runtime, which clamps",
        ),
        Check(
            "joint_targets_n",
            emitted.joints_n,
            "==",
            JOINTS_N,
            "",
            "joint targets in one action of the reloaded policy",
        ),
        Check("gripper_targets_n", emitted.grippers_n, "==", GRIPPERS_N, "", "gripper commands in one action"),
        Check(
            "steps_done",
            result.steps,
            "==",
            result.steps_asked,
            "",
            "training must not have been cut by its time limit",
            "raise train.time_limit_s or lower train.steps",
        ),
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
    """Read the dataset, train, reload the checkpoint as deployment does, and write the records."""
    from minidual.policies.factory import require_device

    config = context.config.train
    require_device(config.device)  # before the dataset is read: this is quick to mend

    from minidual.policies.acceptance import exercise_checkpoint
    from minidual.policies.dataset import load_demonstrations
    from minidual.policies.records import draw_loss, write_loss_csv, write_train_json
    from minidual.policies.train import train
    from minidual.robot.arms import robot_from

    with context.progress.task("reading frames") as task:
        demos = load_demonstrations(context.upstream["teleop-record"] / "lerobot", config.cameras, task.advance)
    checkpoint = context.folder / "checkpoint"
    # Beside the temporary folder, which the next attempt empties: an interrupted training goes on from here.
    # The file carries a fingerprint of data, settings and seed, so it is never used for another training.
    resume = context.folder.parent / ".train-act.progress"
    with context.progress.task("training steps", config.steps) as task:
        result = train(
            demos,
            config,
            context.seed,
            checkpoint,
            resume_dir=resume,
            advance=lambda steps, loss: task.advance(steps, f"loss {loss:.4f}"),
        )
    robot = robot_from(context.config.robot)
    emitted = exercise_checkpoint(checkpoint, demos, robot.q_lower, robot.q_upper, device=config.device)

    write_loss_csv(result.curve, context.folder / "loss.csv")
    draw_loss(result, context.folder / "loss.png")
    extra = {
        "backbone": config.backbone,
        "seed": context.seed,
        "cameras": {c: list(demos.images[c].shape[1:3]) for c in demos.cameras},
        "inference_hz": emitted.inference_hz,
    }
    record = write_train_json(result, extra, context.folder / "train.json")
    shutil.rmtree(resume, ignore_errors=True)
    notes = [f"image encoder: {config.backbone}, {'bfloat16' if result.bf16 else 'float32'} convolutions"]
    if result.resumed_from_step:
        notes.append(f"continued an interrupted training from step {result.resumed_from_step}")
    return StageResult(checks=train_checks(result, emitted, config), data=record, notes=notes)
