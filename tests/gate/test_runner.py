"""What running a stage does: gate, force, waivers, crashes, and what stays on the disk."""

from __future__ import annotations

import errno
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors import SafetensorError

from minidual.errors import (
    ConfigError,
    EnvironmentMissingError,
    ExitCode,
    GateClosedError,
    NothingEvaluatedError,
    UsageError,
)
from minidual.gate.check import Check
from minidual.gate.lock import run_lock
from minidual.gate.runner import Runner, StageCrashedError
from minidual.gate.stage import StageResult
from minidual.gate.table import StageEntry, StageTable
from tests.support.pipeline_toys import KNOB, Bench


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "runs")


def leftovers(bench: Bench) -> list[str]:
    return sorted(path.name for path in bench.store.folder.glob(".*") if path.name != ".lock")


def test_closed_gate_names_stage_check_and_command(bench):
    bench.first.observed = 0.25
    assert bench.runner().run("first").exit_code == ExitCode.ACCEPTANCE_FAILED
    with pytest.raises(GateClosedError) as caught:
        bench.runner().run("second")
    assert (
        caught.value.message
        == "the gate of second is closed: first failed: quality is 0.25 n, limit >= 1 n"
    )
    assert caught.value.remedy == "hold harder, then: minidual first; then this command again"
    assert bench.second.contexts == []


def test_closed_gate_far_above_names_the_root_and_the_command_for_all(bench):
    with pytest.raises(GateClosedError, match="first has not run") as caught:
        bench.runner().run("third")
    assert caught.value.remedy == "minidual run --until second; then this command again"


def test_force_never_opens_a_gate(bench):
    with pytest.raises(GateClosedError):
        bench.runner().run("second", force=True)


def test_fresh_stage_is_not_run_again_unless_forced(bench):
    assert bench.runner().run("first").ran
    again = bench.runner().run("first")
    assert (again.ran, again.exit_code) == (False, ExitCode.PASS)
    assert bench.runner().run("first", force=True).ran
    assert len(bench.first.contexts) == 2


def test_failed_stage_is_run_again(bench):
    bench.first.observed = 0.0
    bench.runner().run("first")
    bench.first.observed = 1.0
    assert bench.runner().run("first").exit_code == ExitCode.PASS


def test_nan_fails(bench):
    bench.first.observed = float("nan")
    outcome = bench.runner().run("first")
    assert outcome.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert '"observed": "nan"' in bench.store.verdict_path("first").read_text()


@pytest.mark.parametrize("checks", [[], [Check("reported", 1.0)]])
def test_no_limited_check_is_nothing_evaluated(bench, checks):
    bench.first.behaviour = lambda context: checks
    outcome = bench.runner().run("first")
    assert outcome.exit_code == ExitCode.NOTHING_EVALUATED
    assert bench.states() == ["error", "blocked", "blocked"]
    assert "nothing was evaluated" in bench.gate().state("first").why()


def test_the_closing_stage_asks_for_what_the_stages_before_it_were_asked_for(bench):
    first, second, third = bench.table.values()
    bench.table = StageTable((first, replace(second, settings=first.settings), third))
    runner = bench.runner()
    runner.run("first", {"queries": 5})
    runner.run("second", {"queries": 7})
    assert bench.runner().run("third").exit_code == ExitCode.PASS
    assert bench.third.contexts[-1].config.plan.queries_n == 7
    assert "--queries 7" in bench.gate().state("third").verdict.overrides
    assert bench.states() == ["pass", "pass", "pass"]


def test_closing_check_is_no_evidence_of_its_own(bench):
    bench.third.behaviour = lambda context: [Check("reported", 1.0)]
    bench.run_all()
    assert bench.states()[2] == "error"


