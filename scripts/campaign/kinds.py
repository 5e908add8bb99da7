"""The kinds of cases, and how many of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from scripts.campaign import (
    broken,
    caches,
    configuration,
    disks,
    kills,
    links,
    processes,
    readers,
    recordings,
    scene_files,
    tampering,
)
from scripts.campaign.case import Case, Place


def _nothing(_place: Place) -> None:
    pass


@dataclass(frozen=True)
class Kind:
    """A family of cases.

    Attributes:
        cases: From the source run to all cases.
        small: How many of them run for every build.
        most: How many the whole campaign runs; None for all.
        warm: Does once, before the first fork, what every case would load again.
    """

    cases: Callable[[Path], Iterable[Case]]
    small: int
    most: int | None = None
    warm: Callable[[Place], None] = _nothing


KINDS = {
    "links": Kind(links.link_cases, 10, warm=links.warm),
    "recordings": Kind(recordings.recording_cases, 15, 600, warm=recordings.warm),
    "scenes": Kind(scene_files.scene_cases, 15, 300, warm=scene_files.warm),
    "readers": Kind(readers.library_cases, 10, 300, warm=readers.warm),
    "broken-files": Kind(broken.broken_cases, 6, warm=readers.warm),
    "caches": Kind(caches.cache_cases, 2, warm=caches.warm),
    "publish-kills": Kind(kills.publish_cases, 25, warm=kills.warm),
    "stage-kills": Kind(kills.stage_cases, 3),
    "full-disks": Kind(disks.disk_cases, 1),
    "signals": Kind(processes.signal_cases, 4),
    "streams": Kind(processes.stream_cases, 4, 120),
    "configuration": Kind(configuration.override_cases, 17),
    "profiles": Kind(configuration.profile_cases, 60),
    "tampering": Kind(tampering.tamper_cases, 60, warm=links.warm),
    "verdicts": Kind(tampering.verdict_cases, 10, 600),
}
