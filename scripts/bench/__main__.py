"""`make bench`, or `python -m scripts.bench [BENCH ...] [options]`.

A bench measures against a yardstick of the same run: an absolute time says as much about the machine
and its other work as about the code.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from minidual.config.root import Config
from minidual.durable import now_text
from minidual.gate.circumstances import circumstances_now
from minidual.registry import Registry
from minidual.show.report.bench import BenchRecord, BenchTable, write_bench
from scripts.bench.tables import ROBOPLAN_PYTHON, Bench, BenchInputs, table_lines

BENCHES: Registry[Bench] = Registry(
    "bench",
    {
        "control": "scripts.bench.control:measure",
        "carry": "scripts.bench.carry:measure",
        "planning": "scripts.bench.planning:measure",
        "hard": "scripts.bench.hard:measure",
        "environments": "scripts.bench.environments:measure",
        "passivity": "scripts.bench.passivity:measure",
        "passivity-arms": "scripts.bench.passivity_arms:measure",
        "recording": "scripts.bench.recording:measure",
    },
)
REPEATS_N = {
    "control": 2000,
    "carry": 4000,
    "planning": 20,
    "hard": 50,
    "environments": 1500,
    "passivity": 100,
    "recording": 6,
}
_REPEATS_N_DEFAULT = 20
NOT_REPEATED = ("passivity-arms",)
"""They run each case once."""
ONLY_NAMED = ("hard", "passivity", "passivity-arms")
"""They take many minutes, so they run only if named."""


def main(words: list[str]) -> int:
    """Measure what is named, all but the long ones if nothing is.

    Returns:
        1 if --check is given and a limit does not hold, else 0.
    """
    parser = _parser()
    options = parser.parse_args(words)
    if options.repeats is not None and options.repeats < 1:
        parser.error(f"--repeats {options.repeats}: at least 1")
    names = _requested(options)
    if options.repeats is not None and all(name in NOT_REPEATED for name in names):
        parser.error(f"--repeats: {', '.join(names)} runs each case once")
    tables: dict[str, BenchTable] = {}
    for name in names:
        inputs = BenchInputs(
            config=Config(),
            seed=options.seed,
            repeats_n=options.repeats or REPEATS_N.get(name, _REPEATS_N_DEFAULT),
            advance=_say,
            peers=options.peers,
            roboplan=options.roboplan,
        )
        tables[name] = BENCHES[name](inputs)
        print("\n".join(table_lines(tables[name])), end="\n\n", flush=True)
    if options.json is not None:
        write_bench(options.json, _record(tables))
    exceeded = [sentence for table in tables.values() for sentence in table.exceeded]
    for sentence in exceeded:
        _say(f"over its limit (!): {sentence}")
    return 1 if options.check and exceeded else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make bench ARGS=", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        help=f"what to time: {', '.join(BENCHES)} (default: all but {', '.join(ONLY_NAMED)})",
    )
    parser.add_argument(
        "--repeats",
        type=int,
        help="how often each thing is timed; draws per set of hard; traces a delay of passivity",
    )
    parser.add_argument("--seed", type=int, default=20261, help="of the planning queries")
    parser.add_argument(
        "--peers",
        action="store_true",
        help="the hard queries, with roboplan and plain OMPL beside",
    )
    parser.add_argument(
        "--roboplan",
        type=Path,
        default=ROBOPLAN_PYTHON,
        help=f"a Python that has roboplan (default: {ROBOPLAN_PYTHON})",
    )
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="write the tables; `minidual report` shows runs/RUN/bench.json",
    )
    parser.add_argument("--check", action="store_true", help="exit 1 if a number exceeds its limit")
    return parser


def _requested(options: argparse.Namespace) -> tuple[str, ...]:
    if options.names:
        return BENCHES.names(options.names)
    if options.peers:
        return ("hard",)
    return tuple(name for name in BENCHES if name not in ONLY_NAMED)


def _record(tables: dict[str, BenchTable]) -> BenchRecord:
    circumstances = circumstances_now(("ompl", "toppra", "mujoco", "pin", "numpy"))
    return BenchRecord(
        made_at=now_text(),
        commit=circumstances.commit or "unknown",
        machine=circumstances.machine,
        libraries=circumstances.libraries,
        tables=tables,
    )


def _say(text: str) -> None:
    print(text, file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
