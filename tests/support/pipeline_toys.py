"""Toy stages for the tests of the gate: fast, and set from outside.

Run as a program (`python pipeline_toys.py RUNS MARKER`) it runs a stage that says it is ready and
then sleeps, so that tests can kill, interrupt or lock out a real process.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from minidual.config.loader import LoadedConfig, load_config
from minidual.gate.check import Check
from minidual.gate.gate import Gate
from minidual.gate.runner import Runner
from minidual.gate.stage import StageContext, StageResult
from minidual.gate.store import RunStore
from minidual.gate.table import Option, StageEntry, StageTable

KNOB = "plan.queries_n"
Behaviour = Callable[[StageContext], Sequence[Check] | None]


class Toy:
    """A stage whose observed value and behaviour a test sets between runs."""

    def __init__(self, name: str, requires: tuple[str, ...] = ()) -> None:
        self.name = name
        self.requires = requires
        self.observed: float = 1.0
        self.remedy = "hold harder"
        self.behaviour: Behaviour | None = None
        self.contexts: list[StageContext] = []

    def __call__(self, context: StageContext) -> StageResult:
        return self.run(context)

    def run(self, context: StageContext) -> StageResult:
        self.contexts.append(context)
        (context.folder / "out").mkdir()
        (context.folder / "out" / "numbers.txt").write_text(f"{self.name} {self.observed}\n")
        checks = self.behaviour(context) if self.behaviour else None
        if checks is None:
            checks = [
                Check(
                    "quality",
                    self.observed,
                    ">=",
                    1.0,
                    "n",
                    why="toys must hold",
                    remedy=self.remedy,
                ),
                Check("size", 3.0, unit="m"),
            ]
        return StageResult(checks=checks, data={"observed": self.observed}, notes=["a toy ran"])


class Bench:
    """A run of three toys, first <- second <- third, the last one closing."""

    def __init__(self, root: Path, profile: str = "standard", run: str = "toys") -> None:
        self.root = root
        self.profile = profile
        self.run_name = run
        self.first = Toy("first")
        self.second = Toy("second", ("first",))
        self.third = Toy("third", ("second",))
        options = (Option("queries", "How many.", int), Option("mood", "No configuration."))
        self.table = StageTable(
            (
                StageEntry(
                    "first",
                    self.first,
                    (),
                    "Toy one",
                    (KNOB,),
                    settings={"queries": KNOB},
                    options=options,
                ),
                StageEntry("second", self.second, ("first",), "Toy two"),
                StageEntry("third", self.third, ("second",), "Toy three", closing=True),
            ),
            libraries=("numpy", "no-such-library"),
        )
        self.store = RunStore(root, run)

    def loaded(self, *overrides: str) -> LoadedConfig:
        return load_config(self.profile, overrides)

    def runner(self, *overrides: str) -> Runner:
        return Runner(self.table, self.store, self.loaded(*overrides))

    def gate(self, *overrides: str) -> Gate:
        return Gate(self.table, self.store, self.loaded(*overrides))

    def states(self, *overrides: str) -> list[str]:
        gate = self.gate(*overrides)
        return [gate.state(name).state for name in self.table]

    def run_all(self) -> None:
        for _ in self.runner().run_until():
            pass


def _sleepy(context: StageContext) -> None:
    Path(sys.argv[2]).write_text("ready")
    time.sleep(60)


if __name__ == "__main__":
    from minidual.cli import process as cli
    from minidual.cli.app import run_command_line

    bench = Bench(Path(sys.argv[1]))
    bench.first.behaviour = _sleepy
    words = ["first", "--run", "toys", "--runs-dir", sys.argv[1], *sys.argv[3:]]
    cli._run = lambda: run_command_line(words, bench.table)
    cli.main()
