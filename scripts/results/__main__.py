"""`make results`, or `python -m scripts.results [--only NAME,...] [--fill] [--print] [options]`.

Makes the tables of docs/results*.md from runs, and measures what is missing. Each measurement
continues after an interruption: type the same command again. A table whose input is missing keeps
its content, and a line says so.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from minidual.config.loader import load_config
from minidual.durable import write_text
from minidual.errors import MinidualError, UsageError
from minidual.registry import Registry
from minidual.stages.deploy import recorded_task
from minidual.tasks.catalogue import TASKS
from minidual.trials.methods import METHODS
from minidual.trials.metrics import TrialMetrics
from scripts.results import benches, five_tasks, standard, trainings
from scripts.results.blocks import blocks, with_blocks
from scripts.results.quotes import Published, stale_quotes
from scripts.results.trials import Plan, run_cell

ROOT = Path(__file__).resolve().parents[2]
RESULTS = tuple(sorted((ROOT / "docs").glob("results*.md")))
"""The pages of results: each measured number stands on one of them."""
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
"""Pages that hold blocks, or quote RESULTS."""
NO_RESULTS = {"15 of 20", "6 of 255"}
"""Counts on pages that are no results.

They are an acceleration of a data sheet, and levels of a colour.
"""
FOLDER = Path("runs/results")
_MINIDUAL = (sys.executable, "-m", "minidual.cli")
_BENCH = (sys.executable, "-m", "scripts.bench")


type Publish = Callable[[dict[str, str]], None]
"""Takes {block: content}."""


@dataclass(frozen=True)
class Source:
    """Where blocks of the page come from.

    Attributes:
        contents: Returns {block: content}, or None while its input is missing.
        measure: Makes the input, or continues to make it.
        input: What the input is, in words.
    """

    contents: Callable[[], dict[str, str] | None]
    measure: Callable[[], None]
    input: str


def main(words: list[str]) -> int:
    """Measure what is missing, fill the blocks, and say which kept their content.

    Returns:
        1 if a block that was asked for kept its content, or a page quotes another number; else 0.
    """
    options = _parser().parse_args(words)
    try:
        names = SOURCES.names(options.only) if options.only else tuple(SOURCES)
        sources = {name: SOURCES[name](options) for name in names}
        publish = _print if options.print else fill_pages
        kept_n = _fill(sources, publish, measures=not options.fill)
        return 1 if kept_n or _stale_quotes() else 0
    except MinidualError as error:
        _say(error.message)
        if error.remedy:
            _say(f"type: {error.remedy}")
        return int(error.exit_code)


def _fill(sources: dict[str, Source], publish: Publish, *, measures: bool) -> int:
    """Publish the blocks of each source as soon as it is complete; return how many kept theirs."""
    kept_n = 0
    for name, source in sources.items():
        contents = source.contents()
        if contents is None and measures:
            source.measure()
            contents = source.contents()
        if contents is None:
            _say(f"{name}: kept, because there is no {source.input}")
            kept_n += 1
        else:
            publish(contents)
            _say(f"{name}: made from {source.input}")
    return kept_n


def _stale_quotes() -> int:
    """Say which numbers of pages the results do not have; return how many."""
    published = published_pages()
    stale_n = 0
    for page in PAGES:
        for quote in stale_quotes(page.read_text(encoding="utf-8"), published):
            if quote not in NO_RESULTS:
                _say(f"{page.name} quotes {quote}, which the results do not say")
                stale_n += 1
    return stale_n


def published_pages() -> Published:
    """Return {name: text} of the pages of results."""
    return {page.name: page.read_text(encoding="utf-8") for page in RESULTS}


def _print(contents: dict[str, str]) -> None:
    """Print the contents, and leave the pages."""
    for name, content in contents.items():
        print(f"{name}:\n\n{content}\n", flush=True)


def fill_pages(contents: dict[str, str]) -> None:
    """Write the contents into the blocks of their names in all pages."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks(text)  # a damaged mark is refused before a page changes
        filled = with_blocks(text, contents)
        if filled != text:
            write_text(page, filled)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make results ARGS=", description=__doc__)
    parser.add_argument(
        "--only",
        default="",
        metavar="NAME,...",
        help=f"some of {', '.join(SOURCES)} (default: all, in this order)",
    )
    parser.add_argument("--fill", action="store_true", help="measure nothing")
    parser.add_argument(
        "--print",
        action="store_true",
        help="print the tables and leave the pages, to try the command with few trials",
    )
    parser.add_argument(
        "--first",
        type=int,
        help="number of the first start of the five-task table, of deploy and of the benchmark: "
        "at least 1000, and in no earlier publication, such as 30000",
    )
    parser.add_argument("--trials", type=int, default=100, help="trials of each cell")
    parser.add_argument("--tasks", default=",".join(TASKS), help="tasks of the five-task table")
    parser.add_argument(
        "--methods",
        default="moveit,impedance,act",
        help="its methods; act only for tasks with a policy",
    )
    parser.add_argument(
        "--policy",
        type=Path,
        action="append",
        default=[],
        metavar="RUN",
        help="a run with a trained policy for the five-task table; several are allowed",
    )
    parser.add_argument("--workers", type=int, default=2, help="processes of the five-task table")
    for name, default, what in (
        ("--standard", Path("runs/standard"), "a finished standard run"),
        ("--learn", Path("runs/learn"), "a finished run of `make learn`"),
        ("--step", FOLDER / "step.json", "a record of the bench carry"),
        ("--planning", FOLDER / "planning.json", "a record of the bench hard with peers"),
    ):
        parser.add_argument(name, type=Path, default=default, help=f"{what} ({default})")
    return parser


