"""Links, pipes, folders and damage where a run keeps its results.

They are named before work starts, and nothing is deleted.
"""

from __future__ import annotations

import copy
import io
import json
import os
import random
import shutil
import tempfile
from pathlib import Path

import pytest
from rich.console import Console

from minidual.cli.app import run_command_line
from minidual.cli.console import print_explanation
from minidual.durable import remove
from minidual.errors import DataError, GateClosedError
from minidual.gate.canonical import digest
from minidual.gate.lock import lock_holders
from minidual.stages.registry import STAGES
from tests.support.pipeline_toys import Bench


def a_file(path: Path) -> None:
    path.write_text("mine")


def a_folder(path: Path) -> None:
    path.mkdir()
    (path / "mine").write_text("mine")


def a_link_to_itself(path: Path) -> None:
    path.symlink_to(path)


def a_link_to_a_file(path: Path) -> None:
    target = path.parent.parent / "elsewhere.txt"
    target.write_text("mine")
    path.symlink_to(target)


def a_link_to_a_folder(path: Path) -> None:
    target = path.parent.parent / "elsewhere"
    target.mkdir()
    path.symlink_to(target)


def a_link_to_a_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def a_link_to_the_run(path: Path) -> None:
    path.symlink_to(path.parent)


def a_link_to_another_stage(path: Path) -> None:
    (path.parent / "second").mkdir(exist_ok=True)
    path.symlink_to(path.parent / "second")


def a_link_to_nothing(path: Path) -> None:
    path.symlink_to(path.parent.parent / "not" / "there")


NO_FOLDER = {
    a_file: "is a file",
    os.mkfifo: "is a FIFO",
    a_link_to_itself: "Too many levels of symbolic links",
    a_link_to_a_file: "is a file",
    a_link_to_a_device: "is a device",
    a_link_to_nothing: "is no folder",
}
NO_FILE = {
    os.mkfifo: "is a FIFO",
    a_link_to_itself: "Too many levels of symbolic links",
    a_link_to_a_device: "is a device",
    a_folder: "is a folder",
}
IN_THE_WAY = {
    "first": {
        **NO_FOLDER,
        a_link_to_the_run: "in or above its own run",
        a_link_to_another_stage: "in or above its own run",
    },
    **{
        name: {**NO_FOLDER, a_link_to_a_folder: "is a link", a_link_to_nothing: "is a broken link"}
        for name in (".first.tmp", ".first.old", "set-aside")
    },
    **dict.fromkeys((".lock", "config.yaml"), NO_FILE),
}


class Run:
    """A run of toys behind the real command line."""

    def __init__(self, root: Path, capsys) -> None:
        self.bench = Bench(root / "runs")
        self._capsys = capsys
        self.folder = self.bench.store.folder

    def __call__(self, *words: str) -> tuple[int, str, str]:
        code = run_command_line(
            [*words, "--run", "toys", "--runs-dir", str(self.bench.root)],
            self.bench.table,
        )
        out, err = self._capsys.readouterr()
        return code, out, " ".join(err.split())

    def stages(self) -> dict[str, dict]:
        code, out, err = self("status", "--json")
        assert code == 0, err
        return {stage["name"]: stage for stage in json.loads(out)["stages"]}


@pytest.fixture
def run(tmp_path, capsys):
    run = Run(tmp_path, capsys)
    run.folder.mkdir(parents=True)
    return run


@pytest.mark.parametrize("name", IN_THE_WAY)
def test_what_is_in_the_way_is_named_before_work_starts(run, name):
    path = run.folder / name
    bench = run.bench
    for make, said in IN_THE_WAY[name].items():
        make(path)
        before = path.lstat()
        with pytest.raises(DataError, match=rf"{name}.*{said}"):
            bench.runner().run("first")
        assert bench.first.contexts == []
        assert (path.lstat().st_ino, path.lstat().st_mode) == (before.st_ino, before.st_mode), (
            "nothing is deleted"
        )
        if name in ("first", ".first.tmp", ".first.old"):
            state = bench.gate().state("first")
            assert state.state == "error"
            assert said in state.reasons[0]
        remove(path)
        remove(run.folder.parent / "elsewhere")
    os.mkfifo(path)
    code, out, err = run("first")
    assert (code, out) == (2, "")
    assert "is a FIFO" in err
    remove(path)
    assert run("first")[0] == 0, "once it is moved away, the stage runs"


