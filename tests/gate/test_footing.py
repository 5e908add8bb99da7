"""A stage stays fresh while what it reads stays the same, and becomes stale when that changes."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import pytest

from minidual.errors import ExitCode, GateClosedError
from minidual.gate.check import Check
from minidual.gate.table import StageEntry, StageTable
from tests.support.pipeline_toys import KNOB, Bench, Toy

READS_NUMBERS = {"first": ("out/*",)}
READS_NOTHING = {}
WITHOUT_SECOND = 3
"""Value of KNOB with which the last toy of `Optional` does not need the second."""


def bench_with(tmp_path, inputs) -> Bench:
    """Return toys whose second names its inputs, all finished."""
    bench = Bench(tmp_path / "runs")
    first, second, third = bench.table.values()
    bench.table = StageTable((first, replace(second, inputs=inputs), third), libraries=("numpy",))
    clock = itertools.count()

    def work(context):
        quality = Check("quality", bench.first.observed, ">=", 1.0)
        return [quality, Check("work_s", next(clock), unit="s", clocked=True)]

    bench.first.behaviour = work
    bench.run_all()
    return bench


def again(bench: Bench, *overrides: str) -> list[str]:
    """Run the first toy again; return the states."""
    bench.runner(*overrides).run("first", force=True)
    return bench.states(*overrides)


@pytest.mark.parametrize("inputs", [READS_NUMBERS, READS_NOTHING])
def test_an_upstream_stage_that_finds_the_same_leaves_it_fresh(tmp_path, inputs):
    bench = bench_with(tmp_path, inputs)
    assert again(bench) == ["pass", "pass", "stale"], "the closing stage reads times, too"
    assert [outcome.ran for outcome in bench.runner().run_until()] == [False, False, True]


def test_a_lost_artefact_made_again_leaves_it_fresh(tmp_path):
    bench = bench_with(tmp_path, READS_NOTHING)
    (bench.store.folder / "first" / "out" / "numbers.txt").unlink()
    assert bench.states() == ["stale"] * 3
    assert [outcome.ran for outcome in bench.runner().run_until()] == [True, False, True]


def test_a_changed_artefact_that_it_reads_makes_it_stale(tmp_path):
    bench = bench_with(tmp_path, READS_NUMBERS)
    bench.first.behaviour = _writes("other words")
    assert again(bench)[1] == "stale"
    assert bench.gate().state("second").reasons == (
        "input first/out/numbers.txt changed or is gone",
    )


def test_a_new_artefact_of_a_pattern_makes_it_stale(tmp_path):
    bench = bench_with(tmp_path, READS_NUMBERS)
    bench.first.behaviour = _writes("more", name="more.txt")
    again(bench)
    assert bench.gate().state("second").reasons == ("input first/out/more.txt is new",)


def test_a_changed_artefact_that_it_does_not_read_leaves_it_fresh(tmp_path):
    bench = bench_with(tmp_path, {"first": ("out/others.txt",)})
    bench.first.behaviour = _writes("other words")
    assert again(bench)[1] == "pass"


def _writes(text: str, name: str = "numbers.txt"):
    def write(context):
        (context.folder / "out" / name).write_text(text)
        return [Check("quality", 1.0, ">=", 1.0), Check("work_s", 9.0, unit="s", clocked=True)]

    return write


def test_another_measured_result_makes_it_stale(tmp_path):
    bench = bench_with(tmp_path, READS_NOTHING)
    bench.first.observed = 2.0
    assert again(bench)[1] == "stale"
    assert bench.gate().state("second").reasons == ("upstream stage first ran again since",)


@pytest.mark.parametrize(
    ("check", "state"),
    [
        (Check("planning_s", 0.3, "<", 1.0, "s", clocked=True), "pass"),
        (Check("planning_s", 0.2, "<", 0.9, "s", clocked=True), "stale"),  # another limit
        (Check("planning_s", 0.2, unit="s", clocked=True), "stale"),  # no limit
        (Check("planning_s", 0.3, "<", 1.0, "s"), "stale"),  # not of a clock
    ],
)
def test_only_the_value_of_a_clock_may_differ(tmp_path, check, state):
    bench = Bench(tmp_path / "runs")
    first, second, _ = bench.table.values()
    bench.table = StageTable((first, replace(second, inputs={})), libraries=("numpy",))
    quality = Check("quality", 1.0, ">=", 1.0)
    before = Check("planning_s", 0.2, "<", 1.0, "s", clocked=True)
    bench.first.behaviour = lambda context: [quality, before]
    bench.run_all()
    bench.first.behaviour = lambda context: [quality, check]
    assert again(bench)[1] == state


def test_a_clock_that_exceeds_its_limit_closes_the_gate(tmp_path):
    bench = bench_with(tmp_path, READS_NOTHING)
    slow = Check("planning_s", 2.0, "<", 1.0, "s", clocked=True)
    bench.first.behaviour = lambda context: [slow]
    assert again(bench)[:2] == ["fail", "stale"]
    assert "upstream stage first is fail" in bench.gate().state("second").reasons
    with pytest.raises(GateClosedError, match="planning_s is 2 s"):
        bench.runner().run("second")


def test_other_parameters_of_an_upstream_stage_make_it_stale(tmp_path):
    """The toy finds the same; it was asked for less, which must show further down."""
    bench = bench_with(tmp_path, READS_NUMBERS)
    assert again(bench, f"{KNOB}=3")[:2] == ["pass", "stale"]
    verdict = bench.runner(f"{KNOB}=3").run("second").verdict
    assert verdict.weakened == (f"first: {KNOB} is 3, the profile asks for 100",)
    assert verdict.acceptance is False


@pytest.mark.parametrize("inputs", [READS_NUMBERS, READS_NOTHING])
def test_a_waiver_further_up_taints_what_stands_on_it(tmp_path, inputs):
    """The second toy reads nothing of the zeroth, and the first one finds the same."""
    bench = Bench(tmp_path / "runs")
    zeroth = Toy("zeroth")
    first, second, _ = bench.table.values()
    bench.table = StageTable(
        (
            StageEntry("zeroth", zeroth, (), "Toy zero"),
            replace(first, requires=("zeroth",), inputs={}),
            replace(second, inputs=inputs),
        ),
        libraries=("numpy",),
    )
    bench.run_all()
    assert bench.states() == ["pass"] * 3
    zeroth.observed = 0.0
    bench.runner().run("zeroth", force=True)
    bench.runner().run("first", waiver="demo tomorrow")
    assert bench.states() == ["fail", "pass", "stale"]
    verdict = bench.runner().run("second").verdict
    assert [waiver.reason for waiver in verdict.waivers] == ["demo tomorrow"]
    assert verdict.acceptance is False


def test_an_upstream_stage_that_is_gone_closes_the_gate(tmp_path):
    bench = bench_with(tmp_path, READS_NOTHING)
    bench.store.verdict_path("first").unlink()
    assert bench.states() == ["missing", "stale", "stale"]


def test_a_stage_is_given_only_what_its_row_names(tmp_path):
    bench = bench_with(tmp_path, READS_NOTHING)
    context = bench.second.contexts[0]
    assert (dict(context.upstream), dict(context.verdicts)) == ({}, {})
    assert set(bench_with(tmp_path / "named", READS_NUMBERS).second.contexts[0].upstream) == {
        "first",
    }


def test_a_verdict_says_which_value_is_of_a_clock():
    assert Check("a", 1.0, clocked=True).to_json()["clocked"] is True
    assert "clocked" not in Check("a", 1.0).to_json()


# What a configuration needs


def needs_second(config):
    """Return what the third toy needs."""
    return ("first",) if config.plan.queries_n == WITHOUT_SECOND else ("first", "second")


class Optional(Bench):
    """Toys: first; second on it; third, which may need the second; and a closing one."""

    def __init__(self, root) -> None:
        super().__init__(root)
        self.last = Toy("last")
        first, second, third = self.table.values()
        self.table = StageTable(
            (
                replace(first, reads=(), settings={}),
                second,
                replace(
                    third,
                    requires=("first", "second"),
                    needs=f"{__name__}:needs_second",
                    reads=(KNOB,),
                    settings={"queries": KNOB},
                    options=first.options,
                    closing=False,
                ),
                StageEntry("last", self.last, ("third",), "Toy four", (KNOB,), closing=True),
            ),
            libraries=("numpy",),
        )


@pytest.fixture
def optional(tmp_path):
    bench = Optional(tmp_path / "runs")
    bench.runner().run("first")
    return bench


def test_a_gate_asks_only_for_what_is_used(optional):
    outcome = optional.runner().run("third", {"queries": WITHOUT_SECOND})
    assert outcome.exit_code == ExitCode.PASS
    assert set(outcome.verdict.fingerprint.upstream) == {"first"}
    assert optional.states()[:3] == ["pass", "missing", "pass"]
    assert set(optional.third.contexts[0].upstream) == {"first"}


@pytest.mark.parametrize("options", [{}, {"queries": 4}])
def test_what_is_used_still_closes_the_gate(optional, options):
    with pytest.raises(GateClosedError, match="second has not run") as caught:
        optional.runner().run("third", options)
    assert caught.value.remedy == "minidual second; then this command again"
    optional.second.observed = 0.0
    optional.runner().run("second")
    with pytest.raises(GateClosedError, match="second failed"):
        optional.runner().run("third", options)


def test_what_is_needed_closes_the_gate_whatever_else_is_left_out(optional):
    optional.first.observed = 0.0
    optional.runner().run("first", force=True)
    with pytest.raises(GateClosedError, match="first failed"):
        optional.runner().run("third", {"queries": WITHOUT_SECOND})


def test_run_until_runs_only_what_is_needed(optional):
    without = optional.runner(f"{KNOB}={WITHOUT_SECOND}").run_until("third")
    assert [outcome.state.name for outcome in without] == ["first", "third"]
    every = optional.runner().run_until("third")
    assert [outcome.state.name for outcome in every] == ["first", "second", "third"]


def test_the_closing_stage_sees_what_was_left_out(optional):
    optional.runner().run("third", {"queries": WITHOUT_SECOND})
    optional.runner().run("last")
    assert optional.last.contexts[0].states == {
        "first": "pass",
        "second": "missing",
        "third": "pass",
    }
    optional.runner().run("second")
    assert optional.gate().state("last").reasons == ("upstream stage second has run since",)
    optional.runner().run("last")
    assert optional.states() == ["pass"] * 4


def test_a_passing_report_is_stale_when_a_stage_that_it_read_is(optional):
    """No gate between them needs the second toy."""
    optional.runner().run("second")
    optional.runner().run("third", {"queries": WITHOUT_SECOND})
    optional.runner().run("last")
    assert optional.states() == ["pass"] * 4
    (optional.store.folder / "second" / "out" / "numbers.txt").unlink()
    assert optional.states() == ["pass", "stale", "pass", "stale"]
    assert optional.gate().state("last").reasons == ("upstream stage second is stale",)


def test_a_verdict_lists_only_the_inputs_that_it_reads(tmp_path):
    bench = bench_with(tmp_path, READS_NUMBERS)
    record = json.loads(bench.store.verdict_path("second").read_text())
    assert record["fingerprint"]["inputs"].keys() == {"first/out/numbers.txt"}
    others = bench_with(tmp_path / "others", READS_NOTHING)
    record = json.loads(others.store.verdict_path("second").read_text())
    assert record["fingerprint"]["inputs"] == {}
