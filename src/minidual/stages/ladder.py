"""The debug ladder: six levels, from the joints to the policy, and the checks that prove each.

Faults travel upwards: a policy that misses the rod may be a camera, a plan or a joint. So when something fails, look
at the lowest level that does not hold, and at nothing above it. Every check of a stage belongs to exactly one level:
the lowest whose pattern matches its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from minidual.gate.check import Check
    from minidual.gate.gate import Gate, StageState
    from minidual.gate.table import CommandText

Standing = Literal["holds", "fails", "unproven"]


@dataclass(frozen=True)
class Proof:
    """The checks of one stage that prove a level.

    stage: name of the stage.
    checks: patterns of check names (`*` stands for anything).
    """

    stage: str
    checks: tuple[str, ...] = ("*",)


@dataclass(frozen=True)
class Level:
    """One level: what it is called, the question it answers, and its proofs."""

    number: int
    name: str
    question: str
    proofs: tuple[Proof, ...]


LADDER: tuple[Level, ...] = (
    Level(
        0,
        "simulation and joints",
        "Does every joint move as the model says, and do the cameras see?",
        (Proof("env-check"),),
    ),
    Level(
        1,
        "one arm",
        "Does one arm find its way alone?",
        (Proof("plan", ("left_arm.*", "right_arm.*", "second_seed.left_arm.*", "second_seed.right_arm.*")),),
    ),
    Level(
        2, "both arms", "Do both arms move together, and carry an object between them?", (Proof("plan"), Proof("carry"))
    ),
    Level(
        3,
        "teleoperation",
        "Does the follower follow its leader in time, and succeed at the task?",
        (
            Proof(
                "teleop-record",
                ("latency*", "episodes_per_min", "success*", "attempts*", "leader*", "delay*", "passiv*", "network*"),
            ),
        ),
    ),
    Level(4, "data", "Is what was recorded whole, smooth and converted without loss?", (Proof("teleop-record"),)),
    Level(
        5,
        "policy",
        "Does the policy learn from the data, and does what it learned work?",
        (Proof("train-act"), Proof("deploy")),
    ),
)
"""The levels, lowest first."""


@dataclass(frozen=True)
class ProofFound:
    """What one proof says now.

    state: of the stage. reasons: why it is neither pass nor fail.
    passed, limited: how many of this level's checks pass, of how many. failing: those that do not.
    """

    stage: str
    state: str
    reasons: tuple[str, ...]
    passed: int
    limited: int
    failing: tuple[Check, ...]
    acceptance: bool

    @property
    def standing(self) -> Standing:
        """Fails where a check says so; unproven where the stage's verdict says nothing that counts now."""
        if self.state == "fail" and self.failing:
            return "fails"
        return "holds" if self.state in ("pass", "fail") and self.limited else "unproven"


@dataclass(frozen=True)
class LevelFound:
    """Where a level stands."""

    level: Level
    proofs: tuple[ProofFound, ...]

    @property
    def standing(self) -> Standing:
        """Holds if every proof does; fails if one fails."""
        standings = [proof.standing for proof in self.proofs]
        if "fails" in standings:
            return "fails"
        return "holds" if all(item == "holds" for item in standings) else "unproven"

    @property
    def blocking(self) -> ProofFound:
        """The first proof that fails, else the first that is missing."""
        for wanted in ("fails", "unproven"):
            for proof in self.proofs:
                if proof.standing == wanted:
                    return proof
        return self.proofs[0]


@dataclass(frozen=True)
class Walk:
    """The ladder of one run.

    levels: lowest first. lowest: the lowest that does not hold, None if all do.
    """

    levels: tuple[LevelFound, ...]
    lowest: LevelFound | None = None
    next_command: str = ""
    lines: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """Return the walk as JSON types."""
        lowest = self.lowest
        return {
            "levels": [_level_json(found) for found in self.levels],
            "lowest": None if lowest is None else lowest.level.number,
            "because": list(self.lines),
            "next": self.next_command or None,
        }


def owner(stage: str, check: str, ladder: Sequence[Level] = LADDER) -> int | None:
    """Return the number of the level that a check belongs to, or None if none claims it."""
    for level in ladder:
        for proof in level.proofs:
            if proof.stage == stage and any(fnmatchcase(check, pattern) for pattern in proof.checks):
                return level.number
    return None


def walk(gate: Gate, command: CommandText, ladder: Sequence[Level] = LADDER) -> Walk:
    """Walk the ladder from the bottom and stop at the lowest level that does not hold.

    Args:
        gate: Judges the stages of a run; stages that its table lacks are left out.
        command: Turns "plan" into the full command to type.
        ladder: The levels.
    """
    levels: list[LevelFound] = []
    for level in ladder:
        proofs = tuple(
            _look(gate.state(proof.stage), level, ladder) for proof in level.proofs if proof.stage in gate.table.names
        )
        if proofs:
            levels.append(LevelFound(level, proofs))
    lowest = next((found for found in levels if found.standing != "holds"), None)
    if lowest is None:
        return Walk(tuple(levels))
    proof = lowest.blocking
    return Walk(tuple(levels), lowest, command(_next_stage(gate, proof)), _why(proof))


def _look(state: StageState, level: Level, ladder: Sequence[Level]) -> ProofFound:
    verdict = state.verdict
    checks = [] if verdict is None else [c for c in verdict.checks if c.limited]
    own = [check for check in checks if owner(state.name, check.name, ladder) == level.number]
    failing = tuple(check for check in own if check.passed is not True)
    return ProofFound(
        state.name,
        state.state,
        state.reasons,
        len(own) - len(failing),
        len(own),
        failing,
        verdict is not None and verdict.acceptance,
    )


def _next_stage(gate: Gate, proof: ProofFound) -> str:
    """Return the stage to run: the proof's own, or the one above it that keeps its gate closed."""
    cause = gate.root_cause(proof.stage) if proof.standing == "unproven" else None
    return proof.stage if cause is None else cause.name


def _why(proof: ProofFound) -> tuple[str, ...]:
    if proof.standing == "fails":
        lines: list[str] = []
        for check in proof.failing:
            lines.append(f"{proof.stage}: {check.sentence()}")
            lines += [f"  {label}: {text}" for label, text in (("why", check.why), ("remedy", check.remedy)) if text]
        return tuple(lines)
    if proof.state in ("pass", "fail"):
        return (f"{proof.stage}: its verdict holds no check for this level",)
    return (f"{proof.stage} is {proof.state}", *(f"  {reason}" for reason in proof.reasons))


def _level_json(found: LevelFound) -> dict[str, Any]:
    return {
        "number": found.level.number,
        "name": found.level.name,
        "question": found.level.question,
        "standing": found.standing,
        "proofs": [
            {
                "stage": proof.stage,
                "state": proof.state,
                "reasons": list(proof.reasons),
                "standing": proof.standing,
                "passed": proof.passed,
                "limited": proof.limited,
                "acceptance": proof.acceptance,
                "failing": [check.to_json() for check in proof.failing],
            }
            for proof in found.proofs
        ],
    }
