"""Mutated configurations: each is read or refused by name, and soon.

The bounds of the numbers keep a value that is read from driving a loop without end.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel
from typer.testing import CliRunner

from minidual.cli.app import build_app
from minidual.config.loader import load_config, parse_override
from minidual.config.root import Config
from minidual.errors import MinidualError
from minidual.stages.registry import STAGES, TOOLS

SEED = 20261122
CASES_N = 2000
COMMANDS_N = 60
LIMIT_S = 1.0  # of CPU time: the machine may be busy
NUMBERS = [
    "-1",
    "0",
    "-0.0",
    "1e-300",
    "1e-9",
    "1e300",
    "1" + "0" * 400,
    "1" + "0" * 5000,
    "9223372036854775808",
    "0.5",
]
WORDS = [
    ".nan",
    "nan",
    "inf",
    "-.inf",
    "1__0",
    "1_",
    "1e",
    "0x10",
    "1:30",
    "true",
    "null",
    "''",
    "' '",
    "text",
]
STRUCTURES = [
    "[]",
    "{}",
    "[1, 2, 3]",
    "[[[]]]",
    "{a: {b: 1}}",
    "*a",
    "&a 1",
    "!!python/name:os.system x",
    "\x00",
]
TEXTS = [
    "ü→𝔘",
    "../../etc/passwd",
    "a" * 10_000,
    "[" * 500,
    "[" * 40 + "]" * 40,
    "%",
    "@",
    "`",
    "? x",
    "- - -",
    "\t",
]
HOSTILE = [*NUMBERS, *WORDS, *STRUCTURES, *TEXTS]


def leaves(model: BaseModel, prefix: str = "") -> Iterator[str]:
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"


FIELDS = list(leaves(Config()))


def cases() -> list[str]:
    """Every field with some value, then seeded pairs."""
    rng = random.Random(SEED)
    found = [f"{field}={rng.choice(HOSTILE)}" for field in FIELDS]
    while len(found) < CASES_N:
        field = rng.choice(FIELDS)
        if rng.random() < 0.1:
            field = field.rpartition(".")[0] or field  # a whole section
        found.append(f"{field}={rng.choice(HOSTILE)}")
    return found


def test_mutated_configurations_are_read_or_refused_by_name_in_time() -> None:
    loaded = load_config("smoke")
    refusals: list[MinidualError] = []
    for case in cases():
        began = time.process_time()
        try:
            loaded.with_overrides([parse_override(case)])
        except MinidualError as error:
            refusals.append(error)
        assert time.process_time() - began < LIMIT_S, case[:80]
    assert CASES_N / 2 < len(refusals) < CASES_N - 50
    assert {error.exit_code for error in refusals} == {2}


@pytest.mark.parametrize("command", [("config", "show"), ("status",), ("status", "--json")])
def test_commands_survive_mutated_configurations(command: tuple[str, ...], tmp_path: Path) -> None:
    app = build_app(STAGES, TOOLS)
    runner = CliRunner()
    runner.invoke(app, [*command, "--set", "plan.queries_n=7"])  # imports what a check needs
    for case in random.Random(SEED).sample(cases(), COMMANDS_N // 3):
        began = time.process_time()
        result = runner.invoke(
            app,
            [*command, "--profile", "smoke", "--runs-dir", str(tmp_path), "--set", case],
        )
        assert result.exit_code in (0, 2), (case[:80], result.output[-2000:])
        assert time.process_time() - began < LIMIT_S, case[:80]


def test_every_number_has_two_bounds() -> None:
    """Only then does every loop, array and wait that a value drives end."""
    numbers = 0
    open_ends = list[str]()

    def look(node: Any, path: str) -> None:
        nonlocal numbers
        if isinstance(node, dict):
            if node.get("type") in ("number", "integer"):
                numbers += 1
                if not (
                    {"minimum", "exclusiveMinimum"} & set(node)
                    and {"maximum", "exclusiveMaximum"} & set(node)
                ):
                    open_ends.append(path)
            for name, inner in node.items():
                look(inner, f"{path}.{name}")
        elif isinstance(node, list):
            for item in node:
                look(item, path)

    look(Config.model_json_schema(), "")
    assert open_ends == []
    assert numbers > 150
