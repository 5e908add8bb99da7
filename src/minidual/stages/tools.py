"""The one table of commands that are no stage: they write no verdict and open no gate.

To add one, write a function `(ToolContext) -> ToolResult` and a row here; see minidual.pipeline.tool.
"""

from __future__ import annotations

from minidual.pipeline.tool import ToolEntry, ToolOption

TOOLS: tuple[ToolEntry, ...] = (
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
