"""The state of every stage follows from what lies on the disk, and staleness says why."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from minidual.gate.table import StageEntry, StageTable
from tests.support.pipeline_toys import KNOB, Bench


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "runs")


@pytest.fixture
def finished(bench):
    bench.run_all()
    return bench


def test_nothing_has_run(bench):
    assert bench.states() == ["missing", "blocked", "blocked"]
    assert not bench.store.folder.exists(), "asking must not write"


def test_all_pass(finished):
    assert finished.states() == ["pass", "pass", "pass"]
    assert [len(toy.contexts) for toy in (finished.first, finished.second, finished.third)] == [
        1,
        1,
        1,
    ]


def test_verdict_stands_where_it_is_promised(finished):
    record = json.loads((finished.root / "toys" / "second" / "verdict.json").read_text())
    assert record["stage"] == "second"
    assert record["status"] == "pass"
    assert record["fingerprint"]["upstream"].keys() == {"first"}
    assert record["fingerprint"]["inputs"].keys() == {"first/out/numbers.txt"}
    assert record["fingerprint"]["libraries"]["no-such-library"] == "not installed"
    assert set(record["artefacts"]) == {"config.yaml", "out/numbers.txt"}
    assert (finished.root / "toys" / "config.yaml").is_file()


def test_failed_stage_blocks_those_below(bench):
    bench.first.observed = 0.5
    bench.run_all()
    assert bench.states() == ["fail", "blocked", "blocked"]
    assert bench.gate().state("first").why() == "quality is 0.5 n, limit >= 1 n"


def test_changed_parameter_is_stale_with_its_name(finished):
    then = finished.loaded().config.plan.queries_n
    state = finished.gate(f"{KNOB}={then + 1}").state("first")
    assert state.state == "stale"
    assert state.reasons == (f"parameter {KNOB} was {then}, is {then + 1}",)


def test_stale_goes_all_the_way_down(finished):
    gate = finished.gate(f"{KNOB}=3")
    assert [gate.state(name).state for name in finished.table] == ["stale"] * 3
    assert gate.state("third").reasons == ("upstream stage second is stale",)


def test_changed_seed_is_stale_and_workers_are_not(finished):
    assert "the seed was" in finished.gate("seed=1").state("first").reasons[0]
    assert finished.states("workers=7") == ["pass"] * 3


def test_other_profile_is_stale(finished, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: standard\n")
    finished.profile = str(mine)
    assert finished.gate().state("first").reasons == ("the profile was 'standard', is 'mine'",)


def _overwrite(path: Path) -> None:
    path.write_text("forged quality\n")


def _same_size(path: Path) -> None:
    stat = path.stat()
    path.write_text(path.read_text().replace("1.0", "9.9"))
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


@pytest.mark.parametrize(
    ("tamper", "reason"),
    [
        (_overwrite, "changed (was"),
        (_same_size, "changed (same size, other content)"),
        (Path.unlink, "is gone"),
    ],
)
def test_tampering_with_an_artefact_is_stale(finished, tamper, reason):
    tamper(finished.store.folder / "first" / "out" / "numbers.txt")
    state = finished.gate().state("first")
    assert state.state == "stale"
    assert f"artefact out/numbers.txt {reason}" in state.reasons[0]
    assert finished.states() == ["stale"] * 3


def test_an_extra_file_is_no_tampering(finished):
    (finished.store.folder / "first" / "note.txt").write_text("mine")
    assert finished.states() == ["pass"] * 3


def test_rerun_upstream_is_stale_downstream(finished):
    finished.first.observed = 2.0
    finished.runner().run("first", force=True)
    gate = finished.gate()
    assert gate.state("first").state == "pass"
    assert gate.state("second").reasons == (
        "input first/out/numbers.txt changed or is gone",
        "upstream stage first ran again since",
    )
    assert "upstream stage first ran again since" in gate.state("third").reasons


def test_edited_verdict_is_an_error_not_a_pass(finished):
    path = finished.store.verdict_path("first")
    path.write_text(path.read_text().replace('"seed": ', '"seed": 1'))
    state = finished.gate().state("first")
    assert (state.state, state.verdict) == ("error", None)
    assert str(path) in state.reasons[0]


def test_verdict_of_another_stage_is_corrupt(finished):
    shutil.copy(finished.store.verdict_path("second"), finished.store.verdict_path("third"))
    assert (
        "it is the verdict of stage second, not of third"
        in finished.gate().state("third").reasons[0]
    )


def test_folder_without_verdict_is_missing(finished):
    finished.store.verdict_path("second").unlink()
    assert finished.states() == ["pass", "missing", "stale"]


def test_renaming_a_run_keeps_it_fresh(finished):
    finished.store.folder.rename(finished.root / "kept")
    assert Bench(finished.root, run="kept").states() == ["pass"] * 3


def test_version_change_warns_and_stays_fresh(finished, monkeypatch):
    monkeypatch.setattr("minidual.__version__", "99.0")
    from minidual.gate import circumstances

    circumstances.circumstances_now.cache_clear()
    try:
        state = finished.gate().state("first")
    finally:
        circumstances.circumstances_now.cache_clear()
    assert state.state == "pass"
    assert any("this is 99.0" in warning for warning in state.warnings)


def test_typed_option_stays_with_its_stage(bench):
    bench.runner().run("first", {"queries": 3})
    assert bench.first.contexts[0].config.plan.queries_n == 3
    assert bench.states()[0] == "pass", "other commands judge it with the option it was made with"
    bench.runner().run("second")
    assert not bench.runner().run("first", {"queries": 3}).ran
    assert bench.runner().run("first").ran, "typed without the option it means the configured value"


def test_option_that_is_no_configuration_enters_the_fingerprint(bench):
    bench.runner().run("first", {"mood": "good"})
    assert bench.states()[0] == "pass"
    assert not bench.runner().run("first", {"mood": "good"}).ran
    assert bench.runner().run("first", {"mood": "bad"}).ran


def test_table_refuses_duplicates_and_forward_requirements(bench):
    with pytest.raises(ValueError, match="is in the table already"):
        StageTable([StageEntry("a", bench.first, (), ""), StageEntry("a", bench.first, (), "")])
    with pytest.raises(ValueError, match="requires 'b', which does not stand above"):
        StageTable([StageEntry("a", bench.first, ("b",), "")])
