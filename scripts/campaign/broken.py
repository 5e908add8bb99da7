"""The named breaks of tests/support/broken_files.py, on files of the smoke run: each is refused."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from minidual.durable import remove
from scripts.campaign.case import Case, Place, Result
from scripts.campaign.readers import read_file

if TYPE_CHECKING:
    from tests.support.broken_files import Break

_RANDOM = ("truncated", "noise")
"""Breaks that draw: tried several times on each file."""
_DRAWS_N = 8


def broken_cases(source: Path) -> Iterator[Case]:
    """Each break of an episode, a dataset and a checkpoint."""
    from tests.support import broken_files

    episode, *_ = sorted((source / "teleop-record/episodes").iterdir())
    for kind, name, breaks in (
        ("episode", f"teleop-record/episodes/{episode.name}", broken_files.EPISODE),
        ("dataset", "teleop-record/lerobot", broken_files.DATASET),
        ("checkpoint", "train-act/checkpoint", broken_files.CHECKPOINT),
    ):
        for break_name, change in breaks.items():
            draws_n = _DRAWS_N if break_name.endswith(_RANDOM) else 1
            for number in range(draws_n):
                body = partial(broken, kind, name, change)
                yield Case(f"{kind} {break_name} {number}", body, limit_s=40.0)


def broken(kind: str, name: str, change: Break, place: Place, result: Result) -> None:
    """Break a file of the copied run and read it."""
    original = place.source / name
    path = place.runs / "smoke" / name
    remove(path)  # its files are hard links to the source
    if original.is_dir():
        shutil.copytree(original, path)
    else:
        shutil.copy(original, path)
    change(path, place.rng)
    read_file(kind, name, place, result)
    if not result.outcomes.keys() & {"named", "refused"}:
        result.forbidden.append("a silent pass: the broken file is read")
