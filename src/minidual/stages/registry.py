"""Tables of stages and tools.

A stage is a module's function `run` (see minidual.gate.stage) and a row here, or an entry point of the group
"minidual.stages" (docs/howto-stage.md). An option's `path` overrides that configuration value.
"""

from __future__ import annotations

from minidual.gate.table import Option, StageEntry, StageTable, ToolEntry

LIBRARIES = ("numpy", "scipy", "mujoco", "pin", "coal", "ompl", "torch", "lerobot", "h5py", "av", "gymnasium")
"""Distributions whose versions verdicts record."""

STAGES = StageTable(
    (
        StageEntry(
            "env-check",
            "minidual.stages.env_check.stage:run",
            (),
            "Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries",
            reads=("robot", "env_check", "scene", "arbiter", "supervisor", "teleop.rate_hz"),
            question="Does every joint move as the model says, and do the cameras see?",
            asides=(
                ToolEntry(
                    "env-check-bill",
                    "minidual.stages.env_check.installation:print_bill",
                    "Print versions, libraries and machine for a bug report",
                    (Option("markdown", "Print a bill of versions for a bug report instead.", bool),),
                    triggers=("markdown",),
                ),
            ),
            watchable=True,
        ),
        StageEntry(
            "plan",
            "minidual.stages.plan:run",
            ("env-check",),
            "Plan collision-free motions for left_arm, right_arm and both_arms",
            reads=("robot", "plan", "scene.object", "scene.task"),
            check="minidual.stages.config_checks:check_plan",
            question="Do one arm and both arms find their way?",
            options=(Option("queries", "Queries per planning group.", int, "plan.queries_n"),),
            asides=(
                ToolEntry(
                    "plan-acm",
                    "minidual.stages.plan_acm:plan_acm",
                    "Print the pairs of links that are not checked, and why",
                    (
                        Option("acm", "Print the pairs that are not checked, and why, instead.", bool),
                        Option("scene", "With --to or --acm: planning scene in YAML."),
                    ),
                    triggers=("acm",),
                ),
                ToolEntry(
                    "plan-once",
                    "minidual.stages.plan_once:plan_once",
                    "Plan one motion, without the gate",
                    (
                        Option("to", "Plan once to this state (home, ready, carry ...) or goal file instead."),
                        Option("from", "With --to: start at this state or file (default: home)."),
                        Option("group", "With --to: left_arm, right_arm or both_arms (default)."),
                        Option("scene", "With --to or --acm: planning scene in YAML."),
                        Option("out", "With --to: write the trajectory here (.json)."),
                        Option("csv", "With --to: write the trajectory here (.csv)."),
                        Option("picture", "With --to: draw the path here (.png)."),
                        Option("budget-s", "With --to: give up after this wall time.", float),
                    ),
                    triggers=("to",),
                    watchable=True,
                ),
                ToolEntry(
                    "plan-task",
                    "minidual.stages.plan_task:plan_task",
                    "Plan a whole task from one of its starts and drive it, without the gate",
                    (
                        Option("task", "Plan this task (rod_carry, handover ...) as a whole and drive it instead."),
                        Option("video", "With --task: film it (.mp4)."),
                    ),
                    triggers=("task",),
                    watchable=True,
                ),
            ),
            watchable=True,
        ),
        StageEntry(
            "carry",
            "minidual.stages.carry:run",
            ("plan",),
            "Carry the rod with both arms under object impedance control",
            reads=("robot", "task", "carry", "scene", "arbiter", "supervisor"),
            resolve="minidual.tasks.task:task_config",
            question="Do both arms carry an object between them?",
            options=(
                Option("trials", "Randomised carries to try.", int, "carry.trials_n"),
                Option("object", "What is carried: rod, board, box, glass.", str, "carry.object"),
                Option("motion", "How it travels: straight, rotate, over.", str, "carry.motion"),
            ),
            asides=(
                ToolEntry(
                    "carry-perturb",
                    "minidual.stages.carry_tools:perturb",
                    "Carry under pushes, other masses and frictions, and worse sensing",
                    (Option("perturb", "Carry under every disturbance (20 trials each) instead.", bool),),
                    triggers=("perturb",),
                    watchable=True,
                ),
                ToolEntry(
                    "carry-tune",
                    "minidual.stages.carry_tools:tune",
                    "Search squeeze and stiffness by carrying",
                    (Option("tune", "Search squeeze and stiffness by carrying, and write a profile.", bool),),
                    triggers=("tune",),
                ),
            ),
            watchable=True,
        ),
        StageEntry(
            "teleop-record",
            "minidual.stages.teleop_record:run",
            ("carry",),
            "Teleoperate, record demonstrations, convert and grade the dataset",
            reads=("robot", "task", "teleop", "scene", "arbiter", "supervisor"),
            resolve="minidual.tasks.task:task_config",
            check="minidual.stages.config_checks:check_leader",
            question="Does the follower follow its leader, and is what was recorded whole and smooth?",
            options=(Option("episodes", "Demonstrations to record.", int, "teleop.episodes_n"),),
            watchable=True,
        ),
        StageEntry(
            "train-act",
            "minidual.stages.train_act:run",
            ("teleop-record",),
            "Train the ACT policy on the recorded dataset",
            reads=("robot", "train"),
            check="minidual.stages.config_checks:check_policy",
            question="Does the policy learn from the data?",
        ),
        StageEntry(
            "deploy",
            "minidual.stages.deploy:run",
            ("train-act",),
            "Let the policy drive the arms on seeds it never saw",
            reads=("robot", "task", "deploy", "scene", "arbiter", "supervisor", "teleop.rate_hz"),
            resolve="minidual.tasks.task:task_config",
            question="Does what it learned work on starts it never saw?",
            options=(Option("trials", "Held-out trials.", int, "deploy.trials"),),
            watchable=True,
        ),
        StageEntry(
            "benchmark",
            "minidual.stages.benchmark:run",
            ("carry", "deploy"),
            "Compare the methods on the same task, seeds and success test, undisturbed and disturbed",
            reads=("robot", "task", "benchmark", "carry", "plan.planner", "deploy", "scene", "arbiter", "supervisor"),
            resolve="minidual.tasks.task:task_config",
            check="minidual.stages.config_checks:check_benchmark",
            question="How do the methods compare?",
            options=(
                Option(
                    "methods",
                    "Methods to compare, separated by commas: moveit,impedance,act.",
                    str,
                    "benchmark.methods",
                    split=True,
                ),
                Option(
                    "conditions",
                    "Disturbances, separated by commas: clean,push_+x,friction_0.3; or all.",
                    str,
                    "benchmark.conditions",
                    split=True,
                ),
            ),
            watchable=True,
        ),
        StageEntry(
            "report",
            "minidual.stages.report:run",
            ("benchmark",),
            "Build the report from the verdicts: one offline HTML and report.json",
            reads=("report", "benchmark.methods", "benchmark.conditions"),
            question="Does the report hold every number?",
            closing=True,
        ),
    ),
    libraries=LIBRARIES,
)

