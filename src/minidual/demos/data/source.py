"""One interface to demonstrations of any origin."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.demos.faults import EpisodeFault
from minidual.robot.pair import SIDES, Array

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class DataEpisode:
    """One episode: T ticks.

    Attributes:
        name: Of its file, or "episode 3".
        rate_hz: As declared.
        times_s: (T,) from the first tick.
        state, action: (T, entries), in the units of their source.
        effort: (T, entries) measured torques or currents, None where none were recorded.
        forces: (T,) sizes of forces [N] by name, where they were recorded.
        success: None where it is not recorded.
        task: Instruction, or "".
        facts: What else its source says of it, in JSON types.
    """

    name: str
    rate_hz: float
    times_s: Array
    state: Array
    action: Array
    state_names: tuple[str, ...]
    action_names: tuple[str, ...]
    cameras: Mapping[str, tuple[int, int]]
    effort: Array | None = None
    forces: Mapping[str, Array] = field(default_factory=dict)
    success: bool | None = None
    task: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.state)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last tick [s]."""
        return float(self.times_s[-1] - self.times_s[0]) if len(self) else 0.0


class EpisodeReading(NamedTuple):
    """The result of reading an episode: None if it cannot be read, and the faults."""

    name: str
    episode: DataEpisode | None
    faults: tuple[EpisodeFault, ...] = ()


def force_sizes(hand_wrench: Array | None, internal_force: Array | None) -> dict[str, Array]:
    """Return the sizes (T,) [N] of recorded forces by name.

    Args:
        hand_wrench: (T, 2, 6) or (T, 12), forces before torques, of the left and right hand; of
            another size it is left out.
        internal_force: (T,) or (T, 1).
    """
    forces: dict[str, Array] = {}
    if hand_wrench is not None and hand_wrench[0].size == 6 * len(SIDES):
        of_hands = np.linalg.norm(hand_wrench.reshape(-1, len(SIDES), 6)[..., :3], axis=2)
        forces |= {f"{side} hand": of_hands[:, k] for k, side in enumerate(SIDES)}
    if internal_force is not None:
        forces["internal"] = np.abs(internal_force.reshape(-1))
    return forces


class DataSource(ABC):
    """Episodes in one place.

    Attributes:
        kind: In words.
        root: The place.
    """

    kind: str
    root: Path

    @abstractmethod
    def __len__(self) -> int:
        """Number of episodes."""

    @abstractmethod
    def episodes(self) -> Iterator[EpisodeReading]:
        """Read the episodes in order, without their pictures."""

    @abstractmethod
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""

    @abstractmethod
    def pictures(self, camera: str) -> Iterator[tuple[int, Image]]:
        """Yield (number of the episode, pictures (T, H, W, 3)) of those that can be read.

        Raises:
            DataError: Damaged pictures of a dataset.
        """
