"""The migration's own table of stages; its verdicts lie in the run's folder `migration`."""

from minidual.gate.stage import StageFunction
from minidual.gate.table import StageEntry, StageTable
from minidual.registry import Deferred
from minidual.stages.registry import LIBRARIES


def _step(index: int) -> Deferred[StageFunction]:
    """Return a step's stage, imported when it runs."""

    def load() -> StageFunction:
        from minidual.stages.migrate.steps import STEPS, stage_of

        return stage_of(STEPS[index])

    return Deferred(load)


NAMES = ("one-arm-10", "both-arms-10", "both-arms-30", "teleoperation", "full-speed")
_SUMMARIES = (
    "One arm at 10 % speed",
    "Both arms at 10 % speed",
    "Both arms at 30 % speed",
    "Teleoperation",
    "Full speed with recording",
)
_READS = ("robot", "plant", "arbiter", "supervisor", "scene", "teleop.rate_hz")

MIGRATION = StageTable(
    [
        StageEntry(
            name,
            _step(index),
            requires=NAMES[max(0, index - 1) : index],
            summary=_SUMMARIES[index],
            reads=_READS,
        )
        for index, name in enumerate(NAMES)
    ],
    LIBRARIES,
)
"""Each step requires the one below, passed and fresh: on the same plant, with the same settings."""
