"""Links, files and pipes where folders are expected: named before work starts, and no hang."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from minidual.durable import remove
from minidual.errors import ExitCode
from scripts.campaign.case import Case, Place, Ran, Result, command, judge

Strange = Callable[[Path], object]


def _file(path: Path) -> None:
    path.write_text("in the way\n")


def _folder_link(path: Path) -> None:
    target = Path.cwd() / "elsewhere"
    target.mkdir()
    (target / "mine.txt").write_text("mine\n")
    path.symlink_to(target)


STRANGE: dict[str, Strange] = {
    "file": _file,
    "folder": Path.mkdir,
    "link to a folder": _folder_link,
    "link to a file": lambda path: path.symlink_to("/etc/hostname"),
    "link to nothing": lambda path: path.symlink_to("nowhere"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "link to its parent": lambda path: path.symlink_to(path.parent),
    "FIFO": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
}
PLACES = {
    "stage": "third",
    "temporary": ".third.tmp",
    "old": ".third.old",
    "old of another": ".second.old",
    "lock": ".lock",
    "configuration": "config.yaml",
    "set-aside": "set-aside",
    "attempt": ".third.tmp/attempt.json",
    "upstream": "second",
    "upstream temporary": ".second.tmp",
    "own configuration": "third/config.yaml",
    "own verdict": "third/verdict.json",
    "upstream verdict": "second/verdict.json",
    "stray": "notes",
}


def warm(place: Place) -> None:
    """Load the toys and a report."""
    from tests.support import pipeline_toys  # noqa: F401

    command(place, "report", "--force", *place.options())


def link_cases(source: Path) -> Iterator[Case]:
    """Each strange thing in each place of a run."""
    for place_name in PLACES:
        for thing in STRANGE:
            body = partial(_strange, place_name, thing)
            yield Case(f"{thing} as {place_name}", body, limit_s=20.0)
    for name in ("run", "runs", "stage", "upstream"):
        yield Case(f"{name} linked from elsewhere", partial(_elsewhere, name), limit_s=20.0)


def _toys(place: Place) -> tuple[Path, Callable[..., Ran]]:
    """Return the folder of a finished run of three toy stages, and what runs a command on it."""
    from tests.support.pipeline_toys import Bench

    bench = Bench(place.folder / "runs")
    bench.run_all()
    selecting = ("--run", "toys", "--runs-dir", str(bench.root))

    def run(*words: str) -> Ran:
        return command(place, *words, *selecting, table=bench.table)

    return bench.store.folder, run


def _strange(place_name: str, thing: str, place: Place, result: Result) -> None:
    """Put a strange thing in a place of a run, and run commands."""
    run_folder, toys = _toys(place)
    path = run_folder / PLACES[place_name]
    path.parent.mkdir(parents=True, exist_ok=True)
    remove(path)
    STRANGE[thing](path)
    judge(result, "status", toys("status"), [ExitCode.PASS, ExitCode.USAGE])
    judge(result, "explain", toys("explain", "third"), [ExitCode.PASS, ExitCode.USAGE])
    allowed = [ExitCode.PASS, ExitCode.USAGE, ExitCode.ENVIRONMENT]
    if "upstream" in place_name or place_name == "old of another":
        allowed.append(ExitCode.GATE_CLOSED)
    codes: list[int] = []
    for repetition in ("first", "second"):
        ran = toys("third", "--force")
        judge(result, f"{repetition} time", ran, allowed)
        codes.append(ran.code)
        if place_name in ("upstream", "upstream verdict") and ran.code == ExitCode.PASS:
            result.forbidden.append("a silent pass: the gate is open without the upstream stage")
    first_code, second_code = codes
    if first_code == ExitCode.PASS and second_code != ExitCode.PASS:
        result.forbidden.append(
            f"it passes the first time, the second ends with {second_code}",
        )
    behind_link = place.folder / "elsewhere" / "mine.txt"
    if thing == "link to a folder" and not behind_link.is_file():
        result.forbidden.append("a file behind a link was deleted")
    result.saw("refused" if second_code else "passes")
    judge(result, "status", toys("status"), [ExitCode.PASS, ExitCode.USAGE])


def _elsewhere(name: str, place: Place, result: Result) -> None:
    """Move a folder to another disk and link it: it works as if it lay here, and the link stays."""
    run_folder, toys = _toys(place)
    folders = {
        "run": run_folder,
        "runs": run_folder.parent,
        "stage": run_folder / "third",
        "upstream": run_folder / "second",
    }
    path = folders[name]
    target = place.folder / "other disk" / path.name
    target.parent.mkdir()
    path.rename(target)
    path.symlink_to(target)
    for _ in range(2):
        judge(result, "third", toys("third", "--force"), [ExitCode.PASS])
    ran = toys("status", "--json")
    if judge(result, "status", ran, [ExitCode.PASS]):
        states = {row["name"]: row["state"] for row in ran.document()["stages"]}
        if set(states.values()) != {"pass"}:
            result.forbidden.append(f"not all pass: {states}")
    if not path.is_symlink():
        result.forbidden.append("the link was replaced by a folder")
    result.saw("works")
