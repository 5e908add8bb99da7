"""The one table of commands that are no stage: they write no verdict and open no gate.

To add one, write a function `(ToolContext) -> ToolResult` and a row here; see minidual.gate.tool.
"""

from __future__ import annotations

from minidual.gate.tool import ToolEntry, ToolOption

TOOLS: tuple[ToolEntry, ...] = (
    ToolEntry(
        "bench",
        "minidual.stages.bench:bench",
        "Time beside a yardstick of the same run: one control step against bare physics, and where the rest goes",
        (
            ToolOption("names", "What to time (default: everything).", argument=True, many=True),
            ToolOption("repeats", "How often each thing is timed.", int),
            ToolOption("check", "Exit 1 if a number exceeds its limit.", bool),
        ),
    ),
    ToolEntry(
        "view",
        "minidual.stages.scene_view:view_scene",
        "Show the scene in real time in a browser, with a slider for each joint",
        (ToolOption("for-s", "End by itself after this many seconds (default: Ctrl-C ends it).", float),),
        watchable=True,
        view_default="web",
    ),
    ToolEntry(
        "replay",
        "minidual.stages.replay:replay_tool",
        "Run a dumped state or a recorded trial again: does it repeat, and what went out of bounds first",
        (
            ToolOption("file", "A dump or a recorded trial (.npz).", argument=True, required=True),
            ToolOption("from-s", "Begin at this simulated time.", float),
            ToolOption("to-s", "End at this simulated time.", float),
            ToolOption("video", "Write a film here (.mp4)."),
            ToolOption("slowdown", "Film this many times slower than life.", float),
            ToolOption("picture", "Write a sheet of frames here (.png)."),
            ToolOption("frames", "Frames on the sheet.", int),
            ToolOption("camera", "overview, high, left or right."),
        ),
    ),
    ToolEntry(
        "modes",
        "minidual.stages.modes:modes",
        "Planner, leader and policy hand the arms to one another in one process: film, log, bounds of every switch",
        (
            ToolOption("modes", "Modes in turn, separated by commas (default: moveit,teleop,policy,moveit)."),
            ToolOption("checkpoint", "Folder of the policy (default: the run's train-act)."),
        ),
        watchable=True,
    ),
)