@pytest.mark.parametrize("make", [os.mkfifo, a_link_to_itself])
def test_a_lock_that_is_no_file_does_not_hang_status(run, make):
    make(run.folder / ".lock")
    with pytest.raises(DataError, match="lock"):
        lock_holders(run.folder)
    code, out, err = run("status")
    assert (code, out) == (2, "")
    assert ".lock" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("level", ["runs", "run"])
def test_no_folder_for_the_runs_is_named(tmp_path, capsys, level):
    path = tmp_path / "runs" if level == "runs" else tmp_path / "runs" / "toys"
    path.parent.mkdir(exist_ok=True)
    for make in NO_FOLDER:
        make(path)
        with pytest.raises(DataError, match=str(path)):
            Bench(tmp_path / "runs")
        path.unlink()
    os.mkfifo(path)
    words = ["--run", "toys", "--runs-dir", str(tmp_path / "runs")]
    assert [run_command_line([word, *words], STAGES) for word in ("status", "explain", "plan")] == [
        2,
        2,
        2,
    ]
    assert f"{path} is a FIFO" in capsys.readouterr().err


@pytest.fixture
def elsewhere():
    """A folder on another disk, where the machine has one."""
    shm = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=shm if os.access(shm, os.W_OK) else None) as folder:
        yield Path(folder)


@pytest.mark.parametrize("level", ["runs", "run", "stage", "stage that does not exist yet"])
def test_results_elsewhere_by_a_link(tmp_path, capsys, elsewhere, level):
    run = Run(tmp_path, capsys)
    link = {"runs": run.bench.root, "run": run.folder}.get(level, run.folder / "first")
    link.parent.mkdir(parents=True, exist_ok=True)
    target = elsewhere / "results"
    if "yet" not in level:
        target.mkdir()
    link.symlink_to(target)
    assert run("run")[0] == 0
    run.bench.first.observed = 2.0
    assert run("first", "--force")[0] == 0
    run.bench.first.observed = 0.0
    assert run("first", "--force")[0] == 1
    assert run.bench.states()[0] == "fail"
    assert link.is_symlink()
    numbers = run.folder / "first" / "out" / "numbers.txt"
    assert numbers.read_text() == "first 0.0\n"
    assert numbers.resolve().is_relative_to(elsewhere)
    assert sorted(path.name for path in elsewhere.iterdir()) == ["results"], (
        "nothing is left behind"
    )


@pytest.mark.parametrize("moment", ["before the new one is in place", "after it is"])
def test_a_replacement_cut_short_behind_a_link_is_mended(tmp_path, capsys, elsewhere, moment):
    run = Run(tmp_path, capsys)
    run.folder.mkdir(parents=True)
    (run.folder / "first").symlink_to(elsewhere / "big")
    assert run("run")[0] == 0
    (elsewhere / "big").rename(elsewhere / ".big.old")
    if moment == "after it is":
        shutil.copytree(elsewhere / ".big.old", elsewhere / "big")
    assert run.bench.states() == ["pass"] * 3
    assert not run.bench.runner().run("first").ran
    assert not (elsewhere / ".big.old").exists()


