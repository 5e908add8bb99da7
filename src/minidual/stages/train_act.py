"""`minidual train-act`: train a policy and check its checkpoint."""

from dataclasses import replace
from typing import Any

from minidual import durable, emergency
from minidual.config.learning import TrainConfig
from minidual.config.seeds import subseed
from minidual.gate.canonical import digest
from minidual.gate.check import Check, Rows
from minidual.gate.code import code_of
from minidual.gate.stage import StageContext, StageResult
from minidual.policies.demonstrations import load_demonstrations
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
from minidual.stages.words import worded


def train_checks(
    result: TrainResult,
    emitted: EmittedActions,
    config: TrainConfig,
    robot: Robot,
) -> list[Check]:
    """Return the stage's checks."""
    rows: Rows = {
        "loss_ratio": (result.loss_ratio, "<", config.loss_ratio_max),
        "actions_in_limits": (emitted.in_limits, ">=", config.actions_in_limits_min),
        "targets_n": (emitted.targets_n, "==", robot.dof + GRIPPERS_N),
        "steps_done": (result.steps, "==", result.steps_asked),
        **{name: getattr(result, name) for name in ("train_s", "samples_per_s", "parameters")},
        **{name: getattr(emitted, name) for name in ("overshoot_max_rad", "inference_hz")},
    }
    held_out = {
        name: getattr(result, name) for name in ("validation_l1", "validation_keyframe_rad")
    }
    return worded(
        "train-act",
        {**rows, **{name: value for name, value in held_out.items() if value is not None}},
    )


def run(context: StageContext) -> StageResult:
    """Train with every seed, reload each checkpoint as deployment does, and write records."""
    config = context.config.train
    robot = robot_from(context.config.robot)
    kind = POLICIES[config.policy]
    dataset = context.upstream["teleop-record"] / "lerobot"
    with context.progress.task("reading frames") as task:
        demos = load_demonstrations(dataset, config.cameras, task.advance, folder=context.folder)
    # Kept outside the temporary folder, so that an interrupted training resumes. Its name prevents reuse by other code,
    # a fingerprint of data, settings and seed in the file reuse by another training.
    code = digest(code_of([f"{type(kind).__module__}:train"]).modules)[:8]
    places = [
        context.folder.with_suffix(f".progress-{code}-{k + 1}") for k in range(config.seeds_n)
    ]
    for old in sorted(context.folder.parent.glob(f"{context.folder.stem}.progress*")):
        if not old.name.startswith(f"{context.folder.stem}.progress-{code}"):
            context.progress.note(
                f"a training of other code is now in {durable.set_aside(old, 'train-act.progress')}",
            )
    checks = list[Check]()
    all_records = list[dict[str, Any]]()
    notes = list[str]()
    for k, seed in enumerate(training_seeds(context.seed, config.seeds_n)):
        folder = context.folder if k == 0 else context.folder / f"seed-{k + 1}"
        folder.mkdir(exist_ok=True)
        with context.progress.task(
            f"training steps{f', seed {k + 1}' if k else ''}",
            config.steps,
        ) as task:

            def advance(steps: int, loss: float) -> None:
                task.advance(steps, f"loss {loss:.4f}")

            result = kind.train(
                Training(demos, config, seed, places[k], advance),
                folder / "checkpoint",
            )
        emitted = exercise_checkpoint(folder / "checkpoint", demos, robot, device=config.device)
        write_loss_csv(result.curve, folder / "loss.csv")
        draw_loss(result, folder / "loss.png")
        sizes = {c: list(demos.images[c].shape[1:3]) for c in demos.cameras}
        extra = {
            "policy": config.policy,
            "seed": seed,
            "cameras": sizes,
            "inference_hz": emitted.inference_hz,
        }
        all_records.append(write_train_json(result, extra, folder / "train.json"))
        prefix = f"seed_{k + 1}." if k else ""
        checks += [
            replace(check, name=prefix + check.name)
            for check in train_checks(result, emitted, config, robot)
        ]
        if k == 0:
            notes.append(
                f"policy: {config.policy}, {'bfloat16' if result.bf16 else 'float32'} image encoder",
            )
        if result.resumed_from_step:
            notes.append(
                f"{prefix}continued an interrupted training from step {result.resumed_from_step}",
            )
        if result.set_aside:
            notes.append(
                f"{prefix}an interrupted training did not fit; its progress was moved to {result.set_aside}",
            )
    if config.seeds_n == 1:
        notes.append("one training is one draw; `make learn` trains three seeds and compares them")
    emergency.check()  # the progress goes last: a stopped stage publishes nothing
    for place in places:
        durable.remove(place)
    return StageResult(
        checks=checks,
        data={**all_records[0], "seeds": all_records[1:]},
        notes=notes,
    )


def training_seeds(seed: int, count: int) -> list[int]:
    """Return the seeds of the trainings; the first is the run's."""
    return [seed, *(subseed(seed, "train.seeds", k) for k in range(1, count))]
