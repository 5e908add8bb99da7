"""A command never replaces finished work silently.

Other options go to a run of their own, or need --yes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
import shlex
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.cli.options import CommonOptions
from minidual.cli.own_run import own_run
from minidual.config.loader import load_config
from minidual.errors import UsageError
from minidual.gate.lock import run_lock
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageTable
from minidual.stages.registry import STAGES, TOOLS
from tests.support.pipeline_toys import KNOB, Bench, Toy

ROOT = Path(__file__).parents[2]


def contents(folder: Path) -> dict[str, str]:
    """Hash every file of a run, but for what the latest command typed and the lock."""
    hashes: dict[str, str] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in ("config.yaml", "remembered.json", ".lock"):
            hashes[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return hashes


class Toys:
    """Three toys behind the real command line, all finished."""

    def __init__(self, root, capsys) -> None:
        self.bench = Bench(root / "runs")
        self._capsys = capsys
        self("run")
        self.before = contents(self.folder("toys"))

    def __call__(self, *words: str) -> tuple[int, str, str]:
        run = [] if "--run" in words else ["--run", "toys"]
        code = run_command_line(
            [*words, *run, "--runs-dir", str(self.bench.root)],
            self.bench.table,
        )
        return code, *self._capsys.readouterr()

    def folder(self, run: str) -> Path:
        return self.bench.root / run

    @property
    def runs(self) -> list[str]:
        return sorted(path.name for path in self.bench.root.iterdir())


@pytest.fixture
def toys(tmp_path, capsys):
    return Toys(tmp_path, capsys)


def test_other_options_go_to_a_run_of_their_own(toys):
    code, out, err = toys("first", "--queries", "3")
    assert code == 0
    assert out.strip() == str(toys.folder("toys-queries-3") / "first" / "verdict.json")
    assert "run 'toys' keeps its finished first: made with --profile standard, asked for is" in err
    assert "working in run 'toys-queries-3' instead; --yes would replace it in 'toys'" in err
    assert "next: minidual second --run toys-queries-3" in err
    assert contents(toys.folder("toys")) == toys.before


def refuses(config):
    """Refuse three queries before a run."""
    if config.plan.queries_n == 3:
        raise UsageError("no method 'foo'")


def test_a_misspelt_setting_begins_no_run(tmp_path, capsys):
    toys = Toys(tmp_path, capsys)
    first, *others = toys.bench.table.values()
    toys.bench.table = StageTable(
        (dataclasses.replace(first, check=f"{__name__}:refuses"), *others),
        libraries=("numpy",),
    )
    code, _, err = toys("first", "--queries", "3")
    assert code == 2
    assert "no method 'foo'" in err
    assert "instead" not in err
    assert toys.runs == ["toys"]


def test_the_same_command_finds_its_own_run_again(toys):
    toys("first", "--queries", "3")
    code, _, err = toys("first", "--queries", "3")
    assert code == 0
    assert "first: pass, fresh" in err
    assert toys.runs == ["toys", "toys-queries-3"]


@pytest.mark.parametrize(
    ("words", "run"),
    [
        (["first", "--mood", "good day"], "toys-good-day"),
        (["first", "--set", f"{KNOB}=7"], f"toys-{KNOB}-7"),
        (["first", "--seed", "7", "--queries", "9"], "toys-queries-9-seed-7"),
        (["first", "--profile", "smoke"], "toys-smoke"),
        (["run", "--set", f"{KNOB}=7"], f"toys-{KNOB}-7"),
        (["run", "--until", "second", "--seed", "7"], "toys-seed-7"),
        (["first", "--force", "--queries", "5"], "toys-queries-5"),
    ],
)
def test_the_name_says_what_was_typed(toys, words, run):
    assert toys(*words)[0] == 0
    assert toys.runs == ["toys", run]
    assert contents(toys.folder("toys")) == toys.before


def test_a_long_name_is_cut_and_stays_its_own(toys):
    for mood in ("x" * 90 + "a", "x" * 90 + "b"):
        assert toys("first", "--mood", mood)[0] == 0
    assert [len(run) for run in toys.runs] == [4, 80, 80]


def test_stages_that_still_match_come_along(toys):
    toys.bench.table = StageTable(
        [
            dataclasses.replace(
                entry,
                settings={"queries": KNOB},
                options=toys.bench.table["first"].options,
                reads=(KNOB,),
            )
            if entry.name == "second"
            else dataclasses.replace(entry, reads=())
            for entry in toys.bench.table.values()
        ],
    )
    toys("run", "--force")
    before = contents(toys.folder("toys"))
    code, _, err = toys("second", "--queries", "3")
    assert code == 0, err
    assert len(toys.bench.first.contexts) == 2, "first was linked, not run"
    assert toys.bench.second.contexts[-1].config.plan.queries_n == 3
    own = toys.folder("toys-queries-3")
    linked = own / "first" / "out" / "numbers.txt"
    assert (
        linked.stat().st_ino
        == (toys.folder("toys") / "first" / "out" / "numbers.txt").stat().st_ino
    )
    assert contents(toys.folder("toys")) == before
    # What the derived run replaces leaves the base's file alone.
    toys("first", "--run", own.name, "--force")
    assert (
        linked.stat().st_ino
        != (toys.folder("toys") / "first" / "out" / "numbers.txt").stat().st_ino
    )
    assert contents(toys.folder("toys")) == before


def test_a_variant_of_a_waived_stage_finds_the_failed_one_that_it_works_on(toys):
    entry = dataclasses.replace(
        toys.bench.table["second"],
        options=toys.bench.table["first"].options,
    )
    toys.bench.table = StageTable([toys.bench.table["first"], entry, toys.bench.table["third"]])
    toys.bench.first.observed = 0.0
    toys("first", "--force")
    assert toys("second", "--waive-gate", "demo day", "--force")[0] == 0
    code, _, err = toys("second", "--mood", "good", "--waive-gate", "demo day")
    assert "working in run 'toys-good' instead" in err
    assert (code, (toys.folder("toys-good") / "first" / "verdict.json").is_file()) == (0, True)


def test_plain_words_do_not_replace_what_was_made_with_options(toys):
    toys("first", "--queries", "3", "--yes")
    assert toys.runs == ["toys"]
    code, _, err = toys("first")
    assert code == 0
    assert "made with --profile standard --queries 3" in err
    assert toys.runs == ["toys", "toys-defaults"]
    assert toys("run")[0] == 0, "it keeps the options of a fresh stage"
    assert toys.bench.first.contexts[-1].config.plan.queries_n == 100  # of toys-defaults


def test_run_does_not_replace_a_stale_stage_that_was_made_with_options(toys):
    toys("third", "--waive-gate", "x")
    toys.bench.table = StageTable(
        [
            dataclasses.replace(e, options=toys.bench.table["first"].options)
            for e in toys.bench.table.values()
        ],
    )
    toys("second", "--mood", "good", "--yes")
    toys("first", "--force")
    before = contents(toys.folder("toys"))
    code, _, err = toys("run")
    assert code == 0
    assert "keeps its finished second (and of third)" in err or "keeps its finished second:" in err
    assert contents(toys.folder("toys")) == before
    assert toys("run", "--yes")[0] == 0
    assert contents(toys.folder("toys")) != before


def test_yes_replaces(toys):
    code, out, _ = toys("first", "--queries", "3", "--yes")
    assert code == 0
    assert toys.runs == ["toys"]
    assert json.loads(Path(out.strip()).read_text())["options"] == {"queries": 3}
    assert toys.bench.states(f"{KNOB}=3")[0] == "pass"


def test_what_does_not_change_the_result_replaces_nothing_and_stays(toys):
    for words in (["--workers", "1"], ["--queries", "100"], ["--set", "view.port=9000"]):
        code, _, err = toys("first", *words)
        assert code == 0
        assert "first: pass, fresh" in err
    assert toys.runs == ["toys"]


def test_changes_on_purpose_run_again_in_place(toys, tmp_path):
    """An edited profile file, a lost artefact or --force: no other options were typed."""
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: standard\nplan: {queries_n: 50}\n")
    assert toys("run", "--run", "mine", "--profile", str(mine))[0] == 0
    mine.write_text("extends: standard\nplan: {queries_n: 60}\n")
    assert toys("run", "--run", "mine", "--profile", str(mine))[0] == 0
    assert toys("first", "--force")[0] == 0
    (toys.folder("toys") / "first" / "out" / "numbers.txt").unlink()
    assert toys("run")[0] == 0
    assert toys.runs == ["mine", "toys"]
    assert toys.bench.first.contexts[1].config.plan.queries_n == 50
    assert toys.bench.first.contexts[2].config.plan.queries_n == 60


def test_a_failed_result_is_finished_too_and_a_corrupt_one_is_not(toys):
    toys.bench.first.observed = 0.0
    toys("first", "--force")
    before = contents(toys.folder("toys"))
    toys("first", "--queries", "3")
    assert contents(toys.folder("toys")) == before
    (toys.folder("toys") / "first" / "verdict.json").write_text("{")
    toys("first", "--queries", "4")
    assert toys.runs == ["toys", "toys-queries-3"]


@pytest.mark.parametrize("words", [["--yes", "--queries", "3"], ["--force"]])
def test_a_recording_is_set_aside_and_never_deleted(toys, words):
    table = [
        dataclasses.replace(entry, keeps=("out",) if entry.name == "first" else ())
        for entry in toys.bench.table.values()
    ]
    toys.bench.table = StageTable(table)
    before = contents(toys.folder("toys") / "first")
    code, _, err = toys("first", *words)
    assert code == 0
    (kept,) = (toys.folder("toys") / "set-aside").iterdir()
    assert f"the earlier first is kept in {kept}" in err
    assert contents(kept) == before


def test_a_replacement_cut_short_keeps_both_results(toys):
    folder = toys.folder("toys")
    (folder / "first").rename(folder / ".first.old")
    (folder / "first").mkdir()
    (folder / "first" / "verdict.json").write_bytes(
        (folder / ".first.old" / "verdict.json").read_bytes(),
    )
    toys("first")
    (kept,) = (folder / "set-aside").iterdir()
    assert (kept / "out" / "numbers.txt").is_file()


def test_the_recorder_is_the_stage_whose_results_are_kept():
    assert [entry.name for entry in STAGES.values() if entry.keeps] == ["teleop-record"]


def documented() -> list[str]:
    """Return the stage commands of README and docs."""
    found: dict[str, None] = {}
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for line in page.read_text(encoding="utf-8").splitlines():
            match = re.match(r"^(?: {4}|\.venv/bin/|)minidual ([a-z].*?)(?: {2,}#.*| \\)?$", line)
            if match and "[" not in match[1] and match[1].split()[0] in (*STAGES, "run"):
                found[match[1]] = None
    return list(found)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A fabricated finished run of the standard profile.

    Toys stand under the real names, options and parameters.
    """
    root = tmp_path_factory.mktemp("finished")
    table = StageTable(
        [
            dataclasses.replace(e, target=Toy(e.name), resolve=None, check=None, closing=False)
            for e in STAGES.values()
        ],
    )
    for _ in Runner(table, RunStore(root, "standard"), load_config("standard")).run_until():
        pass
    return root, table


