"""The one table of commands that are no stage: they write no verdict and open no gate.

To add one, write a function `(ToolContext) -> ToolResult` and a row here; see minidual.pipeline.tool.
"""

from __future__ import annotations

from minidual.pipeline.tool import ToolEntry

TOOLS: tuple[ToolEntry, ...] = ()
