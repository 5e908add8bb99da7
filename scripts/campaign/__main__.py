"""`make campaign`, or `python -m scripts.campaign [KIND ...] [--small] [--seed N] [--log FILE]`.

Kills, tampers, breaks and interrupts, and looks for outcomes that are forbidden: exit 70, a traceback,
a hang, an orphan process, a silent pass, a lost finished episode, a half-written result that passes.
Exit 1 if there is one.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import math
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from minidual.config.seeds import stream
from minidual.gate.circumstances import circumstances_now
from scripts.campaign.case import Case, Place, Result, command, run_cases
from scripts.campaign.kinds import KINDS, Kind

ROOT = Path(__file__).resolve().parents[2]


def main(words: list[str]) -> int:
    """Run the kinds that are named, all if none is; return 1 if an outcome was forbidden."""
    parser = _parser()
    options = parser.parse_args(words)
    unknown = [kind for kind in options.kinds if kind not in KINDS]
    if unknown:
        parser.error(f"no kind {unknown[0]}; there are {', '.join(KINDS)}")
    not_passing = _not_passing(options.source)
    if not_passing:
        parser.error(
            f"{options.source} is no finished smoke run of this code ({not_passing[0]}): "
            "minidual run --profile smoke",
        )
    with tempfile.TemporaryDirectory(prefix="campaign-source-") as folder:
        source = Path(folder) / "smoke"
        shutil.copytree(options.source, source)
        campaign = Campaign(source, options)
        for name in options.kinds or KINDS:
            campaign.run(name, KINDS[name])
        return campaign.end()


def _parser() -> argparse.ArgumentParser:
    runs = Path(os.environ.get("MINIDUAL_RUNS") or ROOT / "runs")
    parser = argparse.ArgumentParser(prog="make campaign ARGS=", description=__doc__)
    parser.add_argument(
        "kinds",
        nargs="*",
        help=f"what to try: {', '.join(KINDS)} (default: everything)",
    )
    parser.add_argument("--small", action="store_true", help="the part for every build")
    parser.add_argument(
        "--share",
        type=float,
        default=1.0,
        help="of the cases of each kind, drawn with the seed",
    )
    parser.add_argument("--list", action="store_true", help="say how many cases there are")
    parser.add_argument("--only", default="", help="only cases whose name contains this")
    parser.add_argument("--seed", type=int, default=20261)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--source", type=Path, default=runs / "smoke")
    parser.add_argument(
        "--log",
        type=Path,
        help="one JSON line a case; a campaign that was stopped goes on from it",
    )
    return parser


class Log:
    """One JSON line a case behind a head; without a file nothing is kept.

    A campaign with the same head skips the cases that stand there.
    """

    def __init__(self, path: Path | None, head: Mapping[str, Any]) -> None:
        self._path = path
        self._results: dict[tuple[str, str], Result] = {}
        if path is None:
            return
        lines: list[dict[str, Any]] = []
        if path.is_file():
            old_head, *old_lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
            if old_head == head:
                lines = old_lines
        for line in lines:
            result = Result(line["count"], line["forbidden"], line["outcomes"])
            self._results[line["kind"], line["name"]] = result
        path.parent.mkdir(parents=True, exist_ok=True)
        content = "".join(f"{json.dumps(line)}\n" for line in (head, *lines))
        path.write_text(content, encoding="utf-8")

    def result(self, kind: str, case: Case) -> Result | None:
        """Return the result of a case that an earlier campaign has run."""
        return self._results.get((kind, case.name))

    def write(self, kind: str, case: Case, result: Result, seconds: float) -> None:
        """Add a case."""
        if self._path is None:
            return
        line = {"kind": kind, "name": case.name, "s": round(seconds, 2), **vars(result)}
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(f"{json.dumps(line)}\n")


class Sums:
    """Sums of one kind."""

    def __init__(self) -> None:
        self.cases = 0
        self.seconds = 0.0
        self.forbidden: list[str] = []
        self.outcomes: Counter[str] = Counter()

    def add(self, result: Result) -> None:
        """Add a result."""
        self.cases += result.count
        self.forbidden += result.forbidden
        self.outcomes.update(result.outcomes)


class Campaign:
    """Runs cases, keeps the log and prints the table."""

    def __init__(self, source: Path, options: argparse.Namespace) -> None:
        self.source = source
        self.options = options
        self.sums: dict[str, Sums] = {}
        self.head = {
            "seed": options.seed,
            "small": options.small,
            "share": options.share,
            "commit": circumstances_now(()).commit,
        }
        self._log = Log(options.log, self.head)
        self._digest = _tree_digest(source)

    def run(self, name: str, kind: Kind) -> None:
        """Run one kind."""
        chosen = self._chosen(name, kind)
        sums = Sums()
        self.sums[name] = sums
        if self.options.list:
            sums.cases = len(chosen)
            return
        print(f"{name}: {len(chosen)} cases", file=sys.stderr, flush=True)
        _warm(self.source, kind)
        began_s = time.monotonic()
        waiting: list[tuple[int, Case]] = []
        for index, case in chosen:
            earlier = self._log.result(name, case)
            if earlier is None:
                waiting.append((index, case))
            else:
                sums.add(earlier)

        def done(_index: int, case: Case, result: Result, seconds: float) -> None:
            sums.add(result)
            for text in result.forbidden:
                print(f"FORBIDDEN {name} [{case.name}] {text}", file=sys.stderr, flush=True)
            self._log.write(name, case, result, seconds)

        run_cases(waiting, self.source, self.options.seed, name, self.options.workers, done)
        sums.seconds = time.monotonic() - began_s

    def _chosen(self, name: str, kind: Kind) -> list[tuple[int, Case]]:
        """Return the cases to run, each with its index among all of the kind."""
        cases = [case for case in kind.cases(self.source) if self.options.only in case.name]
        wanted_n = kind.small if self.options.small else kind.most or len(cases)
        count = math.ceil(self.options.share * min(wanted_n, len(cases)))
        if count >= len(cases):
            return list(enumerate(cases))
        order = stream(self.options.seed, f"campaign.{name}.drawn").permutation(len(cases))
        return [(int(index), cases[index]) for index in sorted(order[:count])]

    def end(self) -> int:
        """Print the table; return the exit code."""
        if _tree_digest(self.source) != self._digest:
            first = next(iter(self.sums.values()))
            first.forbidden.append("a command wrote into a published file")
        print(f"\ncampaign of seed {self.head['seed']} at {self.head['commit']}")
        print(f"{'kind':16s} {'cases':>6s} {'forbidden':>10s} {'took':>8s}  outcomes")
        for name, sums in self.sums.items():
            outcomes = ", ".join(f"{text} {n}" for text, n in sums.outcomes.most_common(8))
            print(f"{_line(name, sums.cases, len(sums.forbidden), sums.seconds)}  {outcomes}")
        cases = sum(sums.cases for sums in self.sums.values())
        forbidden = sum(len(sums.forbidden) for sums in self.sums.values())
        seconds = sum(sums.seconds for sums in self.sums.values())
        print(_line("together", cases, forbidden, seconds))
        return 1 if forbidden else 0


def _line(name: str, cases: int, forbidden: int, seconds: float) -> str:
    return f"{name:16s} {cases:6d} {forbidden:10d} {seconds:6.0f} s"


def _not_passing(run: Path) -> list[str]:
    """Return the stages of a run that do not pass, or not under this code."""
    selecting = ("--profile", "smoke", "--run", run.name, "--runs-dir", str(run.parent))
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder), run, stream(0, "campaign.warm"))
        ran = command(place, "status", "--json", *selecting)
    return [row["name"] for row in ran.document()["stages"] if row["state"] != "pass"]


def _warm(source: Path, kind: Kind) -> None:
    """Import and cache what every case needs, before the first fork."""
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder), source, stream(0, "campaign.warm"))
        command(place, "status", "--json", *place.options())
        kind.warm(place)
    gc.freeze()


def _tree_digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        digest.update(path.relative_to(folder).as_posix().encode())
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # OMPL's bindings list what they leak at a usual exit
