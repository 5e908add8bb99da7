"""The one table of stages: name, code, what it requires, and the options of its command.

To add a stage, write `minidual/stages/<name>.py` with a module attribute STAGE (see minidual.gate.stage)
and a row here. To add an option to a command, add a StageOption to its row: it overrides the configuration
value at `path`, exactly as --set does.
"""

from __future__ import annotations

from minidual.gate.table import StageEntry, StageOption, StageTable
from minidual.gate.tool import ToolEntry, ToolOption

LIBRARIES = ("numpy", "scipy", "mujoco", "pin", "coal", "ompl", "toppra", "torch", "lerobot", "h5py", "av", "gymnasium")
"""Distributions whose versions every verdict records."""

STAGES = StageTable(
    (
        StageEntry(
            "env-check",
            "minidual.stages.env_check:STAGE",
            (),
            "Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries",
            asides=(
                ToolEntry(
                    "env-check-bill",
                    "minidual.stages.env_check_bill:print_bill",
                    "Print versions, libraries and machine for a bug report",
                    (ToolOption("markdown", "Print a bill of versions for a bug report instead.", bool),),
                    triggers=("markdown",),
                ),
            ),
            watchable=True,
        ),
        StageEntry(
            "plan",
            "minidual.stages.plan:STAGE",
            ("env-check",),
            "Plan collision-free motions for left_arm, right_arm and both_arms",
            (StageOption("queries", "plan.queries_n", "Queries per planning group."),),
            asides=(
                ToolEntry(
                    "plan-acm",
                    "minidual.stages.plan_acm:plan_acm",
                    "Print the pairs of links that are not checked, and why",
                    (
                        ToolOption("acm", "Print the pairs that are not checked, and why, instead.", bool),
                        ToolOption("scene", "With --to or --acm: planning scene in YAML."),
                    ),
                    triggers=("acm",),
                ),
                ToolEntry(
                    "plan-once",
                    "minidual.stages.plan_once:plan_once",
                    "Plan one motion, without the gate",
                    (
                        ToolOption("to", "Plan once to this state (home, ready, carry ...) or goal file instead."),
                        ToolOption("from", "With --to: start at this state or file (default: home)."),
                        ToolOption("group", "With --to: left_arm, right_arm or both_arms (default)."),
                        ToolOption("scene", "With --to or --acm: planning scene in YAML."),
                        ToolOption("out", "With --to: write the trajectory here (.json)."),
                        ToolOption("csv", "With --to: write the trajectory here (.csv)."),
                        ToolOption("picture", "With --to: draw the path here (.png)."),
                        ToolOption("budget-s", "With --to: give up after this wall time.", float),
                    ),
                    triggers=("to",),
                    watchable=True,
                ),
            ),
            watchable=True,
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
                    watchable=True,
                ),
                ToolEntry(
                    "carry-tune",
                    "minidual.stages.carry_tools:tune",
                    "Search squeeze and stiffness by carrying",
                    (ToolOption("tune", "Search squeeze and stiffness by carrying, and write a profile.", bool),),
                    triggers=("tune",),
                ),
            ),
            watchable=True,
        ),
        StageEntry(
            "teleop-record",
            "minidual.stages.teleop_record:STAGE",
            ("carry",),
            "Teleoperate, record demonstrations, convert and grade the dataset",
            (StageOption("episodes", "teleop.episodes_n", "Demonstrations to record."),),
            watchable=True,
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
            watchable=True,
        ),
        StageEntry(
            "benchmark",
            "minidual.stages.benchmark:STAGE",
            ("carry", "deploy"),
            "Compare the methods on the same task, seeds and success test, undisturbed and disturbed",
            (
                StageOption(
                    "methods",
                    "benchmark.methods",
                    "Methods to compare, separated by commas: moveit,impedance,act.",
                    kind=str,
                    split=True,
                ),
                StageOption(
                    "conditions",
                    "benchmark.conditions",
                    "Disturbances, separated by commas: clean,push_+x,friction_0.3; or all.",
                    kind=str,
                    split=True,
                ),
            ),
            watchable=True,
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