def test_waiver_is_written_taints_all_below_and_closes_the_last_stage(bench):
    bench.first.observed = 0.0
    bench.runner().run("first")
    second = bench.runner().run("second", waiver="demo tomorrow")
    assert second.exit_code == ExitCode.PASS
    assert [(w.stage, w.reason, w.blocking) for w in second.verdict.waivers] == [
        ("second", "demo tomorrow", {"first": "fail"}),
    ]
    assert second.verdict.acceptance is False
    third = bench.runner().run("third")
    assert third.verdict.waivers == second.verdict.waivers, (
        "the taint is inherited without a waiver of its own"
    )
    assert bench.third.contexts[-1].waivers == second.verdict.waivers
    assert third.exit_code == ExitCode.ACCEPTANCE_FAILED
    assert [check.name for check in third.verdict.failed_checks()] == ["gate.waivers"]
    assert bench.states() == ["fail", "pass", "fail"]


def test_a_closed_gate_names_what_closes_it_not_a_waived_failure_above(bench):
    bench.first.observed = 0.0
    bench.runner().run("first")
    bench.second.observed = 0.0
    bench.runner().run("second", waiver="demo tomorrow")
    with pytest.raises(GateClosedError) as caught:
        bench.runner().run("third")
    assert caught.value.message.startswith("the gate of third is closed: second failed")
    assert caught.value.remedy.endswith("minidual second; then this command again")


def test_a_waiver_does_not_replace_a_result_that_a_stage_works_on(bench):
    bench.second.behaviour = lambda context: [
        Check("size", (context.upstream["first"] / "out").stat().st_size, ">", 0),
    ]
    with pytest.raises(
        GateClosedError,
        match="works on the result of first, and there is none",
    ) as caught:
        bench.runner().run("second", waiver="demo tomorrow")
    assert caught.value.remedy == "minidual first"
    bench.first.observed = 0.0
    bench.runner().run("first")
    assert bench.runner().run("second", waiver="demo tomorrow").exit_code == ExitCode.PASS


def test_a_command_that_is_refused_leaves_no_file(bench):
    with pytest.raises(GateClosedError):
        bench.runner().run("second")
    assert not bench.store.folder.exists()
    bench.runner().run("first")
    with pytest.raises(GateClosedError):
        bench.runner().run("third")
    assert (bench.store.folder / "first" / "verdict.json").is_file()


def test_waiver_ends_when_the_waived_stage_changes(bench):
    bench.first.observed = 0.0
    bench.runner().run("first")
    bench.runner().run("second", waiver="demo tomorrow")
    bench.first.observed = 1.0
    bench.runner().run("first")
    assert bench.states()[1] == "stale"
    clean = bench.runner().run("second")
    assert clean.verdict.waivers == ()
    assert bench.runner().run("third").exit_code == ExitCode.PASS


def test_waiver_over_an_open_gate_is_not_used(bench):
    bench.runner().run("first")
    assert bench.runner().run("second", waiver="just in case").verdict.waivers == ()


def test_waiver_over_nothing_gives_no_upstream_folder(bench):
    bench.runner().run("second", waiver="alone")
    context = bench.second.contexts[0]
    assert (dict(context.upstream), dict(context.verdicts)) == ({}, {})
    assert bench.states() == ["missing", "pass", "missing"]


def test_stage_sees_all_that_is_above_it(bench):
    bench.run_all()
    context = bench.third.contexts[0]
    assert set(context.upstream) == set(context.verdicts) == {"first", "second"}
    assert (context.upstream["first"] / "out" / "numbers.txt").read_text() == "first 1.0\n"
    assert context.seed == context.config.seed
    assert context.verdicts["first"].checks[0].passed


def test_smoke_never_counts_as_acceptance(tmp_path):
    bench = Bench(tmp_path, profile="smoke")
    verdict = bench.runner().run("first").verdict
    assert (verdict.status, verdict.fingerprint.profile, verdict.acceptance) == (
        "pass",
        "smoke",
        False,
    )
    assert verdict.to_json()["acceptance"] is False


def explode(context):
    raise RuntimeError("gears everywhere")


def test_crash_is_internal_with_its_traceback_in_a_file(bench):
    bench.first.behaviour = explode
    with pytest.raises(
        StageCrashedError,
        match="first crashed: RuntimeError: gears everywhere",
    ) as caught:
        bench.runner().run("first")
    assert caught.value.exit_code == ExitCode.INTERNAL
    (trace,) = bench.store.folder.glob("crash-first-*.txt")
    assert str(trace) in caught.value.message
    assert "in explode" in trace.read_text()
    assert bench.states() == ["error", "blocked", "blocked"]


