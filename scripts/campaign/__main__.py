"""`make campaign`, or `python -m scripts.campaign [KIND ...] [--small] [--seed N] [--log FILE]`.

Kills, tampers, breaks and interrupts, and looks for outcomes that are forbidden: exit 70, a traceback, a hang, an orphan
process, a silent pass, a lost finished episode, a half-written result that passes. Exit 1 if there is one.
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
from pathlib import Path

from minidual.config.seeds import stream
from minidual.gate.circumstances import circumstances_now
from scripts.campaign.case import Case, Place, Result, command, run_cases
from scripts.campaign.kinds import KINDS, Kind

ROOT = Path(__file__).resolve().parents[2]


def main(words: list[str]) -> int:
    """Run the kinds that are named, all if none is; return 1 if an outcome was forbidden."""
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
    parser.add_argument(
        "--source",
        type=Path,
        default=Path(os.environ.get("MINIDUAL_RUNS") or ROOT / "runs") / "smoke",
    )
    parser.add_argument(
        "--log",
        type=Path,
        help="one JSON line a case; a campaign that was stopped goes on from it",
    )
    options = parser.parse_args(words)
    unknown = [kind for kind in options.kinds if kind not in KINDS]
    if unknown:
        parser.error(f"no kind {unknown[0]}; there are {', '.join(KINDS)}")
    if stale := _fresh(options.source):
        parser.error(
            f"{options.source} is no finished smoke run of this code ({stale[0]}): minidual run --profile smoke",
        )
    with tempfile.TemporaryDirectory(prefix="campaign-source-") as folder:
        source = Path(folder) / "smoke"
        shutil.copytree(options.source, source)
        campaign = Campaign(source, options)
        for name in options.kinds or KINDS:
            campaign.run(name, KINDS[name])
        return campaign.end()


class Campaign:
    """Runs cases, keeps the log and prints the table."""

    def __init__(self, source: Path, options: argparse.Namespace) -> None:
        self.source = source
        self.options = options
        self.known: dict[tuple[str, str], dict] = {}
        self.rows: dict[str, Row] = {}
        self._digest = _tree_digest(source)
        commit = circumstances_now(()).commit
        self.head = {
            "seed": options.seed,
            "small": options.small,
            "share": options.share,
            "commit": commit,
        }
        if options.log and options.log.is_file():
            head, *lines = [
                json.loads(line) for line in options.log.read_text(encoding="utf-8").splitlines()
            ]
            if head == self.head:
                self.known = {(line["kind"], line["name"]): line for line in lines}
        if options.log:
            options.log.parent.mkdir(parents=True, exist_ok=True)
            kept = [self.head, *self.known.values()]
            options.log.write_text(
                "".join(f"{json.dumps(line)}\n" for line in kept),
                encoding="utf-8",
            )

    def run(self, name: str, kind: Kind) -> None:
        """Run one kind."""
        cases = [case for case in kind.load()(self.source) if self.options.only in case.name]
        count = kind.small if self.options.small else kind.most or len(cases)
        chosen = list(enumerate(cases))
        count = math.ceil(self.options.share * min(count, len(cases)))
        if count < len(cases):
            picked = stream(self.options.seed, f"campaign.{name}.drawn").permutation(len(cases))[
                :count
            ]
            chosen = [(int(index), cases[index]) for index in sorted(picked)]
        row = self.rows[name] = Row()
        if self.options.list:
            row.cases = len(chosen)
            return
        print(f"{name}: {len(chosen)} cases", file=sys.stderr, flush=True)
        _warm(self.source, kind)
        began = time.monotonic()
        todo = []
        for index, case in chosen:
            if (line := self.known.get((name, case.name))) is None:
                todo.append((index, case))
            else:
                row.add(Result(line["count"], line["forbidden"], line["outcomes"]))

        def done(index: int, case: Case, result: Result, seconds: float) -> None:
            row.add(result)
            for text in result.forbidden:
                print(f"FORBIDDEN {name} [{case.name}] {text}", file=sys.stderr, flush=True)
            if self.options.log:
                line = {"kind": name, "name": case.name, "s": round(seconds, 2), **vars(result)}
                with self.options.log.open("a", encoding="utf-8") as stream:
                    stream.write(f"{json.dumps(line)}\n")

        run_cases(todo, self.source, self.options.seed, name, self.options.workers, done)
        row.seconds = time.monotonic() - began

    def end(self) -> int:
        """Print the table; return the exit code."""
        if _tree_digest(self.source) != self._digest:
            next(iter(self.rows.values())).forbidden.append("a command wrote into a published file")
        print(f"\ncampaign of seed {self.head['seed']} at {self.head['commit']}")
        print(f"{'kind':16s} {'cases':>6s} {'forbidden':>10s} {'took':>8s}  outcomes")
        for name, row in self.rows.items():
            seen = ", ".join(f"{text} {n}" for text, n in row.outcomes.most_common(8))
            print(
                f"{name:16s} {row.cases:6d} {len(row.forbidden):10d} {row.seconds:6.0f} s  {seen}",
            )
        cases = sum(row.cases for row in self.rows.values())
        forbidden = sum(len(row.forbidden) for row in self.rows.values())
        seconds = sum(row.seconds for row in self.rows.values())
        print(f"{'together':16s} {cases:6d} {forbidden:10d} {seconds:6.0f} s")
        return int(forbidden > 0)


class Row:
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


def _fresh(source: Path) -> list[str]:
    """Return the stages of a run that do not pass and are fresh under this code."""
    with tempfile.TemporaryDirectory() as folder:
        ran = command(
            Place(Path(folder), source, stream(0, "campaign.warm")),
            "status",
            "--json",
            *_selecting(source),
        )
    return [row["name"] for row in ran.document()["stages"] if row["state"] != "pass"]


def _selecting(run: Path) -> tuple[str, ...]:
    return ("--profile", "smoke", "--run", run.name, "--runs-dir", str(run.parent))


def _warm(source: Path, kind: Kind) -> None:
    """Import and cache what every case needs, before the first fork."""
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder), source, stream(0, "campaign.warm"))
        command(place, "status", "--json", *place.options())
        kind.prepare(place)
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
