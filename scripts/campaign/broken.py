"""The named breaks of tests/support/broken_files.py, on the files of the smoke run: each is refused by name."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from minidual.durable import remove
from scripts.campaign.case import Case, Place, Result
from scripts.campaign.files import look

if TYPE_CHECKING:
    from tests.support.broken_files import Break

_DRAWN = ("truncated", "noise")
"""Breaks that draw: tried with several draws of each file."""
_DRAWS = 8


def broken_cases(source: Path) -> Iterator[Case]:
    """Each break of an episode, a dataset and a checkpoint."""
    from tests.support import broken_files

    (episode, *_) = sorted((source / "teleop-record/episodes").iterdir())
    for kind, name, breaks in (
        ("episode", f"teleop-record/episodes/{episode.name}", broken_files.EPISODE),
        ("dataset", "teleop-record/lerobot", broken_files.DATASET),
        ("checkpoint", "train-act/checkpoint", broken_files.CHECKPOINT),
    ):
        for what, change in breaks.items():
            for number in range(_DRAWS if what.endswith(_DRAWN) else 1):
                yield Case(
                    f"{kind} {what} {number}",
                    partial(broken, kind, name, change),
                    limit_s=40.0,
                )


def broken(kind: str, name: str, change: Break, place: Place, result: Result) -> None:
    """Break a file of the copied run and read it."""
    path = place.runs / "smoke" / name
    remove(path)  # its files are hard links to the source
    (shutil.copytree if (place.source / name).is_dir() else shutil.copy)(place.source / name, path)
    change(path, place.rng)
    look(kind, name, place, result)
    if not result.outcomes.keys() & {"named", "refused"}:
        result.forbidden.append("a silent pass: the broken file is read")