def test_crash_keeps_the_previous_passing_result(bench):
    bench.run_all()
    before = bench.store.verdict_path("first").read_bytes()
    bench.first.behaviour = explode
    with pytest.raises(StageCrashedError):
        bench.runner().run("first", force=True)
    assert bench.store.verdict_path("first").read_bytes() == before
    assert bench.states() == ["pass"] * 3
    assert any(
        "a later attempt ended as error" in text for text in bench.gate().state("first").warnings
    )


def test_rerun_clears_what_a_crash_left(bench):
    bench.first.behaviour = explode
    with pytest.raises(StageCrashedError):
        bench.runner().run("first")
    assert leftovers(bench) == [".first.tmp"]
    bench.first.behaviour = None
    assert bench.runner().run("first").exit_code == ExitCode.PASS
    assert leftovers(bench) == []


def test_interrupted_stage_is_incomplete(bench):
    def interrupt(context):
        raise KeyboardInterrupt

    bench.first.behaviour = interrupt
    with pytest.raises(KeyboardInterrupt):
        bench.runner().run("first")
    assert bench.states() == ["incomplete", "blocked", "blocked"]
    assert "interrupted at the keyboard" in bench.gate().state("first").why()


def test_stage_error_keeps_its_kind(bench):
    def nothing(context):
        raise NothingEvaluatedError("no trial ran")

    bench.first.behaviour = nothing
    with pytest.raises(NothingEvaluatedError):
        bench.runner().run("first")
    assert bench.gate().state("first").why() == "no trial ran"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device", "big.h5"),
            "no space left on the disk .* big.h5",
        ),
        (
            OSError("HDF5: write failed, errno = 28, No space left on device"),
            "no space left on the disk",
        ),
        (
            OSError(errno.EDQUOT, "Disk quota exceeded", "big.h5"),
            "no space left on the disk .*quota",
        ),
        (
            OSError(errno.EFBIG, "File too large", "big.h5"),
            "no space left on the disk .*File too large",
        ),
        (
            OSError(errno.EROFS, "Read-only file system", "out.mp4"),
            "no permission for out.mp4: Read-only",
        ),
        (
            SafetensorError("I/O error: No space left on device (os error 28)"),
            "no space left on the disk",
        ),
        (
            PermissionError(errno.EACCES, "Permission denied", "out.mp4"),
            "no permission for out.mp4",
        ),
    ],
)
def test_full_or_forbidden_disk_is_one_message(bench, error, message):
    def fill(context):
        raise error

    bench.first.behaviour = fill
    with pytest.raises(EnvironmentMissingError, match=message):
        bench.runner().run("first")
    assert bench.states()[0] == "error"


def test_disk_full_before_the_verdict_leaves_the_old_result(bench, monkeypatch):
    bench.run_all()
    before = bench.store.verdict_path("first").read_bytes()

    def full(*arguments, **options):
        raise OSError(errno.ENOSPC, "No space left on device", "verdict.json")

    monkeypatch.setattr(type(bench.store), "publish", full)
    with pytest.raises(EnvironmentMissingError):
        bench.runner().run("first", force=True)
    assert bench.store.verdict_path("first").read_bytes() == before


def test_corrupt_upstream_verdict_names_file_and_command(bench):
    bench.run_all()
    path = bench.store.verdict_path("first")
    path.write_text("{")
    with pytest.raises(GateClosedError) as caught:
        bench.runner().run("second")
    assert str(path) in caught.value.message
    assert caught.value.remedy == "minidual first; then this command again"
    assert bench.runner().run("first").exit_code == ExitCode.PASS, "the named command mends it"


def test_run_resumes_at_the_first_stage_that_is_not_fresh(bench):
    bench.second.observed = 0.0
    outcomes = list(bench.runner().run_until())
    assert [o.state.name for o in outcomes] == ["first", "second"], "stops at the failure"
    bench.second.observed = 1.0
    outcomes = list(bench.runner().run_until())
    assert [(o.state.name, o.ran) for o in outcomes] == [
        ("first", False),
        ("second", True),
        ("third", True),
    ]


