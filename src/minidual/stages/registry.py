"""Tables of stages, in the order in which they run, and of tools.

Their commands with options, help and examples are functions in `minidual.cli.commands`. Other
distributions add stages through the entry point group `minidual.stages` (docs/howto-stage.md).
"""

from minidual.gate.table import StageEntry, StageTable, ToolEntry
from minidual.stages import functions

LIBRARIES = (
    "numpy",
    "scipy",
    "mujoco",
    "pin",
    "coal",
    "ompl",
    "torch",
    "lerobot",
    "h5py",
    "av",
    "gymnasium",
)
"""Distributions whose versions verdicts record."""

_TASK_LAYOUT = tuple(
    f"scene.task.{name}"
    for name in (
        "start_xy_m",
        "start_range_m",
        "goal_xy_m",
        "goal_yaw_rad",
        "goal_range_m",
        "distance_m",
        "turn_rad",
        "obstacle",
    )
)
"""Settings that place the objects, the obstacle, the marks and the cameras."""
_TASK_MOTION = tuple(
    f"scene.task.{name}"
    for name in (
        "start_range_rad",
        "goal_range_rad",
        "lift_height_m",
        "clear_height_m",
        "tilt_max_rad",
    )
)
"""Further settings that planning a carry reads; those of the judge are not among them."""
_CARRY_SETTINGS = {
    "trials": "carry.trials_n",
    "object": "carry.object",
    "motion": "carry.motion",
}

ENV_CHECK = StageEntry(
    "env-check",
    functions.env_check,
    requires=(),
    summary=(
        "Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries"
    ),
    reads=(
        "robot",
        "plant",
        "env_check",
        "scene.physics",
        "scene.object",
        "scene.more",
        "scene.marks",
        "scene.camera",
        *_TASK_LAYOUT,
        "arbiter",
        "supervisor",
        "teleop.rate_hz",
    ),
    watchable=True,
    check=functions.check_plant,
    settings={"plant": "plant.address"},
    asides=(ToolEntry("env-check-bill", functions.env_check_bill),),
)
PLAN = StageEntry(
    "plan",
    functions.plan,
    requires=("env-check",),
    summary="Plan collision-free motions for left_arm, right_arm and both_arms",
    reads=(
        "robot",
        "plan",
        "scene.physics",
        "scene.object",
        "scene.more",
        *_TASK_LAYOUT,
        *_TASK_MOTION,
    ),
    check=functions.check_plan,
    inputs={},
    watchable=True,
    settings={"queries": "plan.queries_n"},
    asides=(
        ToolEntry("plan-acm", functions.plan_acm),
        ToolEntry("plan-once", functions.plan_once, watchable=True),
        ToolEntry(
            "plan-task",
            functions.plan_task,
            watchable=True,
            moves=True,
            shared=True,
        ),
    ),
)
CARRY = StageEntry(
    "carry",
    functions.carry,
    requires=("plan",),
    summary="Carry an object with both arms under object impedance control",
    reads=("robot", "task", "carry", "scene", "arbiter", "supervisor"),
    resolve=functions.task_config,
    check=functions.check_carry,
    inputs={},
    watchable=True,
    settings={**_CARRY_SETTINGS, "speed": "arbiter.speed_override"},
    asides=(
        ToolEntry(
            "carry-perturb",
            functions.carry_perturb,
            moves=True,
            watchable=True,
            settings=_CARRY_SETTINGS,
        ),
        ToolEntry(
            "carry-tune",
            functions.carry_tune,
            moves=True,
            settings={"object": "carry.object", "motion": "carry.motion"},
        ),
    ),
)
TELEOP_RECORD = StageEntry(
    "teleop-record",
    functions.teleop_record,
    requires=("carry",),
    summary="Teleoperate, record demonstrations, convert and grade the dataset",
    reads=("robot", "task", "teleop", "plan.planner", "scene", "arbiter", "supervisor"),
    resolve=functions.task_config,
    check=functions.check_leader,
    inputs={},
    keeps=("episodes", "rejected", "attempts", "inputs.json"),
    watchable=True,
    settings={
        "episodes": "teleop.episodes_n",
        "task": "task",
        "correct": "teleop.correct",
        "network": "teleop.link.network",
    },
)
TRAIN_ACT = StageEntry(
    "train-act",
    functions.train_act,
    requires=("teleop-record",),
    summary="Train the policy on the recorded dataset",
    reads=("robot", "train"),
    check=functions.check_policy,
    inputs={"teleop-record": ("lerobot/*",)},
    settings={"seeds": "train.seeds_n"},
    asides=(
        ToolEntry(
            "train-dataset",
            functions.train_dataset,
            settings={"steps": "train.steps"},
        ),
    ),
)
DEPLOY = StageEntry(
    "deploy",
    functions.deploy,
    requires=("carry", "train-act"),
    summary="Let the policy drive the arms on seeds it never saw",
    reads=(
        "robot",
        "task",
        "deploy",
        "scene",
        "arbiter",
        "supervisor",
        "teleop.rate_hz",
        "teleop.following",
        "teleop.leader",
    ),
    resolve=functions.deploy_config,
    check=functions.check_deploy,
    needs=functions.deploy_needs,
    inputs={
        "carry": (),
        "train-act": ("checkpoint/*", "seed-*/checkpoint/*"),
        "teleop-record": ("episodes/*",),
    },
    watchable=True,
    settings={"trials": "deploy.trials", "task": "task", "policy": "deploy.policy"},
)
BENCHMARK = StageEntry(
    "benchmark",
    functions.benchmark,
    requires=("carry", "deploy"),
    summary=(
        "Compare the methods on the same tasks, seeds and success tests, undisturbed and disturbed"
    ),
    reads=(
        "robot",
        "task",
        "benchmark",
        "carry",
        "plan.planner",
        "deploy",
        "scene",
        "arbiter",
        "supervisor",
    ),
    resolve=functions.benchmark_config,
    check=functions.check_benchmark,
    needs=functions.benchmark_needs,
    compares="benchmark.methods",
    # The recording's task is a parameter of its verdict.
    inputs={"train-act": ("checkpoint/*", "train.json"), "teleop-record": ()},
    watchable=True,
    settings={
        "tasks": "benchmark.tasks",
        "methods": "benchmark.methods",
        "conditions": "benchmark.conditions",
        "trials": "benchmark.trials_n",
        "policy": "benchmark.policies",
    },
)
REPORT = StageEntry(
    "report",
    functions.report,
    requires=("benchmark",),
    summary="Build the report from the verdicts: one offline HTML and report.json",
    reads=("report", "task", "benchmark"),
    closing=True,
    settings={"lang": "report.language"},
)

