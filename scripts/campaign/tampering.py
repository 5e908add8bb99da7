"""Sealed files of a finished run are changed: `status` names each, and the gates above it close."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from minidual.errors import ExitCode
from minidual.gate.canonical import digest, dumps
from minidual.stages.registry import STAGES
from scripts.campaign.case import Case, Place, Ran, Result, command, judge
from scripts.campaign.values import Where, dotted, parent_of, replace

Change = Callable[[Path, np.random.Generator], None]
"""Changes a file, with random numbers."""
_BURST_BYTES = 64


def rewrite(path: Path, content: bytes) -> None:
    """Replace a file that may be a hard link to the source."""
    path.unlink()
    path.write_bytes(content)


def flip(path: Path, rng: np.random.Generator) -> None:
    """Flip one bit."""
    content = bytearray(path.read_bytes())
    index = int(rng.integers(len(content)))
    content[index] ^= 1 << int(rng.integers(8))
    rewrite(path, bytes(content))


def burst(path: Path, rng: np.random.Generator) -> None:
    """Change up to 64 bytes in a row."""
    content = bytearray(path.read_bytes())
    begin = int(rng.integers(len(content)))
    end = min(begin + _BURST_BYTES, len(content))
    for index in range(begin, end):
        content[index] ^= 0x5A
    rewrite(path, bytes(content))


def truncate(path: Path, rng: np.random.Generator) -> None:
    """Cut the end off."""
    content = path.read_bytes()
    rewrite(path, content[: int(rng.integers(len(content)))])


def append(path: Path, rng: np.random.Generator) -> None:
    """Add random bytes."""
    rewrite(path, path.read_bytes() + rng.bytes(16))


def noise(path: Path, rng: np.random.Generator) -> None:
    """Replace the content by random bytes of the same length."""
    rewrite(path, rng.bytes(path.stat().st_size))


def delete(path: Path, rng: np.random.Generator) -> None:
    """Delete the file."""
    path.unlink()


def folder(path: Path, rng: np.random.Generator) -> None:
    """Put a folder in its place."""
    path.unlink()
    path.mkdir()


def loop(path: Path, rng: np.random.Generator) -> None:
    """Put a symbolic link to itself in its place."""
    path.unlink()
    path.symlink_to(path.name)


def foreign(path: Path, rng: np.random.Generator) -> None:
    """Put a symbolic link to another file in its place."""
    path.unlink()
    target = "/etc/hostname" if rng.random() < 0.5 else "/no/such/file"
    path.symlink_to(target)


def pipe(path: Path, rng: np.random.Generator) -> None:
    """Put a FIFO in its place: reading it would wait for ever."""
    path.unlink()
    os.mkfifo(path)


def device(path: Path, rng: np.random.Generator) -> None:
    """Put a link to an endless device in its place."""
    path.unlink()
    path.symlink_to("/dev/zero")


CHANGES: tuple[Change, ...] = (
    flip,
    burst,
    truncate,
    append,
    noise,
    delete,
    folder,
    loop,
    foreign,
    pipe,
    device,
)
BYTE_CHANGES = tuple(change for change in CHANGES if change is not delete)
"""Changes after which there still is something to read."""
_STRAYS = ("stray.txt", ".hidden", "out/of/place.csv", "verdict.json.bak", "zz.hdf5")
_FIELDS_N = 2
"""Fields that are replaced in a nested list or mapping."""


def sealed(source: Path) -> list[str]:
    """Return the files of the stages, relative to the run."""
    paths = (path for stage in STAGES for path in (source / stage).rglob("*"))
    return sorted(path.relative_to(source).as_posix() for path in paths if path.is_file())


def tamper_cases(source: Path) -> Iterator[Case]:
    """Each change of each file, and each file added."""
    for name in sealed(source):
        for change in CHANGES:
            yield Case(f"{change.__name__} {name}", partial(_tamper, name, change))
    for stage in STAGES:
        for stray in _STRAYS:
            yield Case(f"add {stage}/{stray}", partial(_stray, stage, stray))


def _tamper(name: str, change: Change, place: Place, result: Result) -> None:
    """Change a file; `status` must name it."""
    stage, *_ = name.split("/")
    path = place.runs / "smoke" / name
    original = json.loads(path.read_bytes()) if path.name == "verdict.json" else None
    change(path, place.rng)
    if original is not None and _same_json(path, original):
        result.saw("harmless: the same JSON")
        return
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    row = _row(ran, stage)
    if row["state"] == "pass":
        result.forbidden.append(
            f"a silent pass: status of {stage} after {change.__name__} of {name}",
        )
        return
    reasons = " ".join(row["reasons"])
    if path.name not in reasons and row["state"] not in ("missing", "blocked", "incomplete"):
        result.forbidden.append(f"not named: {reasons[:160]}")
    result.saw(f"named: {row['state']}")
    if int(place.rng.integers(4)) == 0:
        _try_report(stage, place, result)


def _try_report(changed_stage: str, place: Place, result: Result) -> None:
    """Run `report` behind a changed stage; its gate must be closed."""
    allowed = [ExitCode.GATE_CLOSED]
    if changed_stage == "report":
        allowed = [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED]  # results of other code fail
    judge(result, "report", command(place, "report", *place.options()), allowed)


def _row(ran: Ran, stage: str) -> dict[str, Any]:
    """Return the row of a stage in the document of `status`."""
    return next(row for row in ran.document()["stages"] if row["name"] == stage)


def _same_json(path: Path, original: Any) -> bool:
    try:
        return path.is_file() and json.loads(path.read_bytes()) == original
    except (OSError, ValueError):
        return False


def _stray(stage: str, stray: str, place: Place, result: Result) -> None:
    """Add a file to a finished stage; `status` must name it."""
    path = place.runs / "smoke" / stage / stray
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(place.rng.bytes(64))
    ran = command(place, "status", "--json", *place.options())
    if judge(result, "status", ran, [ExitCode.PASS]):
        row = _row(ran, stage)
        if path.name not in " ".join([*row["reasons"], *row["warnings"]]):
            result.forbidden.append(f"a silent pass: {stage}/{stray} is not named")
        result.saw(f"named: {row['state']}")


STRANGE: dict[str, Any] = {
    "null": None,
    "true": True,
    "number": 7,
    "negative": -1.5,
    "huge": 10**400,
    "tiny": 1e-300,
    "text": "pass",
    "control": "\x1b[2J\u202e",
    "long": "x" * 100_000,
    "list": [],
    "nested": [[[[{}]]]],
    "object": {"pass": True},
    "NaN": float("nan"),
}


def verdict_cases(source: Path) -> Iterator[Case]:
    """Each field of each verdict replaced by each strange value.

    The digest is made right, so that the type is what fails.
    """
    for stage in STAGES:
        record = json.loads((source / stage / "verdict.json").read_bytes())
        for where in _fields(record):
            for kind in STRANGE:
                body = partial(_strange, stage, where, kind)
                yield Case(f"{stage} {dotted(where)} = {kind}", body)
    for stage in STAGES:
        for kind, text in HOSTILE_JSON.items():
            yield Case(f"{stage} {kind}", partial(_hostile, stage, text))


HOSTILE_JSON: dict[str, Callable[[str], bytes]] = {
    "deep": lambda _: b"[" * 100_000 + b"]" * 100_000,
    "deep objects": lambda _: b'{"a":' * 50_000 + b"1" + b"}" * 50_000,
    "invalid UTF-8": lambda text: b"\xff\xfe" + text.encode(),
    "empty": lambda _: b"",
    "null bytes": lambda text: b"\0" * len(text),
    "not an object": lambda _: b"[1, 2]",
    "twice": lambda text: text.encode() * 2,
    "long number": lambda _: b'{"schema": ' + b"9" * 10_000 + b"}",
    "surrogate": lambda _: rb'{"schema": "\ud800"}',
    "keys doubled": lambda text: text.replace("{", '{"status": "pass",', 1).encode(),
}


def _fields(tree: Any, where: Where = ()) -> Iterator[Where]:
    """Yield the places of values; of a nested list or mapping only the first two."""
    if where:
        yield where
    children: list[tuple[Any, Any]] = []
    if isinstance(tree, dict):
        children = list(tree.items())
    elif isinstance(tree, list):
        children = list(enumerate(tree))
    if where:
        children = children[:_FIELDS_N]
    for key, value in children:
        yield from _fields(value, (*where, key))


def _strange(stage: str, where: Where, kind: str, place: Place, result: Result) -> None:
    file = place.runs / "smoke" / stage / "verdict.json"
    record = json.loads(file.read_bytes())
    original = parent_of(record, where)[where[-1]]
    strange = STRANGE[kind]
    if original == strange and type(original) is type(strange):
        result.saw("harmless: the same JSON")
        return
    replace(record, where, strange)
    if where != ("digest",):
        record["digest"] = digest({key: record[key] for key in record if key != "digest"})
    try:
        text = dumps(record)
    except ValueError:
        text = json.dumps(record)
    rewrite(file, text.encode())
    _check_reading(stage, place, result, forged=True)


def _hostile(stage: str, text: Callable[[str], bytes], place: Place, result: Result) -> None:
    file = place.runs / "smoke" / stage / "verdict.json"
    rewrite(file, text(file.read_text(encoding="utf-8")))
    _check_reading(stage, place, result, forged=False)


def _check_reading(stage: str, place: Place, result: Result, *, forged: bool) -> None:
    """Look at a changed verdict with the commands that read it.

    A forgery with the right digest may pass in the last stage alone, as documented.
    """
    file = place.runs / "smoke" / stage / "verdict.json"
    content = file.read_bytes()
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    states = {row["name"]: row["state"] for row in ran.document()["stages"]}
    passes = states[stage] == "pass"
    if passes and any(states[name] == "pass" for name in _downstream(stage)):
        result.forbidden.append(
            f"a silent pass: the changed verdict of {stage} is believed downstream",
        )
    if passes and not forged:
        result.forbidden.append(f"a silent pass: status of {stage}")
    result.saw(
        "forged with its digest, passes alone" if passes else f"named: {states[stage]}",
    )
    judge(result, "explain", command(place, "explain", stage, *place.options()), [ExitCode.PASS])
    ran = command(place, "status", *place.options())
    judge(result, "status as text", ran, [ExitCode.PASS])
    if "\x1b[2J" in ran.out + ran.err or "\u202e" in ran.out + ran.err:
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if file.read_bytes() != content:
        result.forbidden.append("reading changed the verdict")


def _downstream(stage: str) -> list[str]:
    """Return the stages that require a stage, directly or not."""
    return [name for name in STAGES if stage in STAGES.upstream(name)]
