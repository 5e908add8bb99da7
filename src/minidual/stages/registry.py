"""Tables of stages and tools.

A stage is a function (see minidual.gate.stage) and a row, here or in another distribution (docs/howto-stage.md).
"""

from minidual.gate.table import Option, StageEntry, StageTable, ToolEntry

LIBRARIES = ("numpy", "scipy", "mujoco", "pin", "coal", "ompl", "torch", "lerobot", "h5py", "av", "gymnasium")
"""Distributions whose versions verdicts record."""

_SCENE = Option("scene", "With --to or --acm: planning scene in YAML.")
_OBJECT = Option("object", "What is carried: rod, board, box, glass.", str, "carry.object")
_MOTION = Option("motion", "How it travels: straight, rotate, over.", str, "carry.motion")
_TASK_NAME = Option("task", "Task, such as handover (default: the run's).", str, "task")
_SPEED = Option("speed", "Share of full speed, 0.1 to 1.", float, "arbiter.speed_override")
_CARRIES = Option("trials", "Randomised carries to try.", int, "carry.trials_n")

_BILL = ToolEntry(
    "env-check-bill",
    "minidual.stages.env_check.installation:print_bill",
    options=(Option("markdown", "Print a bill of versions for a bug report instead.", bool),),
)
_ACM = ToolEntry(
    "plan-acm",
    "minidual.stages.plan_tools:plan_acm",
    options=(Option("acm", "Print the pairs that are not checked, and why, instead.", bool), _SCENE),
)
_ONCE = ToolEntry(
    "plan-once",
    "minidual.stages.plan_tools:plan_once",
    options=(
        Option("to", "Plan once to this state (home, ready, carry ...) or goal file instead."),
        Option("from", "With --to: start at this state or file (default: home)."),
        Option("group", "With --to: left_arm, right_arm or both_arms (default)."),
        _SCENE,
        Option("out", "With --to: write the trajectory here (.json)."),
        Option("csv", "With --to: write the trajectory here (.csv)."),
        Option("picture", "With --to: draw the path here (.png)."),
        Option("budget-s", "With --to: give up after this wall time.", float),
    ),
    watchable=True,
)
_TASK = ToolEntry(
    "plan-task",
    "minidual.stages.plan_task:plan_task",
    options=(
        Option("task", "Plan this task (rod_carry, handover ...) as a whole and drive it instead."),
        Option("video", "With --task: film it (.mp4)."),
    ),
    watchable=True,
)
_CARRY = (
    Option("perturb", "Carry under every disturbance (20 trials each) instead.", bool),
    _CARRIES,
    _OBJECT,
    _MOTION,
)
_PERTURB = ToolEntry("carry-perturb", "minidual.stages.carry_tools:perturb", options=_CARRY, moves=True, watchable=True)
_TUNED = Option("tune", "Search squeeze and stiffness by carrying, and write a profile.", bool), _OBJECT, _MOTION
_TUNE = ToolEntry("carry-tune", "minidual.stages.carry_tools:tune", options=_TUNED, moves=True)

