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
from scripts.campaign.case import Case, Place, Result, command, judge

Change = Callable[[Path, np.random.Generator], None]


def rewrite(path: Path, content: bytes) -> None:
    """Replace a file that may be a hard link to the source."""
    path.unlink()
    path.write_bytes(content)


def flip(path: Path, rng: np.random.Generator) -> None:
    """Flip one bit."""
    content = bytearray(path.read_bytes())
    content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
    rewrite(path, bytes(content))


def burst(path: Path, rng: np.random.Generator) -> None:
    """Overwrite up to 64 bytes with random ones."""
    content = bytearray(path.read_bytes())
    begin = int(rng.integers(len(content)))
    length = min(64, len(content) - begin)
    content[begin : begin + length] = bytes(b ^ 0x5A for b in content[begin : begin + length])
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
    path.symlink_to("/etc/hostname" if rng.random() < 0.5 else "/no/such/file")


def pipe(path: Path, rng: np.random.Generator) -> None:
    """Put a FIFO in its place: reading it would wait for ever."""
    path.unlink()
    os.mkfifo(path)


def device(path: Path, rng: np.random.Generator) -> None:
    """Put a link to an endless device in its place."""
    path.unlink()
    path.symlink_to("/dev/zero")


CHANGES: tuple[Change, ...] = (
    flip, burst, truncate, append, noise, delete, folder, loop, foreign, pipe, device,
)  # fmt: skip


def sealed(source: Path) -> list[str]:
    """Return the files of the stages, relative to the run."""
    stages = [source / name for name in STAGES]
    return sorted(
        p.relative_to(source).as_posix()
        for stage in stages
        for p in stage.rglob("*")
        if p.is_file()
    )


def tamper_cases(source: Path) -> Iterator[Case]:
    """Each change of each file, and each file added."""
    for name in sealed(source):
        for change in CHANGES:
            yield Case(f"{change.__name__} {name}", partial(_tamper, name, change))
    for name in STAGES:
        for stray in ("stray.txt", ".hidden", "out/of/place.csv", "verdict.json.bak", "zz.hdf5"):
            yield Case(f"add {name}/{stray}", partial(_stray, name, stray))


def _tamper(name: str, change: Change, place: Place, result: Result) -> None:
    stage = name.split("/")[0]
    path = place.runs / "smoke" / name
    is_verdict = path.name == "verdict.json"
    before = json.loads(path.read_bytes()) if is_verdict else None
    change(path, place.rng)
    if is_verdict and _same_json(path, before):
        result.saw("harmless: the same JSON")
        return
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    states = {row["name"]: row for row in ran.document()["stages"]}
    if states[stage]["state"] == "pass":
        result.forbidden.append(
            f"a silent pass: status of {stage} after {change.__name__} of {name}",
        )
        return
    said = " ".join(states[stage]["reasons"])
    if path.name not in said and states[stage]["state"] not in ("missing", "blocked", "incomplete"):
        result.forbidden.append(f"not named: {said[:160]}")
    result.saw(f"named: {states[stage]['state']}")
    if int(place.rng.integers(4)) == 0:
        gate = command(place, "report", *place.options())
        own = [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED]  # 1: results of other code
        allowed = own if stage == "report" else [ExitCode.GATE_CLOSED]
        judge(result, "report", gate, allowed)


def _same_json(path: Path, before: Any) -> bool:
    try:
        return path.is_file() and json.loads(path.read_bytes()) == before
    except (OSError, ValueError):
        return False


def _stray(stage: str, stray: str, place: Place, result: Result) -> None:
    path = place.runs / "smoke" / stage / stray
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(place.rng.bytes(64))
    ran = command(place, "status", "--json", *place.options())
    if judge(result, "status", ran, [ExitCode.PASS]):
        row = next(row for row in ran.document()["stages"] if row["name"] == stage)
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
    """Each field of each verdict replaced by each strange value; the digest made right, so that the type is what fails."""
    for stage in STAGES:
        record = json.loads((source / stage / "verdict.json").read_bytes())
        for path in _fields(record):
            for kind in STRANGE:
                yield Case(
                    f"{stage} {'.'.join(map(str, path))} = {kind}",
                    partial(_strange, stage, path, kind),
                )
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


def _fields(record: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the places of values; of a list or a large mapping only the first two."""
    if path:
        yield path
    items = (
        record.items()
        if isinstance(record, dict)
        else enumerate(record)
        if isinstance(record, list)
        else ()
    )
    chosen = list(items)
    for key, value in chosen if len(path) == 0 else chosen[:2]:
        yield from _fields(value, (*path, key))


def _strange(stage: str, path: tuple[Any, ...], kind: str, place: Place, result: Result) -> None:
    file = place.runs / "smoke" / stage / "verdict.json"
    record = json.loads(file.read_bytes())
    inner = record
    for key in path[:-1]:
        inner = inner[key]
    if inner[path[-1]] == STRANGE[kind] and type(inner[path[-1]]) is type(STRANGE[kind]):
        result.saw("harmless: the same JSON")
        return
    inner[path[-1]] = STRANGE[kind]
    if path != ("digest",):
        record["digest"] = digest({key: record[key] for key in record if key != "digest"})
    try:
        text = dumps(record)
    except ValueError:
        text = json.dumps(record)
    rewrite(file, text.encode())
    _judged(stage, place, result)


def _hostile(stage: str, text: Callable[[str], bytes], place: Place, result: Result) -> None:
    file = place.runs / "smoke" / stage / "verdict.json"
    rewrite(file, text(file.read_text(encoding="utf-8")))
    _judged(stage, place, result, forged=False)


def _judged(stage: str, place: Place, result: Result, *, forged: bool = True) -> None:
    """Look at a changed verdict. A forgery with the right digest may pass in the last stage alone, as documented."""
    file = place.runs / "smoke" / stage / "verdict.json"
    there = file.read_bytes()
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    states = {row["name"]: row["state"] for row in ran.document()["stages"]}
    below = list(STAGES)[list(STAGES).index(stage) + 1 :]
    if states[stage] == "pass" and any(
        states[name] == "pass" for name in below if stage in STAGES.upstream(name)
    ):
        result.forbidden.append(
            f"a silent pass: the changed verdict of {stage} is believed downstream",
        )
    if states[stage] == "pass" and not forged:
        result.forbidden.append(f"a silent pass: status of {stage}")
    result.saw(
        "forged with its digest, passes alone"
        if states[stage] == "pass"
        else f"named: {states[stage]}",
    )
    judge(result, "explain", command(place, "explain", stage, *place.options()), [ExitCode.PASS])
    text = command(place, "status", *place.options())
    judge(result, "status as text", text, [ExitCode.PASS])
    if "\x1b[2J" in text.out + text.err or "\u202e" in text.out + text.err:
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if file.read_bytes() != there:
        result.forbidden.append("reading changed the verdict")
