"""The one table of stages: name, code, what it requires, and the options of its command.

To add a stage, write `minidual/stages/<name>.py` with a module attribute STAGE (see minidual.pipeline.stage)
and a row here. To add an option to a command, add a StageOption to its row: it overrides the configuration
value at `path`, exactly as --set does.
"""

from __future__ import annotations

from minidual.pipeline.table import StageEntry, StageOption, StageTable
from minidual.pipeline.tool import ToolEntry, ToolOption

LIBRARIES = (
    "numpy", "scipy", "mujoco", "pin", "coal", "ompl", "toppra", "torch", "lerobot", "h5py", "av", "gymnasium",
)  # fmt: skip
"""Distributions whose versions every verdict records."""

STAGES = StageTable(
    (
        StageEntry(
            "env-check",
            "minidual.stages.env_check:STAGE",
            (),
            "Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries",
        ),
        StageEntry(
            "plan",
            "minidual.stages.plan:STAGE",
            ("env-check",),
            "Plan collision-free motions for left_arm, right_arm and both_arms",
            (StageOption("queries", "plan.queries_n", "Queries per planning group."),),
        ),
        StageEntry(
            "carry",
            "minidual.stages.carry:STAGE",
            ("plan",),
            "Carry the rod with both arms under object impedance control",
            (
                StageOption("trials", "carry.trials_n", "Randomised carries to try."),
                StageOption("object", "carry.object", "What is carried: rod, board, box, glass.", kind=str),
                StageOption("motion", "carry.motion", "How it travels: straight, rotate, over.", kind=str),
            ),
            asides=(
                ToolEntry(
                    "carry-perturb",
                    "minidual.stages.carry_tools:perturb",
                    "Carry under pushes, other masses and frictions, and worse sensing",
                    (ToolOption("perturb", "Carry under every disturbance (20 trials each) instead.", bool),),
                    triggers=("perturb",),
                ),
                ToolEntry(
                    "carry-tune",
                    "minidual.stages.carry_tools:tune",
                    "Search squeeze and stiffness by carrying",
                    (
                        ToolOption(
                            "tune", "Search squeeze and stiffness by carrying, and write a profile.", bool
                        ),
                    ),
                    triggers=("tune",),
                ),
            ),
        ),
        StageEntry(
            "teleop-record",
            "minidual.stages.teleop_record:STAGE",
            ("carry",),
            "Teleoperate, record demonstrations, convert and grade the dataset",
            (StageOption("episodes", "teleop.episodes_n", "Demonstrations to record."),),
        ),
        StageEntry(
            "train-act",
            "minidual.stages.train_act:STAGE",
            ("teleop-record",),
            "Train the ACT policy on the recorded dataset",
        ),
        StageEntry(
            "deploy",
            "minidual.stages.deploy:STAGE",
            ("train-act",),
            "Let the policy drive the arms on seeds it never saw",
            (StageOption("trials", "deploy.trials", "Held-out trials."),),
        ),
        StageEntry(
            "benchmark",
            "minidual.stages.benchmark:STAGE",
            ("carry", "deploy"),
            "Compare the methods on the same task, seeds and success test",
            (
                StageOption(
                    "methods",
                    "benchmark.methods",
                    "Methods to compare, separated by commas: moveit,impedance,act.",
                    kind=str,
                    split=True,
                ),
            ),
        ),
        StageEntry(
            "report",
            "minidual.stages.report:STAGE",
            ("benchmark",),
            "Build the report from the verdicts: one offline HTML and report.json",
            closing=True,
        ),
    ),
    libraries=LIBRARIES,
)