TOOLS: tuple[ToolEntry, ...] = (
    ToolEntry(
        "view",
        "minidual.stages.scene_view:view_scene",
        "Show the scene in real time in a browser, with a slider for each joint",
        (Option("for-s", "End by itself after this many seconds (default: Ctrl-C ends it).", float),),
        watchable=True,
        view_default="web",
    ),
    ToolEntry(
        "replay",
        "minidual.stages.replay:replay_tool",
        "Run a dumped state or a recorded trial again: does it repeat, and what went out of bounds first",
        (
            Option("file", "A dump or a recorded trial (.npz).", argument=True, required=True),
            Option("from-s", "Begin at this simulated time.", float),
            Option("to-s", "End at this simulated time.", float),
            Option("video", "Write a film here (.mp4)."),
            Option("slowdown", "Film this many times slower than life.", float),
            Option("picture", "Write a sheet of frames here (.png)."),
            Option("frames", "Frames on the sheet.", int),
            Option("camera", "overview, high, left or right."),
        ),
    ),
    ToolEntry(
        "modes",
        "minidual.stages.modes:modes",
        "Planner, leader and policy hand the arms to one another in one process: film, log, bounds of every switch",
        (
            Option("modes", "Modes in turn, separated by commas (default: moveit,teleop,policy,moveit)."),
            Option("checkpoint", "Folder of the policy (default: the run's train-act)."),
        ),
        watchable=True,
    ),
)
"""Commands without verdict or gate."""