STAGES = StageTable(
    [ENV_CHECK, PLAN, CARRY, TELEOP_RECORD, TRAIN_ACT, DEPLOY, BENCHMARK, REPORT],
    LIBRARIES,
)
DATA_AUGMENT = ToolEntry(
    "augmented",
    functions.data_augment,
    moves=True,
    settings={"task": "task", "episodes": "teleop.episodes_n"},
)
"""Stands below `minidual data`."""
TOOLS = (
    ToolEntry(
        "demo",
        functions.demo,
        watchable=True,
        moves=True,
        settings={"task": "task"},
    ),
    ToolEntry(
        "try",
        functions.try_out,
        watchable=True,
        moves=True,
        settings={"task": "task", "plant": "plant.address"},
    ),
    ToolEntry("train", functions.train, moves=True, settings={"task": "task"}),
    ToolEntry("doctor", functions.doctor, moves=True),
    ToolEntry(
        "view",
        functions.view,
        watchable=True,
        moves=True,
        shared=True,
        view_default="web",
        settings={"task": "task"},
    ),
    ToolEntry("replay", functions.replay),
    ToolEntry(
        "modes",
        functions.modes,
        watchable=True,
        moves=True,
        settings={"speed": "arbiter.speed_override", "plant": "plant.address"},
    ),
    ToolEntry(
        "lead",
        functions.lead,
        watchable=True,
        moves=True,
        settings={"leader": "teleop.leader", "task": "task", "plant": "plant.address"},
    ),
    ToolEntry("bridge", functions.bridge, moves=True, settings={"task": "task"}),
)
