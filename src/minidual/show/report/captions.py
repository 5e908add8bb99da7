"""What artefacts and faults are called on the page, by the names that stages and the success test give them."""

from __future__ import annotations

from pathlib import PurePosixPath

_CAPTIONS: dict[tuple[str, str], str] = {
    ("env-check", "sine.mp4"): "All joints follow a sine",
    ("env-check", "cameras.png"): "What each camera sees at home",
    ("env-check", "tracking.png"): "Step, sine and single joints: target against measurement",
    ("plan", "paths.png"): "One query a group: the tools' paths among the obstacles",
    ("plan", "times.png"): "Planning times, and what they are spent on",
    ("carry", "carry.mp4"): "The median carry under object impedance control",
    ("carry", "median.png"): "The median trial",
    ("carry", "worst.png"): "The worst trial: the first failure, or the largest tilt",
    ("teleop-record", "demonstration.mp4"): "A recorded demonstration",
    ("teleop-record", "quality.png"): "Quality of every episode",
    ("train-act", "loss.png"): "Training and validation loss",
    ("deploy", "success.mp4"): "The policy succeeds on a start it never saw",
    ("deploy", "failure.mp4"): "The policy fails on a start it never saw",
}

FAULTS: dict[str, str] = {
    "held": "grip lost",
    "rose": "never lifted clear",
    "level": "tilted too far",
    "arrived": "missed the goal",
    "released": "not released",
    "at_rest": "not at rest",
    "on_time": "too late",
    "squeezed": "internal force lost",
    "whole": "the object broke",
    "clear": "touched the obstacle",
    "turned": "pointed the wrong way at the goal",
}
"""The conditions of the success test, as words for what it means when one does not hold."""


def caption(stage: str, name: str) -> str:
    """Return what an artefact shows; words from its file name where nobody said."""
    path = PurePosixPath(name)
    words = path.stem.replace("_", " ").replace("-", " ").strip()
    return _CAPTIONS.get((stage, path.name), words[:1].upper() + words[1:])


def fault(name: str) -> str:
    """Return the words for the condition that failed, its own name for one that nobody described."""
    return FAULTS.get(name, name.replace("_", " ") or "unnamed")