def test_a_mount_point_is_named(run, monkeypatch):
    (run.folder / "first").mkdir()
    monkeypatch.setattr(Path, "is_mount", lambda path: path.name == "first")
    code, _, err = run("first")
    assert code == 2
    assert "first is a mount point" in err
    assert run.stages()["first"]["state"] == "missing", "it can be read"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A finished run, to copy."""
    bench = Bench(tmp_path_factory.mktemp("made") / "runs")
    bench.run_all()
    return bench.root


@pytest.fixture
def finished(tmp_path, capsys, made):
    shutil.copytree(made, tmp_path / "runs")
    return Run(tmp_path, capsys)


def forbid(monkeypatch, place: Path) -> None:
    """Make reading `place` fail as `chmod 000` does.

    The superuser, as whom tests may run, reads everything.
    """

    def refusing(real):
        def method(path, *arguments, **options):
            if Path(path) == place:
                raise PermissionError(13, "Permission denied", str(path))
            return real(path, *arguments, **options)

        return method

    monkeypatch.setattr(Path, "open", refusing(Path.open))
    monkeypatch.setattr(
        os,
        "access",
        lambda path, mode, real=os.access: Path(path) != place and real(path, mode),
    )


@pytest.mark.parametrize(
    ("name", "state"),
    [("verdict.json", "error"), ("", "error"), ("out/numbers.txt", "stale")],
)
def test_no_permission_is_named(finished, monkeypatch, name, state):
    place = finished.folder / "first" / name
    (finished.folder / "first" / "out" / "numbers.txt").touch()  # its hash is not the cached one
    forbid(monkeypatch, place)
    first = finished.stages()["first"]
    assert first["state"] == state
    assert "ermission" in first["reasons"][0]
    assert Path(name).name in first["reasons"][0]
    assert finished("explain", "first")[0] == 0


@pytest.mark.parametrize("name", [".lock", ".first.tmp/attempt.json"])
def test_no_permission_for_the_marks_of_a_writer(finished, monkeypatch, name):
    (finished.folder / ".first.tmp").mkdir()
    (finished.folder / ".first.tmp" / "attempt.json").write_text("{}")
    forbid(monkeypatch, finished.folder / name)
    code, _, err = finished("status")
    assert code == (2 if name == ".lock" else 0)
    assert ("no permission to read" in err) == (name == ".lock")


def refill(path: Path, content: bytes) -> None:
    path.unlink()
    path.write_bytes(content)


DAMAGE = {
    "empty": lambda path: refill(path, b""),
    "not UTF-8": lambda path: refill(path, b'{"stage": "\xff\xfe"}'),
    "half of it": lambda path: refill(path, path.read_bytes()[:500]),
    "3000 levels": lambda path: refill(path, b'{"a":' * 3000 + b"1" + b"}" * 3000),
    "a lone surrogate": lambda path: refill(path, b'{"stage": "\\ud800"}'),
    "an integer of 5000 digits": lambda path: refill(path, b'{"schema": ' + b"1" * 5000 + b"}"),
    "another type": lambda path: refill(path, b"[1, 2]"),
    "100 GB": lambda path: os.truncate(path, 100_000_000_000),
    **{make.__name__: lambda path, make=make: (path.unlink(), make(path)) for make in NO_FILE},
}


def test_a_damaged_verdict_is_named_and_kept(finished):
    path = finished.folder / "first" / "verdict.json"
    good = path.read_bytes()
    for damage in DAMAGE.values():
        remove(path)
        path.write_bytes(good)
        damage(path)
        gate = finished.bench.gate()
        assert [gate.state(name).state for name in finished.bench.table] == [
            "error",
            "stale",
            "stale",
        ]
        assert str(path) in gate.state("first").reasons[0]
        assert os.path.lexists(path)
        with pytest.raises(GateClosedError, match=str(path)):
            finished.bench.runner().run("second")
    assert [finished("explain", "first")[0], finished("status")[0]] == [0, 0]
    assert finished("run", "--yes")[0] == 0
    (kept,) = (finished.folder / "set-aside").iterdir()
    assert os.path.lexists(kept / "verdict.json"), "what cannot be read is not deleted"


@pytest.mark.parametrize("name", ["numbers.txt", "attempt.json"])
def test_damaged_files_beside_it_are_named(finished, name):
    path = finished.folder / ("first/out" if name == "numbers.txt" else ".first.tmp") / name
    path.parent.mkdir(exist_ok=True)
    for make in NO_FILE:
        remove(path)
        make(path)
        state = finished.bench.gate().state("first")
        said = {"numbers.txt": "artefact out/numbers.txt", "attempt.json": "killed as it began"}[
            name
        ]
        assert said in " ".join([*state.reasons, *state.warnings])
    assert finished("run", "--force")[0] == 0
    assert set(finished.bench.states()) == {"pass"}


def places(value, at=()):
    """Yield the path of every value in a document."""
    yield at
    inner = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, item in inner:
        yield from places(item, (*at, key))


def nested(levels: int) -> list:
    value: list = []
    for _ in range(levels):
        value = [value]
    return value


WRONG = [
    None,
    [],
    {},
    "",
    -1,
    10**400,
    1e308,
    True,
    [1, "a", None],
    {"a": {"b": None}},
    nested(150),
    "x" * 3000,
]


def test_wrong_values_in_a_verdict_never_crash(run):
    """Fields of a verdict, replaced under a matching digest: 80 of about 1,000, drawn (seed 0)."""
    run.bench.runner().run("first", {"queries": 3, "mood": "good"})
    path = run.folder / "first" / "verdict.json"
    good = json.loads(path.read_bytes())
    cases = [
        (place, wrong)
        for place in places(good)
        if place and place != ("digest",) and "code" not in place
        for wrong in WRONG
    ]
    named = 0
    huge = [(("checks", 0, "limit"), 10**400), (("checks", 0, "observed"), 10**400)]
    for place, wrong in random.Random(0).sample(cases, 80) + huge:
        record = copy.deepcopy(good)
        inner = record
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = wrong
        record["digest"] = digest({key: record[key] for key in record if key != "digest"})
        path.write_text(json.dumps(record))
        state = run.bench.gate().state("first")
        print_explanation(Console(file=io.StringIO()), run.bench.table["first"], state, {}, str)
        named += state.state in ("error", "stale")
        assert (state.state == "error") == any(str(path) in reason for reason in state.reasons), (
            place,
            wrong,
        )
    assert named > 50


def test_a_recorded_option_that_is_not_valid_now_is_stale(run):
    run.bench.runner().run("first", {"queries": 3})
    path = run.folder / "first" / "verdict.json"
    record = json.loads(path.read_bytes())
    record["options"] = {"queries": "many"}
    record["digest"] = digest({key: record[key] for key in record if key != "digest"})
    path.write_text(json.dumps(record))
    first = run.stages()["first"]
    assert first["state"] == "stale"
    assert "an option that is not valid now: --queries many" in first["reasons"][0]
    assert run("first", "--yes")[0] == 0


@pytest.mark.parametrize(
    ("name", "state"),
    [("note.txt", "pass"), (".hidden", "pass"), ("out/more.txt", "stale"), ("out/link", "stale")],
)
def test_a_stray_file_is_named(finished, name, state):
    path = finished.folder / "first" / name
    path.symlink_to(path.parent) if name == "out/link" else path.write_text("mine")
    first = finished.stages()["first"]
    assert first["state"] == state
    assert f"{name} is not one of its artefacts" in " ".join(
        [*first["reasons"], *first["warnings"]],
    )
    assert finished("run", "--force")[0] == 0
    (kept,) = (finished.folder / "set-aside").iterdir()
    assert os.path.lexists(kept / name), "it is not deleted with the old result"
    assert finished.stages()["first"]["state"] == "pass"


def test_a_stray_file_moved_away_opens_the_gate_again(finished):
    path = finished.folder / "first" / "out" / "more.txt"
    path.write_text("mine")
    assert finished.bench.states() == ["stale"] * 3
    path.unlink()
    assert finished.bench.states() == ["pass"] * 3


def test_an_old_result_that_cannot_be_removed_is_set_aside(finished, monkeypatch):
    def refusing(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(
        "minidual.gate.store.remove",
        lambda path: refusing(path) if path.name == ".first.old" else None,
    )
    code, _, err = finished("first", "--force")
    assert code == 0
    assert "the earlier first is kept in" in err


@pytest.mark.parametrize("make", [a_file, os.mkfifo, a_link_to_a_folder])
def test_a_place_of_a_tool_is_checked_too(tmp_path, make):
    from minidual.config.loader import load_config
    from minidual.gate.stage import ToolContext

    (tmp_path / "run").mkdir()
    make(tmp_path / "run" / ".modes.tmp")
    context = ToolContext(
        config=load_config().config,
        seed=0,
        profile="standard",
        run_folder=tmp_path / "run",
        name="modes",
    )
    with pytest.raises(DataError, match=r"\.modes\.tmp is a"):
        context.begin()


@pytest.mark.parametrize("target", ["mine", "run"])
def test_a_link_to_files_that_are_no_result_is_refused_and_keeps_them(run, target):
    place = run.folder / "first"
    remove(place)
    mine = run.folder.parent / "mine" if target == "mine" else run.folder
    mine.mkdir(exist_ok=True)
    (mine / "mine.txt").write_text("mine")
    place.symlink_to(mine)
    code, _, err = run("first", "--force")
    assert (code, (mine / "mine.txt").read_text()) == (2, "mine")
    why = "whose files are no result of minidual" if target == "mine" else "in or above its own run"
    assert f"{place} is a link to {mine}, {why}" in err
    place.unlink()
    assert run("first")[0] == 0


@pytest.mark.parametrize("inner", ["", "inner"])
def test_two_links_to_one_folder_are_refused_before_work_starts(run, inner):
    disk = run.folder.parent / "disk"
    (disk / "inner").mkdir(parents=True)
    (run.folder / "second").symlink_to(disk / inner)
    (run.folder / "first").symlink_to(disk)
    code, _, err = run("first")
    assert (code, run.bench.first.contexts) == (2, [])
    assert f"{run.folder / 'first'} is a link to {disk}, where the link second leads, too" in err
    (run.folder / "first").unlink()
    (disk / "inner").rmdir() if not inner else None
    assert run("first")[0] == 0
    assert run("second")[0] == 0
