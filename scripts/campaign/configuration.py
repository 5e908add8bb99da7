"""Configurations: every field takes every strange value, and profile files are broken in every way."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import yaml

from minidual.config.loader import SHIPPED_FOLDER, LoadedConfig, load_config
from minidual.config.root import Config
from minidual.errors import ExitCode, MinidualError
from minidual.stages.registry import STAGES
from scripts.campaign.case import Case, Place, Result, command, judge

LIMIT_S = 1.0
VALUES = (
    "-1", "0", "-0.0", "1", "2", "0.5", "-1e-9", "1e-300", "1e-30", "1e12", "1e300", "1e999", ".nan", ".inf", "-.inf",
    "9223372036854775808", "1" * 400, "text", "", "'1'", "null", "true", "[]", "[1, 2]", "[null]", "{}", "{a: 1}",
    "äöü\u202e\U0001f916", "\x1b[2J", "!!python/object/apply:os.getcwd []",
)  # fmt: skip
"""What `--set FIELD=` is followed by."""


class _TooLongError(Exception):
    pass


def _too_long(number: int, frame: FrameType | None) -> None:
    raise _TooLongError


def leaves(value: Any, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the dotted path of each value and of each section."""
    if path:
        yield ".".join(path)
    for key, inner in value.items() if isinstance(value, dict) else ():
        yield from leaves(inner, (*path, key))


def override_cases(source: Path) -> Iterator[Case]:
    """One case a field; it tries every value."""
    for path in leaves(Config().model_dump(mode="json")):
        yield Case(path, partial(_overrides, path), limit_s=LIMIT_S * len(VALUES) + 10.0)


def _overrides(path: str, place: Place, result: Result) -> None:
    result.count = 0
    taken: dict[str, LoadedConfig] = {}
    for value in VALUES:
        result.count += 1
        loaded = _load(f"--set {path}={value[:30]}", "standard", [f"{path}={value}"], result)
        if loaded is not None:
            taken[value] = loaded
            _check_taken(f"--set {path}={value[:30]}", loaded, place, result)
    for value in ("1e300", "1e-300", "1e-30"):
        if value in taken and isinstance(_value(taken[value], path), float):
            divisor = value != "1e300" and "0" not in taken and "1" in taken
            if divisor or value == "1e300":
                result.forbidden.append(f"a silent pass: {path}={value} is taken")
    if path.rsplit("_", 1)[-1] in ("share", "fraction") or "rate_min" in path:
        result.forbidden += [
            f"a silent pass: {path}={value}, of a rate" for value in ("-1", "2") if value in taken
        ]


def _value(loaded: LoadedConfig, path: str) -> Any:
    value: Any = loaded.config
    for part in path.split("."):
        value = value[part] if isinstance(value, dict) else getattr(value, part)
    return value


def _load(what: str, profile: str, overrides: list[str], result: Result) -> LoadedConfig | None:
    """Load under a time limit; note what is not the loader's own error."""
    signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        loaded = load_config(profile, overrides)
        for entry in STAGES.values():
            entry.parameters(loaded.config)
        result.saw("taken")
        return loaded
    except MinidualError as error:
        if error.exit_code != ExitCode.USAGE:
            result.forbidden.append(f"{what}: exit code {error.exit_code}")
        if not overrides and any(ord(sign) < 32 and sign not in "\n\t" for sign in str(error)):
            result.forbidden.append(f"{what}: an escape sequence reaches the terminal")
        result.saw("refused")
    except _TooLongError:
        result.forbidden.append(f"{what}: a hang: longer than {LIMIT_S:g} s")
    except (Exception, RecursionError) as error:
        result.forbidden.append(f"{what}: a traceback: {type(error).__name__}: {str(error)[:120]}")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    return None


def _check_taken(what: str, loaded: LoadedConfig, place: Place, result: Result) -> None:
    """What was taken is finite, and the file that the run keeps says the same."""
    if not all(math.isfinite(number) for number in _numbers(loaded.config.model_dump(mode="json"))):
        result.forbidden.append(f"{what}: a silent pass: a number is not finite")
    file = place.folder / "kept.yaml"
    file.write_text(loaded.to_yaml(), encoding="utf-8")
    kept = _load(f"{what}, kept and read again", str(file), [], result)
    if kept is not None and kept.config != loaded.config:
        result.forbidden.append(f"{what}: a silent pass: the kept file says something else")


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, float | int):
        yield value
    for inner in (
        value.values()
        if isinstance(value, dict)
        else value
        if isinstance(value, list | tuple)
        else ()
    ):
        yield from _numbers(inner)


def profile_cases(source: Path) -> Iterator[Case]:
    """Profile files that are no profiles, and shipped ones that are broken at random."""
    for name in HOSTILE_FILES:
        for words in (("config", "show"), ("status",)):
            yield Case(f"{words[0]} {name}", partial(_hostile, name, words), limit_s=8.0)
    for number in range(400):
        yield Case(f"broken {number}", _broken)
    for number in range(200):
        yield Case(f"shuffled {number}", _shuffled)


def _sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(3 << 30)


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8", errors="surrogateescape")


_BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12)
)
HOSTILE_FILES: dict[str, Callable[[Path], object]] = {
    "3 GB": _sparse,
    "2 MB": _text("# " + "x" * 2_000_000),
    "2000 levels of lists": _text("plan: " + "[" * 2000 + "]" * 2000),
    "2000 levels of mappings": _text("plan: " + "{a: " * 2000 + "1" + "}" * 2000),
    "100000 levels": _text("plan: " + "[" * 100_000),
    "2000 indented levels": _text("".join(f"{' ' * n}a:\n" for n in range(2000))),
    "aliases that multiply": _text(_BOMB),
    "alias of itself": _text("plan: &a [*a]\n"),
    "merge of itself": _text("plan: &a {<<: *a}\n"),
    "unknown alias": _text("plan: *nowhere\n"),
    "FIFO": os.mkfifo,
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "folder": Path.mkdir,
    "empty": _text(""),
    "list": _text("[1, 2]"),
    "text": _text("hello"),
    "null": _text("null"),
    "two documents": _text("seed: 1\n---\nseed: 2\n"),
    "tabs": _text("plan:\n\tqueries_n: 3\n"),
    "Python object": _text(
        "seed: !!python/object/apply:os.system ['touch /tmp/campaign-was-here']\n",
    ),
    "number as key": _text("plan: {1: 2}\n1: 3\n"),
    "null as key": _text("~: 1\n? [a, b]\n: 2\n"),
    "date": _text("seed: 2020-01-01\nplan: {queries_n: 12:30:45}\n"),
    "octal": _text("seed: 0o17\n"),
    "binary": _text("seed: !!binary aGVsbG8=\n"),
    "set": _text("plan: !!set {a, b}\n"),
    "long key": _text("k" * 300_000 + ": 1\n"),
    "control characters": _text("seed: '\x1b]0;owned\x07'\n"),
    "escaped control characters": _text('task: "\\e[2J\\x9b"\n'),
    "bidi": _text("task: '\u202ecarry_dor'\n"),
    "invalid UTF-8": _text("seed: \udcff\n"),
    "UTF-16": lambda path: path.write_bytes("seed: 1\n".encode("utf-16")),
    "byte order mark": _text("\ufeffseed: 1\n"),
    "null bytes": lambda path: path.write_bytes(b"seed: 1\0\n"),
    "extends itself": _text("extends: case.yaml\n"),
    "extends a number": _text("extends: 3\n"),
    "extends a device": _text("extends: /dev/zero\n"),
    "extends a list": _text("extends: [standard]\n"),
    "keys twice": _text("seed: 1\nseed: 2\n"),
    "huge integer": _text("seed: " + "9" * 10_000 + "\n"),
    "hexadecimal": _text("seed: 0x" + "f" * 10_000 + "\n"),
    "sexagesimal": _text("seed: " + ":".join(["59"] * 3000) + "\n"),
}


def _hostile(name: str, words: tuple[str, ...], place: Place, result: Result) -> None:
    file = place.folder / "case.yaml"
    HOSTILE_FILES[name](file)
    began = time.monotonic()
    ran = command(place, *words, "--profile", str(file), "--runs-dir", str(place.folder / "none"))
    judge(result, " ".join(words), ran, [ExitCode.PASS, ExitCode.USAGE])
    if time.monotonic() - began > 4.0:
        result.forbidden.append(f"{name}: took {time.monotonic() - began:.1f} s")
    if (
        any(ord(sign) < 32 and sign not in "\n\t" for sign in ran.out + ran.err)
        or "\u202e" in ran.out + ran.err
    ):
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if Path("/tmp/campaign-was-here").exists():
        result.forbidden.append("the file ran a program")
    if (place.folder / "none").exists():
        result.forbidden.append("a refused profile left a folder")
    result.saw("taken" if ran.code == 0 else "refused")


def _broken(place: Place, result: Result) -> None:
    """Change bytes of a shipped profile."""
    rng = place.rng
    content = bytearray(
        (
            SHIPPED_FOLDER / str(rng.choice(["standard.yaml", "smoke.yaml", "gpu.yaml"]))
        ).read_bytes(),
    )
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(len(content)))
        kind = int(rng.integers(4))
        if kind == 0:
            content[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            content[at:at] = bytes(
                rng.choice(list(b"{}[]:&*!|>'\"%@`#,-? \n\t0e."), size=3).tolist(),
            )
        elif kind == 2:
            del content[at : at + int(rng.integers(1, 30))]
        else:
            begin = int(rng.integers(len(content)))
            content[at:at] = content[begin : begin + int(rng.integers(1, 60))]
    file = place.folder / "case.yaml"
    file.write_bytes(bytes(content))
    loaded = _load("a broken profile", str(file), [], result)
    if loaded is not None:
        _check_taken("a broken profile", loaded, place, result)


def _shuffled(place: Place, result: Result) -> None:
    """Replace, drop and move values of a shipped profile."""
    rng = place.rng
    tree = yaml.safe_load((SHIPPED_FOLDER / "standard.yaml").read_text(encoding="utf-8"))
    for _ in range(int(rng.integers(1, 4))):
        _change_one(tree, rng)
    file = place.folder / "case.yaml"
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    loaded = _load("a shuffled profile", str(file), [], result)
    if loaded is not None:
        _check_taken("a shuffled profile", loaded, place, result)


def _change_one(tree: dict[str, Any], rng: np.random.Generator) -> None:
    place = tree
    while True:
        key = list(place)[int(rng.integers(len(place)))]
        if isinstance(place[key], dict) and place[key] and rng.random() < 0.8:
            place = place[key]
            continue
        others = [None, [], {}, -1, 0, 1e-300, 1e300, "text", True, [[]], {"a": {"b": 1}}, 10**30]
        place[key] = others[int(rng.integers(len(others)))]
        if rng.random() < 0.2:
            place[f"{key}x"] = place.pop(key)
        return