COMMANDS = [
    "carry --object glass --motion over --trials 2",
    "teleop-record --episodes 3",
    "deploy --trials 1",
    "plan --queries 5 --force",
    "benchmark --set benchmark.trials_n=1",
    "run --seed 7",
    *documented(),
]


@pytest.mark.parametrize("command", COMMANDS)
def test_no_documented_command_replaces_finished_work(finished, command, capsys, monkeypatch):
    root, table = finished
    monkeypatch.setattr(
        "minidual.cli.execute.run_tool",
        lambda *_: 0,
    )  # an aside: it has no verdict to replace
    before = contents(root / "standard")
    words = [word for word in shlex.split(command) if word not in ("--view", "web")]
    if "--view-port" in words:
        del words[words.index("--view-port") :][:2]
    code = run_command_line([*words, "--runs-dir", str(root)], table, TOOLS)
    said = capsys.readouterr().err
    assert code in (0, 2, 3), said
    assert contents(root / "standard") == before


def test_there_are_documented_commands():
    assert len(documented()) > 20


def test_glass_has_its_own_run_with_what_stands_before_it(finished, capsys):
    root, table = finished
    assert (
        run_command_line(
            [*shlex.split("carry --object glass --motion over --runs-dir"), str(root)],
            table,
        )
        == 0
    )
    own = RunStore(root, "standard-glass-over")
    assert {path.name for path in own.folder.iterdir() if path.is_dir()} == {
        "env-check",
        "plan",
        "carry",
    }
    verdict, _ = own.verdict("carry") or pytest.fail("no verdict")
    assert verdict.options == {"object": "glass", "motion": "over"}
    assert "next: minidual teleop-record --run standard-glass-over" in capsys.readouterr().err


def test_one_tool_runs_twice_at_a_time_in_two_runs_alone(tmp_path: Path, capsys) -> None:
    """Two of them in one run would mix their films."""
    runs = ["--runs-dir", str(tmp_path), "--profile", "smoke", "--run"]
    with run_lock(tmp_path / "busy", "minidual modes", ".modes.lock"):
        assert run_command_line(["modes", *runs, "busy"], STAGES, TOOLS) == 2
    said = capsys.readouterr().err
    assert f"run 'busy' is being written by process {os.getpid()} (minidual modes, since" in said


def test_a_long_name_of_a_run_leads_on_to_another(toys):
    first = "toys-" + 75 * "a"
    common = CommonOptions(run=first)
    second = own_run(common, first, [{"knob": "3"}])
    third = own_run(common, second, [{"knob": "3"}])
    assert len(second) == len(third) == 80
    assert len({first, second, third}) == 3