def test_run_until_stops_there(bench):
    assert [o.state.name for o in bench.runner().run_until("second")] == ["first", "second"]
    with pytest.raises(UsageError, match="no stage 'secnd'; there are first, second, third"):
        list(bench.runner().run_until("secnd"))


def test_run_with_a_waiver_goes_on_past_a_failure(bench):
    bench.first.observed = 0.0
    outcomes = list(bench.runner().run_until(waiver="want the report"))
    assert [o.exit_code for o in outcomes] == [
        ExitCode.ACCEPTANCE_FAILED,
        ExitCode.PASS,
        ExitCode.ACCEPTANCE_FAILED,
    ]


def test_one_writer_at_a_time(bench):
    with run_lock(bench.store.folder, "minidual carry"), pytest.raises(UsageError) as caught:
        bench.runner().run("first")
    assert "(minidual carry, since" in caught.value.message
    assert bench.first.contexts == []
    bench.runner().run("first")


@pytest.mark.parametrize("moment", ["before the new one is in place", "after it is"])
def test_replacement_cut_short_is_mended(bench, moment):
    """Between the two renames of a replacement there is an instant with the old result aside."""
    bench.run_all()
    folder = bench.store.folder / "first"
    old = bench.store.folder / ".first.old"
    if moment == "after it is":
        shutil.copytree(folder, old)
    else:
        folder.rename(old)
    assert bench.states() == ["pass"] * 3, "readers find a whole result"
    assert not bench.runner().run("first").ran
    assert folder.is_dir()
    assert not old.exists()


@pytest.mark.parametrize("run", ["", "../up", "a/b", ".hidden", "x" * 101])
def test_run_names_are_folder_names(tmp_path, run):
    with pytest.raises(UsageError, match="cannot be a run's name"):
        Bench(tmp_path, run=run)


def test_data_that_is_not_json_is_a_crash_not_a_pass(bench, monkeypatch):
    result = StageResult([Check("x", 1, "<", 2)], data={"model": object()})
    monkeypatch.setattr(bench.first, "run", lambda context: result)
    with pytest.raises(
        StageCrashedError,
        match=r"first\.data\.model: object cannot be written as JSON",
    ):
        bench.runner().run("first")


def test_runs_folder_need_not_exist(tmp_path: Path):
    bench = Bench(tmp_path / "deep" / "runs")
    assert bench.runner().run("first").exit_code == ExitCode.PASS


def refuse(config):
    raise UsageError("no method 'x'; there are a, b")


def test_what_is_typed_wrongly_is_said_before_the_gate_is_looked_at(bench):
    entries = [
        StageEntry(
            "first",
            bench.first,
            (),
            "Toy one",
            (KNOB,),
            settings={"queries": KNOB},
        ),
        StageEntry("second", bench.second, ("first",), "Toy two", check=f"{__name__}:refuse"),
    ]
    runner = Runner(StageTable(tuple(entries), libraries=("numpy",)), bench.store, bench.loaded())
    with pytest.raises(UsageError, match="no method 'x'"):
        runner.run("second")  # the gate is closed as well; the typing error comes first
    with pytest.raises(UsageError, match="no method 'x'"):
        list(runner.run_until())  # and before the first stage of a whole run
    assert bench.first.contexts == []
    with pytest.raises(ConfigError, match="queries"):
        runner.run("first", {"queries": 0})


def test_a_finished_stage_is_not_asked_for_what_only_its_work_needs(bench):
    """What one machine trained on its GPU, another without one reports."""
    bench.run_all()
    first, second, third = bench.table.values()
    checked = replace(second, check=f"{__name__}:refuse")
    bench.table = StageTable((first, checked, third), libraries=("numpy", "no-such-library"))
    assert [outcome.ran for outcome in bench.runner().run_until()] == [False, False, False]
    with pytest.raises(UsageError, match="no method 'x'"):
        list(bench.runner().run_until(force=True))
