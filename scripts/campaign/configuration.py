"""Configurations: every field takes every strange value, and profile files are broken in every way."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
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
from scripts.campaign.case import (
    Case,
    Place,
    Result,
    command,
    has_control_characters,
    has_escapes,
    judge,
)
from scripts.campaign.values import dotted, numbers, places

LIMIT_S = 1.0
VALUES = (
    "-1",
    "0",
    "-0.0",
    "1",
    "2",
    "0.5",
    "-1e-9",
    "1e-300",
    "1e-30",
    "1e12",
    "1e300",
    "1e999",
    ".nan",
    ".inf",
    "-.inf",
    "9223372036854775808",
    "1" * 400,
    "text",
    "",
    "'1'",
    "null",
    "true",
    "[]",
    "[1, 2]",
    "[null]",
    "{}",
    "{a: 1}",
    "äöü\u202e\U0001f916",
    "\x1b[2J",
    "!!python/object/apply:os.getcwd []",
)
"""What `--set FIELD=` is followed by."""
_EXTREME = ("1e300", "1e-300", "1e-30")
_TRACE = Path("/tmp/campaign-was-here")
"""Exists if a hostile file ran a program."""


class _TooLongError(Exception):
    pass


def _too_long(number: int, frame: FrameType | None) -> None:
    raise _TooLongError


def override_cases(source: Path) -> Iterator[Case]:
    """One case a field; it tries every value."""
    for where in places(Config().model_dump(mode="json")):
        if all(isinstance(key, str) for key in where):  # items of a list have no name for --set
            limit_s = LIMIT_S * len(VALUES) + 10.0
            yield Case(dotted(where), partial(_overrides, dotted(where)), limit_s)


def _overrides(field: str, place: Place, result: Result) -> None:
    result.count = 0
    accepted: dict[str, LoadedConfig] = {}
    for value in VALUES:
        result.count += 1
        action = f"--set {field}={value[:30]}"
        loaded = _load(action, "standard", [f"{field}={value}"], result)
        if loaded is not None:
            accepted[value] = loaded
            _check_accepted(action, loaded, place, result)
    for value in _EXTREME:
        if value in accepted and _must_refuse(field, value, accepted):
            result.forbidden.append(f"a silent pass: {field}={value} is taken")
    if _is_rate(field):
        for value in ("-1", "2"):
            if value in accepted:
                result.forbidden.append(f"a silent pass: {field}={value}, of a rate")


def _must_refuse(field: str, value: str, accepted: Mapping[str, LoadedConfig]) -> bool:
    """Return whether an extreme value of a float makes no sense: a huge one, or a tiny divisor."""
    if not isinstance(_value(accepted[value], field), float):
        return False
    is_divisor = "0" not in accepted and "1" in accepted
    return value == "1e300" or is_divisor


def _is_rate(field: str) -> bool:
    last_word = field.rsplit("_", 1)[-1]
    return last_word in ("share", "fraction") or "rate_min" in field


def _value(loaded: LoadedConfig, field: str) -> Any:
    value: Any = loaded.config
    for part in field.split("."):
        value = value[part] if isinstance(value, dict) else getattr(value, part)
    return value


def _load(
    action: str,
    profile: str,
    overrides: list[str],
    result: Result,
) -> LoadedConfig | None:
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
            result.forbidden.append(f"{action}: exit code {error.exit_code}")
        if not overrides and has_control_characters(str(error)):
            result.forbidden.append(f"{action}: an escape sequence reaches the terminal")
        result.saw("refused")
    except _TooLongError:
        result.forbidden.append(f"{action}: a hang: longer than {LIMIT_S:g} s")
    except (Exception, RecursionError) as error:
        message = f"{type(error).__name__}: {str(error)[:120]}"
        result.forbidden.append(f"{action}: a traceback: {message}")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    return None


def _check_accepted(action: str, loaded: LoadedConfig, place: Place, result: Result) -> None:
    """Check that what was taken is finite, and that the file which a run keeps says the same."""
    values = loaded.config.model_dump(mode="json")
    if not all(math.isfinite(number) for number in numbers(values)):
        result.forbidden.append(f"{action}: a silent pass: a number is not finite")
    file = place.folder / "kept.yaml"
    file.write_text(loaded.to_yaml(), encoding="utf-8")
    read_again = _load(f"{action}, kept and read again", str(file), [], result)
    if read_again is not None and read_again.config != loaded.config:
        result.forbidden.append(f"{action}: a silent pass: the kept file says something else")


def profile_cases(source: Path) -> Iterator[Case]:
    """Profile files that are no profiles, and shipped ones that are broken at random."""
    for name in HOSTILE_FILES:
        for words in (("config", "show"), ("status",)):
            command_name, *_ = words
            yield Case(f"{command_name} {name}", partial(_hostile, name, words), limit_s=8.0)
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
    """Use a file that is no profile."""
    file = place.folder / "case.yaml"
    HOSTILE_FILES[name](file)
    began = time.monotonic()
    ran = command(place, *words, "--profile", str(file), "--runs-dir", str(place.no_runs))
    took_s = time.monotonic() - began
    judge(result, " ".join(words), ran, [ExitCode.PASS, ExitCode.USAGE])
    if took_s > 4.0:
        result.forbidden.append(f"{name}: took {took_s:.1f} s")
    if has_escapes(ran.out + ran.err):
        result.forbidden.append("an escape sequence of the file reaches the terminal")
    if _TRACE.exists():
        result.forbidden.append("the file ran a program")
    if place.no_runs.exists():
        result.forbidden.append("a refused profile left a folder")
    result.saw("taken" if ran.code == 0 else "refused")


def _broken(place: Place, result: Result) -> None:
    """Change bytes of a shipped profile."""
    rng = place.rng
    name = str(rng.choice(["standard.yaml", "smoke.yaml", "gpu.yaml"]))
    content = bytearray((SHIPPED_FOLDER / name).read_bytes())
    for _ in range(int(rng.integers(1, 8))):
        _change_bytes(content, rng)
    file = place.folder / "case.yaml"
    file.write_bytes(bytes(content))
    _try_profile("a broken profile", file, place, result)


def _change_bytes(content: bytearray, rng: np.random.Generator) -> None:
    """Flip a bit, insert signs of YAML, delete a stretch, or repeat one."""
    at = int(rng.integers(len(content)))
    match int(rng.integers(4)):
        case 0:
            content[at] ^= 1 << int(rng.integers(8))
        case 1:
            signs = rng.choice(list(b"{}[]:&*!|>'\"%@`#,-? \n\t0e."), size=3)
            content[at:at] = bytes(signs.tolist())
        case 2:
            del content[at : at + int(rng.integers(1, 30))]
        case _:
            begin = int(rng.integers(len(content)))
            end = begin + int(rng.integers(1, 60))
            content[at:at] = content[begin:end]


def _shuffled(place: Place, result: Result) -> None:
    """Replace, drop and move values of a shipped profile."""
    rng = place.rng
    tree = yaml.safe_load((SHIPPED_FOLDER / "standard.yaml").read_text(encoding="utf-8"))
    for _ in range(int(rng.integers(1, 4))):
        _change_one(tree, rng)
    file = place.folder / "case.yaml"
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    _try_profile("a shuffled profile", file, place, result)


def _try_profile(action: str, file: Path, place: Place, result: Result) -> None:
    loaded = _load(action, str(file), [], result)
    if loaded is not None:
        _check_accepted(action, loaded, place, result)


def _change_one(tree: dict[str, Any], rng: np.random.Generator) -> None:
    """Replace a random value, and sometimes rename its key."""
    parent = tree
    while True:
        key = list(parent)[int(rng.integers(len(parent)))]
        value = parent[key]
        goes_deeper = isinstance(value, dict) and value and rng.random() < 0.8
        if not goes_deeper:
            break
        parent = value
    others = [None, [], {}, -1, 0, 1e-300, 1e300, "text", True, [[]], {"a": {"b": 1}}, 10**30]
    parent[key] = others[int(rng.integers(len(others)))]
    if rng.random() < 0.2:
        parent[f"{key}x"] = parent.pop(key)