STAGES = StageTable(
    (
        StageEntry(
            "env-check",
            "minidual.stages.env_check.stage:run",
            (),
            "Simulation and joints: every joint read, mapped and driven, tracking, contacts, libraries",
            reads=("robot", "env_check", "scene", "arbiter", "supervisor", "teleop.rate_hz"),
            asides=(_BILL,),
            watchable=True,
            examples=("env-check", "env-check --markdown"),
        ),
        StageEntry(
            "plan",
            "minidual.stages.plan:run",
            ("env-check",),
            "Plan collision-free motions for left_arm, right_arm and both_arms",
            reads=("robot", "plan", "scene.object", "scene.task"),
            check="minidual.stages.config_checks:check_plan",
            options=(Option("queries", "Queries per planning group.", int, "plan.queries_n"),),
            asides=(_ACM, _ONCE, _TASK),
            watchable=True,
            examples=("plan", "plan --to ready --scene examples/bench-scene.yaml --view web"),
        ),
        StageEntry(
            "carry",
            "minidual.stages.carry:run",
            ("plan",),
            "Carry an object with both arms under object impedance control",
            reads=("robot", "task", "carry", "scene", "arbiter", "supervisor"),
            resolve="minidual.tasks.task:task_config",
            options=(_CARRIES, _OBJECT, _MOTION, _SPEED),
            asides=(_PERTURB, _TUNE),
            watchable=True,
            examples=("carry --trials 20", "carry --object glass --motion over"),
        ),
        StageEntry(
            "teleop-record",
            "minidual.stages.teleop_record:run",
            ("carry",),
            "Teleoperate, record demonstrations, convert and grade the dataset",
            reads=("robot", "task", "teleop", "scene", "arbiter", "supervisor"),
            resolve="minidual.tasks.task:task_config",
            check="minidual.stages.config_checks:check_leader",
            options=(Option("episodes", "Demonstrations to record.", int, "teleop.episodes_n"), _TASK_NAME),
            watchable=True,
            examples=("teleop-record --episodes 50", "teleop-record --task handover --view web"),
            keeps=("episodes", "rejected", "attempts", "inputs.json"),
        ),
        StageEntry(
            "train-act",
            "minidual.stages.train_act:run",
            ("teleop-record",),
            "Train the ACT policy on the recorded dataset",
            reads=("robot", "train"),
            check="minidual.stages.config_checks:check_policy",
            options=(Option("seeds", "Trainings, each with its own seed.", int, "train.seeds_n"),),
            examples=("train-act", "train-act --seeds 3"),
        ),
        StageEntry(
            "deploy",
            "minidual.stages.deploy:run",
            ("train-act",),
            "Let the policy drive the arms on seeds it never saw",
            reads=("robot", "task", "deploy", "scene", "arbiter", "supervisor", "teleop.rate_hz"),
            resolve="minidual.tasks.task:task_config",
            check="minidual.stages.config_checks:check_deploy",
            options=(Option("trials", "Held-out trials.", int, "deploy.trials"), _TASK_NAME),
            watchable=True,
            examples=("deploy", "deploy --trials 20 --view web"),
        ),
        StageEntry(
            "benchmark",
            "minidual.stages.benchmark:run",
            ("carry", "deploy"),
            "Compare the methods on the same tasks, seeds and success tests, undisturbed and disturbed",
            reads=("robot", "task", "benchmark", "carry", "plan.planner", "deploy", "scene", "arbiter", "supervisor"),
            resolve="minidual.tasks.task:benchmark_config",
            check="minidual.stages.config_checks:check_benchmark",
            options=(
                Option("tasks", "Tasks, such as rod_carry,handover (default: the run's).", tuple, "benchmark.tasks"),
                Option("methods", "Methods to compare, such as moveit,impedance,act.", tuple, "benchmark.methods"),
                Option("conditions", "Disturbances, such as clean,push_+y; or all.", tuple, "benchmark.conditions"),
                Option("trials", "Undisturbed trials of each method and task.", int, "benchmark.trials_n"),
            ),
            watchable=True,
            examples=(
                "benchmark --tasks rod_carry,handover --methods moveit,act",
                "benchmark --conditions clean,push_+y,friction_0.3",
            ),
        ),
        StageEntry(
            "report",
            "minidual.stages.report:run",
            ("benchmark",),
            "Build the report from the verdicts: one offline HTML and report.json",
            reads=("report", "benchmark.tasks", "benchmark.methods", "benchmark.conditions"),
            closing=True,
            examples=("report", "report --run standard --json"),
        ),
    ),
    libraries=LIBRARIES,
)

TOOLS: tuple[ToolEntry, ...] = (
    ToolEntry(
        "view",
        "minidual.stages.scene_view:view_scene",
        "Show the scene in real time in a browser, with a slider for each joint",
        (
            Option("task", "Scene of this task: rod_carry, handover, pot_lift, sort, insertion.", str, "task"),
            Option("for-s", "End by itself after this many seconds (default: Ctrl-C ends it).", float),
        ),
        watchable=True,
        moves=True,
        view_default="web",
        examples=("view --task pot_lift", "view --set robot.arm=xarm7 --for-s 60"),
    ),
    ToolEntry(
        "replay",
        "minidual.stages.replay:replay_tool",
        "Run a dumped state or a recorded trial again: does it repeat, and what went out of bounds first",
        (
            Option("file", "A dump or a recorded trial (.npz).", argument=True),
            Option("from-s", "Begin at this simulated time.", float),
            Option("to-s", "End at this simulated time.", float),
            Option("video", "Write a film here (.mp4)."),
            Option("slowdown", "Film this many times slower than life.", float),
            Option("picture", "Write a sheet of frames here (.png)."),
            Option("frames", "Frames on the sheet.", int),
            Option("camera", "overview, high, left or right."),
        ),
        examples=(
            "replay runs/standard/carry/worst.npz --video worst.mp4 --slowdown 4",
            "replay runs/standard/carry/worst.npz --picture worst.png --frames 12",
        ),
    ),
    ToolEntry(
        "modes",
        "minidual.stages.modes:modes",
        "Planner, leader and policy hand the arms to one another in one process: film, log, bounds of every switch",
        (
            Option("modes", "Modes in turn, separated by commas (default: moveit,teleop,policy,moveit)."),
            Option("checkpoint", "Folder of the policy (default: the run's train-act)."),
            _SPEED,
        ),
        watchable=True,
        moves=True,
        examples=("modes", "modes --modes moveit,teleop,moveit --view web"),
    ),
)
