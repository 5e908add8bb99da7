"""Scene and goal files for `plan`, with values replaced and their bytes broken."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from minidual.errors import ExitCode
from scripts.campaign.case import Case, Place, Result, command, has_control_characters, judge
from scripts.campaign.recordings import REFUSED
from scripts.campaign.tampering import BYTE_CHANGES, Change
from scripts.campaign.values import Where, dotted, numbers, places, replace

_EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
_LIMIT_S = 30.0
_TO_GOAL = "--to"
_WORDS = {
    "bench-scene": ("--acm", "--scene"),
    "beside-post": (_TO_GOAL,),
    "straight-down": (_TO_GOAL,),
}
"""Options of `plan` that the name of a file follows, by file."""
STRANGE = (
    None,
    [],
    {},
    -1,
    0,
    1e-300,
    1e300,
    float("nan"),
    float("inf"),
    "text",
    True,
    [[]],
    [1] * 5000,
    "x" * 9000,
)


def warm(place: Place) -> None:
    """Load what a plan needs."""
    for name in ("bench-scene", "beside-post"):
        _plan(name, _copied_examples(name, place), place, Result())


def scene_cases(source: Path) -> Iterator[Case]:
    """Each value of each file replaced by each strange value, and its bytes broken."""
    for name in _WORDS:
        tree = yaml.safe_load((_EXAMPLES / f"{name}.yaml").read_text(encoding="utf-8"))
        for where in places(tree):
            for number in range(len(STRANGE)):
                body = partial(_value, name, where, number)
                yield Case(f"{name} {dotted(where)} {number}", body, _LIMIT_S)
        for change in BYTE_CHANGES:
            for number in range(4):
                body = partial(_bytes, name, change)
                yield Case(f"{name} bytes {change.__name__} {number}", body, _LIMIT_S)


def _copied_examples(name: str, place: Place) -> Path:
    """Copy all examples, which name each other; return the file of one."""
    for file in _EXAMPLES.iterdir():
        if file.is_file():
            shutil.copy(file, place.folder)
    return place.folder / f"{name}.yaml"


def _plan(name: str, path: Path, place: Place, result: Result) -> None:
    words = ["plan", *_WORDS[name], str(path), "--json", "--runs-dir", str(place.no_runs)]
    if _TO_GOAL in words:
        words += ["--budget-s", "3"]
    ran = command(place, *words)
    judge(result, "plan", ran, [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED, *REFUSED])
    if has_control_characters(ran.err):
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if ran.code == ExitCode.PASS:
        if not all(np.isfinite(number) for number in numbers(json.loads(ran.out))):
            result.forbidden.append("a silent pass: a number of the plan is not finite")
        result.saw("taken")
    elif ran.code == ExitCode.ACCEPTANCE_FAILED:
        result.saw("no plan")
    else:
        result.saw("refused")


def _value(name: str, where: Where, number: int, place: Place, result: Result) -> None:
    path = _copied_examples(name, place)
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    replace(tree, where, STRANGE[number])
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    _plan(name, path, place, result)


def _bytes(name: str, change: Change, place: Place, result: Result) -> None:
    path = _copied_examples(name, place)
    change(path, place.rng)
    _plan(name, path, place, result)
