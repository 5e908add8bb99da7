"""Tables of stages and tools, from stages.yaml.

A stage is a function (see minidual.gate.stage) and a row, there or in another distribution (docs/howto-stage.md).
"""

from typing import Any

from minidual.gate.table import StageEntry, StageTable, ToolEntry
from minidual.registry import rows_beside

_ROWS = rows_beside(__file__, "stages.yaml")


def _entry[E: (StageEntry, ToolEntry)](kind: type[E], name: str, row: dict[str, Any]) -> E:
    fields: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in row.items()
    }
    if "asides" in row:
        fields["asides"] = tuple(
            _entry(ToolEntry, key, aside) for key, aside in row["asides"].items()
        )
    return kind(name, **fields)


STAGES = StageTable(
    [_entry(StageEntry, *row) for row in _ROWS["stages"].items()],
    _ROWS["libraries"],
)
TOOLS = tuple(_entry(ToolEntry, *row) for row in _ROWS["tools"].items())
