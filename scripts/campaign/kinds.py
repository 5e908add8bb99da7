"""The kinds of cases, and how many of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from minidual.registry import load_target
from scripts.campaign.case import Case, Place


@dataclass(frozen=True)
class Kind:
    """A family of cases.

    Attributes:
        target: "module:function" from the source run to all cases.
        small: How many of them run for every build.
        most: How many the whole campaign runs; None for all.
        warm: "module:function" that does once, before the first fork, what every case would load again.
    """

    target: str
    small: int
    most: int | None = None
    warm: str = ""

    def load(self) -> Callable[[Path], Iterable[Case]]:
        """Return the function."""
        return load_target(self.target)

    def prepare(self, place: Place) -> None:
        """Import and cache what every case needs."""
        if self.warm:
            load_target(self.warm)(place)


KINDS = {
    "links": Kind("scripts.campaign.links:link_cases", 10, warm="scripts.campaign.links:warm"),
    "recordings": Kind(
        "scripts.campaign.files:recording_cases",
        15,
        600,
        warm="scripts.campaign.files:warm_recordings",
    ),
    "scenes": Kind(
        "scripts.campaign.files:scene_cases",
        15,
        300,
        warm="scripts.campaign.files:warm_scenes",
    ),
    "readers": Kind(
        "scripts.campaign.files:library_cases",
        10,
        300,
        warm="scripts.campaign.files:warm_readers",
    ),
    "broken-files": Kind(
        "scripts.campaign.broken:broken_cases",
        6,
        warm="scripts.campaign.files:warm_readers",
    ),
    "caches": Kind(
        "scripts.campaign.files:cache_cases",
        2,
        warm="scripts.campaign.files:warm_caches",
    ),
    "publish-kills": Kind(
        "scripts.campaign.kills:publish_cases",
        25,
        warm="scripts.campaign.kills:warm",
    ),
    "stage-kills": Kind("scripts.campaign.kills:stage_cases", 3),
    "full-disks": Kind("scripts.campaign.disks:disk_cases", 1),
    "signals": Kind("scripts.campaign.processes:signal_cases", 4),
    "streams": Kind("scripts.campaign.processes:stream_cases", 4, 120),
    "configuration": Kind("scripts.campaign.configuration:override_cases", 17),
    "profiles": Kind("scripts.campaign.configuration:profile_cases", 60),
    "tampering": Kind(
        "scripts.campaign.tampering:tamper_cases",
        60,
        warm="scripts.campaign.links:warm",
    ),
    "verdicts": Kind("scripts.campaign.tampering:verdict_cases", 10, 600),
}
