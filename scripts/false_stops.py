"""Count the clean trials of each run that were stopped, and by what; docs/supervisor.md.

python -m scripts.false_stops

A clean trial is an undisturbed one. A reflex, a fault, a refusal or a check of the policy stops it.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

CLEAN = {"clean", "held_out", "training"}
"""Conditions of undisturbed trials."""
NO_DEMONSTRATION = ("reflex", "the arbiter refused", "the leader fell silent")
"""How the reason of an attempt begins if it was stopped, not judged."""
TABLES = {
    "carry/trials.csv": "aborted",
    "teleop-record/quality.csv": "reason",
    "deploy/trials.csv": "aborted",
    "benchmark/benchmark.csv": "aborted",
}
"""Tables of trials in a run, and the column that says why a trial ended early."""


def clean_trials(run: Path) -> Iterator[tuple[str, str]]:
    """Yield (table, task, method and condition; why it was stopped) of each clean trial of a run."""
    for table, column in TABLES.items():
        path = run / table
        if not path.exists():
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        for row in csv.DictReader(lines):
            if row.get("condition", "clean") not in CLEAN:
                continue
            reason = row[column]
            if column == "reason" and not reason.startswith(NO_DEMONSTRATION):
                reason = ""
            labels = [row[name] for name in ("task", "method", "condition") if name in row]
            yield " ".join([table, *labels]), reason


def first_words(reason: str) -> str:
    """Return the name of the reflex, or the first word, of a reason."""
    reflex = re.search(r"reflex (?!at )[\w.]+", reason)
    word = reflex or re.search(r"\w+", reason)
    return word[0] if word else ""


def stops(run: Path) -> dict[str, tuple[int, int]]:
    """Print and return {table, task, method and condition: (stopped, clean trials)}."""
    reasons: dict[str, list[str]] = {}
    for group, reason in clean_trials(run):
        reasons.setdefault(group, []).append(reason)
    counts = {}
    for group, told in reasons.items():
        stopped = [first_words(reason) for reason in told if reason]
        names = dict(Counter(stopped)) or ""
        print(f"{group}: {len(stopped)} of {len(told)} stopped", names)
        counts[group] = (len(stopped), len(told))
    return counts


if __name__ == "__main__":
    for folder in sorted(Path("runs").glob("*/")):
        print(folder)
        stops(folder)
