"""The robot's allowed-collision matrix: unchecked pairs of links of one arm, by reason.

See docs/planning-scenes.md. Only the left arm is sampled, fingers locked. The number n of samples
doubles from 20 000 until no pair changes class over two doublings. A `never` pair touches in less
than 3/n of all postures (95 % confidence).
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import json
import os
import re
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from minidual.collision.shapes import ENGINES, Pairs
from minidual.config.seeds import stream
from minidual.durable import expanded, regular_file, write_text
from minidual.errors import DataError
from minidual.robot.description import links_of, pair_urdf
from minidual.robot.pair import SIDES, Robot

SAMPLES_MIN = 20_000
SAMPLES_MAX = 1_280_000
QUIET_DOUBLINGS = 2
"""Unchanged doublings in a row that end the sampling."""
ALWAYS_FRACTION = 0.95
_RULE_VERSION = "6"
_CACHE_BYTES_MAX = 2**20
_SEED = 7

LinkPair = tuple[str, str]
AllowedCollisions = frozenset[tuple[str, str, str]]
"""The matrix: (link, link, reason), names sorted."""


@dataclass(frozen=True)
class BuiltAcm:
    """The matrix and its history.

    Attributes:
        rounds: `samples_n` so far, pairs that `changed` class.
        converged: False if the sample limit was reached.
        rarest, rarest_n: Touching pair with fewest contacts; their number.
    """

    pairs: list[list[str]]
    rounds: list[dict[str, Any]]
    converged: bool
    rarest: str
    rarest_n: int

    @cached_property
    def acm(self) -> AllowedCollisions:
        """The matrix."""
        return frozenset((a, b, reason) for a, b, reason in self.pairs)

    @property
    def samples_n(self) -> int:
        """Samples drawn."""
        return self.rounds[-1]["samples_n"]

    def lines(self) -> list[str]:
        """Return the history as lines."""
        state = "converged" if self.converged else "NOT converged"
        steps = ", ".join(f"{r['samples_n']} ({len(r['changed'])} changed)" for r in self.rounds)
        never = (
            f"a pair that never touched does so in less than {3.0 / self.samples_n:.1e} of all"
            " postures (95 % confidence)"
        )
        return [
            f"{state} over {QUIET_DOUBLINGS} doublings: samples {steps}",
            f"rarest contact: {self.rarest}, {self.rarest_n} of {self.samples_n}; {never}",
        ]


@cache
def acm_report(robot: Robot) -> BuiltAcm:
    """Return matrix and history from the user's cache.

    They are built (1 s) if it lacks the model or is damaged. Two different arms have the matrix of
    each: its pairs are links of one arm.
    """
    if robot.arms[0] != robot.arms[1]:
        return _combined([acm_report(Robot(arm)) for arm in robot.arms])
    model = model_hash(robot)
    folder = expanded(os.environ.get("MINIDUAL_CACHE") or "~/.cache/minidual")
    path = folder / f"acm-{model[:20]}.json"
    with contextlib.suppress(DataError, OSError, ValueError, TypeError):
        text = regular_file(path, _CACHE_BYTES_MAX).read_text(encoding="utf-8")
        digest, _, content = text.partition("\n")
        if digest == _digest(model, content):
            return BuiltAcm(**json.loads(content))
    built = build_acm(robot)
    content = json.dumps(dataclasses.asdict(built))
    with contextlib.suppress(OSError):  # the folder may be read-only
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, f"{_digest(model, content)}\n{content}")
    return built


def _combined(reports: list[BuiltAcm]) -> BuiltAcm:
    """Return the left arm's part of the first report and the right arm's of the second."""
    pairs: list[list[str]] = []
    for side, report in zip(SIDES, reports, strict=True):
        pairs += [row for row in report.pairs if row[0].startswith(f"{side}_")]
    fewest = min(reports, key=lambda report: report.samples_n)
    return BuiltAcm(
        pairs=sorted(pairs),
        rounds=fewest.rounds,
        converged=all(report.converged for report in reports),
        rarest=fewest.rarest,
        rarest_n=fewest.rarest_n,
    )


def _digest(model: str, content: str) -> str:
    return hashlib.sha256(f"{model}\n{content}".encode()).hexdigest()


class _Sampler:
    """Counts contacts of pairs of the left arm's links at random postures."""

    def __init__(self, robot: Robot, pairs: list[LinkPair]) -> None:
        self._robot = robot
        self._rows = {frozenset(pair): k for k, pair in enumerate(pairs)}
        # MuJoCo alone reports which pairs touch.
        self._engine: Any = ENGINES["mujoco"](Pairs(robot, tuple(pairs)))
        self._rng = stream(_SEED, "allowed-collisions")
        self._at_home = np.zeros(len(pairs), dtype=bool)
        self._at_home[self._touching(robot.home)] = True
        self.counts = np.zeros(len(pairs), dtype=int)
        self.samples_n = 0

    def _touching(self, q: np.ndarray) -> list[int]:
        """Return the rows of the pairs that touch at q (n,)."""
        return [self._rows[pair] for pair in self._engine.touching_pairs(q)]

    def draw(self, count: int) -> None:
        """Add random postures."""
        robot = self._robot
        arm = robot.groups[f"{SIDES[0]}_arm"]
        Q = np.tile(robot.home, (count, 1))
        size = (count, robot.dof_per_arm)
        Q[:, arm] = self._rng.uniform(robot.q_lower[arm], robot.q_upper[arm], size)
        for q in Q:
            self.counts[self._touching(q)] += 1
        self.samples_n += count

    def kinds(self) -> np.ndarray:
        """Return "never", "always" or "checked" by pair."""
        always = self._at_home & (self.counts >= ALWAYS_FRACTION * self.samples_n)
        return np.where(self.counts == 0, "never", np.where(always, "always", "checked"))

    def rarest(self) -> int:
        """Return the row of the touching pair with fewest contacts."""
        touched = np.flatnonzero(self.counts)
        return int(touched[np.argmin(self.counts[touched])]) if len(touched) else 0


