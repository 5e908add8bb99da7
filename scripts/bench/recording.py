"""Where the processor time of a scripted episode goes, from its plan to its rows of the dataset."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from minidual.config.root import changed
from minidual.control.stack import ControlStack
from minidual.demos import lerobot_adapter
from minidual.demos.episode_recorder import EpisodeRecorder
from minidual.demos.leaders import scripted
from minidual.demos.rig import Job, Rig
from minidual.demos.writer import EpisodeWriter
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.show.report.bench import BenchRow, BenchTable
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Judge
from minidual.trials.conditions import rooms
from scripts.bench.stopwatch import Stopwatch
from scripts.bench.tables import BenchInputs

REST = "session, buttons, rooms"
CONVERSION = "conversion and its check"
PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "plan": ((scripted, "plan_demonstration"),),
    "physics": ((World, "step"),),
    "control": ((ControlStack, "advance"), (ControlStack, "arbitrate")),
    "judge": ((Judge, "observe"), (Judge, "outcome")),
    "pictures": ((Camera, "stamped"),),
    "file": ((EpisodeWriter, "append"), (EpisodeWriter, "finish"), (EpisodeWriter, "publish")),
    "file read back": ((EpisodeRecorder, "read_back"),),
    CONVERSION: ((lerobot_adapter, "convert"),),
}
"""{part: what is timed}; what a function calls of another part counts there."""
_SETTINGS = {
    "teleop.conditions": ("clean", "room", "room"),
    "teleop.room_change_s": 0.5,
}
"""Those of the profile `standard`."""
COLUMNS = ("ms_per_episode", "share_pct")


@contextmanager
def _timed_parts(watch: Stopwatch) -> Iterator[None]:
    with ExitStack() as stack:
        for part, places in PARTS.items():
            for owner, name in places:
                timed = watch.timed(part, getattr(owner, name))
                stack.enter_context(patch.object(owner, name, timed))
        yield


def measure(inputs: BenchInputs) -> BenchTable:
    """Record and convert scripted demonstrations in one process, after one that is not timed."""
    config = changed(inputs.config, _SETTINGS)
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        job = Job(
            folder,
            make_task(config),
            config.teleop,
            config.arbiter,
            inputs.seed,
            config.supervisor,
            rooms(config.teleop.conditions),
        )
        rig = Rig(job, config.teleop.cameras)
        rig.record(0)  # compiled parts load, and the picture's context is made
        with _timed_parts(watch), watch.running(REST):
            attempts = [rig.record(index) for index in range(1, 1 + inputs.repeats_n)]
            paths = [a.path for a in attempts if a.kept and a.path is not None]
            lerobot_adapter.convert(paths, folder / "lerobot", job.robot)
        rig.close()
    inputs.advance(f"{len(paths)} of {len(attempts)} episodes kept")
    return _table(watch.seconds, len(attempts), len(config.teleop.cameras))


def _table(seconds: Counter[str], episodes_n: int, cameras_n: int) -> BenchTable:
    total_s = seconds.total()
    rows = [
        BenchRow(
            part,
            {
                "ms_per_episode": 1e3 * seconds[part] / episodes_n,
                "share_pct": 100.0 * seconds[part] / total_s,
            },
            {},
        )
        for part in (*PARTS, REST)
    ]
    rows.append(BenchRow("all", {"ms_per_episode": 1e3 * total_s / episodes_n}, {}))
    notes = (
        f"{episodes_n} episodes, {cameras_n} camera(s), the rooms of the profile standard",
        "processor time of one process; two workers record at once, and conversion goes on beside",
    )
    return BenchTable("Recording: where the time goes", COLUMNS, tuple(rows), notes)
