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
)