def build_acm(
    robot: Robot,
    samples_min: int = SAMPLES_MIN,
    samples_max: int = SAMPLES_MAX,
) -> BuiltAcm:
    """Build the matrix; see `acm_report` for two different arms."""
    if robot.arms[0] != robot.arms[1]:
        of_each = [build_acm(Robot(arm), samples_min, samples_max) for arm in robot.arms]
        return _combined(of_each)
    reasons = _structural_pairs(robot)
    pairs = [pair for pair in itertools.combinations(_left_links(robot), 2) if pair not in reasons]
    sampler = _Sampler(robot, pairs)
    kinds = np.full(len(pairs), "", dtype="U7")
    rounds: list[dict[str, Any]] = []
    quiet = 0
    batch = samples_min
    samples_max = max(samples_max, samples_min)
    while quiet < QUIET_DOUBLINGS and sampler.samples_n + batch <= samples_max:
        sampler.draw(batch)
        batch = sampler.samples_n
        before = kinds
        kinds = sampler.kinds()
        changed: list[str] = []
        if rounds:
            changed = [" + ".join(pairs[k]) for k in np.flatnonzero(kinds != before)]
            quiet = 0 if changed else quiet + 1
        rounds.append({"samples_n": sampler.samples_n, "changed": changed})
    labels = {"never": f"never in {sampler.samples_n} samples", "always": "always"}
    for pair, kind in zip(pairs, kinds.tolist(), strict=True):
        if kind in labels:
            reasons[pair] = labels[kind]
    rarest = sampler.rarest()
    return BuiltAcm(
        pairs=_of_both_arms(reasons),
        rounds=rounds,
        converged=quiet >= QUIET_DOUBLINGS,
        rarest=" + ".join(pairs[rarest]),
        rarest_n=int(sampler.counts[rarest]),
    )


def _of_both_arms(reasons: dict[LinkPair, str]) -> list[list[str]]:
    """Return the left arm's rows for both arms, sorted: two names, reason."""
    rows: list[list[str]] = []
    for side in SIDES:
        for pair, reason in reasons.items():
            names = sorted(name.replace(SIDES[0], side, 1) for name in pair)
            rows.append([*names, reason])
    return sorted(rows)


def _left_links(robot: Robot) -> dict[str, int]:
    """Return the left arm's colliding links and the number of joints before each."""
    return {
        name: link.joints_before
        for name, link in links_of(robot).items()
        if link.collides and link.side == SIDES[0]
    }


def _structural_pairs(robot: Robot) -> dict[LinkPair, str]:
    """Return reasons that need no samples, by pair in the order of the links; both arms are alike."""
    links = _left_links(robot)
    ruled_out = [{f"{SIDES[0]}_{link}" for link in pair} for pair in robot.arm.never_touch]
    moved_by_last: dict[int, str] = {}
    """By number of joints before it: the link that the last of them moves."""
    for name, joints_n in links.items():
        moved_by_last.setdefault(joints_n, name)
    reasons: dict[LinkPair, str] = {}
    for a, b in itertools.combinations(links, 2):
        joints_between = links[b] - links[a]
        if joints_between == 0:
            reasons[a, b] = "rigid"
        elif joints_between == 1 and moved_by_last[links[b]] == b:
            reasons[a, b] = "adjacent"
        elif {a, b} in ruled_out:
            reasons[a, b] = "model"
    return reasons


def model_hash(robot: Robot) -> str:
    """Hash geometry (URDF, meshes), limits and home, without installation paths."""
    urdf = pair_urdf(robot)
    digest = hashlib.sha256(_RULE_VERSION.encode())
    digest.update(re.sub(r'filename="[^"]*/([^"/]+)"', r'filename="\1"', urdf).encode())
    for file in sorted(set(re.findall(r'filename="([^"]+)"', urdf))):
        digest.update(Path(file).read_bytes())
    for arm in dict.fromkeys(robot.arms):
        constants = (arm.home, arm.q_lower, arm.q_upper, robot.hand.travel_m, arm.never_touch)
        digest.update(repr(constants).encode())
    return digest.hexdigest()