def _tasks(options: argparse.Namespace) -> Source:
    plan = _plan(options)
    five_tasks.check_fresh(plan, "\n".join(published_pages().values()))
    return Source(
        lambda: _one(five_tasks.block_name(plan), five_tasks.block(plan)),
        lambda: _measure_tasks(plan, options.workers),
        f"{plan.trials_n} trials of each cell in {plan.folder}",
    )


def _step(options: argparse.Namespace) -> Source:
    return Source(
        lambda: _one(benches.STEP_BLOCK, benches.step_block(options.step)),
        lambda: _run(*_BENCH, "carry", "--json", str(options.step)),
        f"record {options.step}",
    )


def _planning(options: argparse.Namespace) -> Source:
    return Source(
        lambda: _one(benches.PLANNING_BLOCK, benches.planning_block(options.planning)),
        lambda: _run(*_BENCH, "--peers", "--json", str(options.planning)),
        f"record {options.planning}",
    )


def _standard(options: argparse.Namespace) -> Source:
    return Source(
        lambda: standard.blocks(options.standard),
        lambda: _run(*_MINIDUAL, "run", *_run_words(options.standard, options.first)),
        f"passing run {options.standard}",
    )


def _trainings(options: argparse.Namespace) -> Source:
    several = ("--until", "deploy", "--set", "train.seeds_n=3")
    words = _run_words(options.learn, options.first)
    return Source(
        lambda: _one(trainings.NAME, trainings.block(options.learn)),
        lambda: _run(*_MINIDUAL, "run", *words, *several),
        f"passing run {options.learn} of several seeds",
    )


SOURCES: Registry[Callable[[argparse.Namespace], Source]] = Registry(
    "results",
    {
        five_tasks.NAME: _tasks,
        benches.STEP_BLOCK: _step,
        benches.PLANNING_BLOCK: _planning,
        standard.STAGES_BLOCK: _standard,
        trainings.NAME: _trainings,
    },
)


def _one(name: str, content: str | None) -> dict[str, str] | None:
    return None if content is None else {name: content}


def _plan(options: argparse.Namespace) -> Plan:
    if options.first is None:
        raise UsageError("the five-task table needs a first start", remedy="--first 30000")
    policies: dict[str, Path] = {}
    for run in options.policy:
        if not (run / "train-act" / "checkpoint").is_dir():
            raise UsageError(f"--policy {run}: it has no train-act/checkpoint")
        policies[recorded_task(run / "teleop-record")] = run / "train-act" / "checkpoint"
    return Plan(
        config=load_config().config,
        tasks=TASKS.names(options.tasks),
        methods=METHODS.names(options.methods),
        first=options.first,
        trials_n=options.trials,
        policies=policies,
        folder=FOLDER,
    )


def _measure_tasks(plan: Plan, workers: int) -> None:
    """Run every cell of the five-task table that is not complete."""
    cells = plan.cells
    for number, cell in enumerate(cells, start=1):
        title = f"cell {number} of {len(cells)}, {cell}"

        def on_trial(result: TrialMetrics, title: str = title) -> None:
            _say(f"{title}, start {result.index}: {result.text}")

        _say(title)
        run_cell(plan, cell, workers, on_trial)


def _run_words(run: Path, first: int | None) -> tuple[str, ...]:
    """Return the words that name a run, and its first start if it is asked for."""
    words = ("--runs-dir", str(run.parent), "--run", run.name)
    if first is None:
        return words
    starts = (f"deploy.first_start={first}", f"benchmark.first_start={first}")
    return (*words, "--set", starts[0], "--set", starts[1])


def _run(*command: str) -> None:
    """Run a command that says on stderr why it fails; the block then keeps its content."""
    _say(" ".join(command))
    FOLDER.mkdir(parents=True, exist_ok=True)
    subprocess.run(command, check=False)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
