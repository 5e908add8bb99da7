"""All troubles, by name and by number."""

from typing import Any

from minidual.errors import UsageError, unknown_name
from minidual.stages.troubles.environment import ENVIRONMENT
from minidual.stages.troubles.learning import LEARNING
from minidual.stages.troubles.planning import PLANNING
from minidual.stages.troubles.recording import RECORDING
from minidual.stages.troubles.trouble import (
    LEVELS,
    Mistake,
    Trouble,
    check,
    command,
    refusal,
)

SECTIONS: dict[str, tuple[Trouble, ...]] = {
    "Environment and hardware": ENVIRONMENT,
    "Planning and execution": PLANNING,
    "Teleoperation and data": RECORDING,
    "Policies": LEARNING,
}
TROUBLES: dict[str, Trouble] = {row.name: row for rows in SECTIONS.values() for row in rows}

MISTAKES = (
    Mistake(
        "the policy seldom succeeds",
        "too little data",
        "contact of hands and object",
        check("carry", "success_rate"),
    ),
    Mistake(
        "carries fail",
        "impedance gains",
        "one joint that follows badly",
        check("env-check", "joints.overshoot_max_rad"),
    ),
    Mistake(
        "teleoperation stutters",
        "the network",
        "a busy processor",
        check("env-check", "control.step_median_us"),
    ),
    Mistake(
        "planning takes too long",
        "the planning library",
        "pairs that need no check",
        command("minidual plan --acm"),
    ),
    Mistake(
        "a mode switch fails",
        "the life cycle of controllers",
        "commands left from before",
        refusal("before_switch"),
    ),
)
"""Troubles that are often looked for on too high a level."""


def trouble(name: str) -> Trouble:
    """Return the row of a name or a number.

    Raises:
        UsageError: There is none.
    """
    if name.strip().isdigit():
        number = int(name)
        for row in TROUBLES.values():
            if row.number == number:
                return row
        raise UsageError(f"no trouble {number}; they have the numbers 1 to {len(TROUBLES)}")
    if name not in TROUBLES:
        remedy = unknown_name("trouble", name, TROUBLES).remedy or "minidual doctor --list"
        raise UsageError(
            f"no trouble '{name}'; `minidual doctor --list` prints the {len(TROUBLES)} names",
            remedy=remedy,
        )
    return TROUBLES[name]


def explanation(row: Trouble) -> list[str]:
    """Return a row for a terminal."""
    level = LEVELS[row.level]
    places = {
        "here": "probed by `minidual doctor` on this machine",
        "in a run": "probed by `minidual doctor` in what a run holds",
        "": "explained only: what detects or mends it acts where it happens",
    }
    lines = [
        f"{row.name} (row {row.number}, level {level.name})",
        f"  symptom   {row.symptom}",
        f"  cause     {row.cause}",
        f"  answer    {row.answer}",
    ]
    lines += [f"  {reference.kind:<9} {reference.name}" for reference in row.references]
    lines += [f"  {places[row.probed]}", f"  at this level: {level.question} ({level.command})"]
    return lines


def listing() -> list[str]:
    """Return all names by level, for a terminal."""
    lines: list[str] = []
    for level, text in LEVELS.items():
        rows = [row for row in TROUBLES.values() if row.level is level]
        lines += [f"{text.name}:", f"  {text.question}"]
        lines += [f"  {row.number:>2} {row.name:<19} {row.symptom}" for row in rows]
    return lines


def as_document(row: Trouble) -> dict[str, Any]:
    """Return a row as JSON types."""
    return {
        "number": row.number,
        "name": row.name,
        "level": LEVELS[row.level].name,
        "symptom": row.symptom,
        "cause": row.cause,
        "answer": row.answer,
        "references": [{"kind": ref.kind, "name": ref.name} for ref in row.references],
        "probed": row.probed,
    }
