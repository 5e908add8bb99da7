"""`make bench`, or `python -m scripts.bench [control] [carry] [planning] [hard] [--peers] [--repeats N] [--check]`.

A bench measures against a yardstick of the same run: an absolute time says as much about the machine and its other work
as about the code.
"""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path

from minidual.config.root import Config
from minidual.registry import Registry
from scripts.bench.tables import Bench, BenchInputs

BENCHES: Registry[Bench] = Registry(
    "bench",
    {name: f"scripts.bench.{name}:measure" for name in ("control", "carry", "planning", "hard")},
)
REPEATS_N = {"control": 2000, "carry": 4000, "planning": 20, "hard": 50}
ONLY_NAMED = ("hard",)
"""They take many minutes, so they run only if named."""


def main(words: list[str]) -> int:
    """Measure what is named, everything if nothing is; return 1 if --check is given and a limit does not hold."""
    parser = argparse.ArgumentParser(prog="make bench ARGS=", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        help=f"what to time: {', '.join(BENCHES)} (default: all but hard)",
    )
    parser.add_argument(
        "--repeats",
        type=int,
        help="how often each thing is timed; draws per set of hard",
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
        default=BenchInputs.roboplan,
        help="a Python that has roboplan",
    )
    parser.add_argument("--check", action="store_true", help="exit 1 if a number exceeds its limit")
    options = parser.parse_args(words)
    if options.repeats is not None and options.repeats < 1:
        parser.error(f"--repeats {options.repeats}: at least 1")
    exceeded: list[str] = []
    usual = (
        ("hard",) if options.peers else tuple(name for name in BENCHES if name not in ONLY_NAMED)
    )
    for name in BENCHES.names(options.names) if options.names else usual:
        repeats_n = options.repeats or REPEATS_N.get(name, 20)
        say = functools.partial(print, file=sys.stderr)
        inputs = BenchInputs(
            Config(),
            options.seed,
            repeats_n,
            say,
            options.peers,
            options.roboplan,
        )
        table = BENCHES[name](inputs)
        print("\n".join(table.lines()), end="\n\n", flush=True)
        exceeded += table.exceeded
    for text in exceeded:
        print(f"over its limit (!): {text}", file=sys.stderr)
    return int(options.check and bool(exceeded))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
