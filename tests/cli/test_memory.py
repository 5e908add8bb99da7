"""A run remembers what was typed with --set and --seed; new values follow the rule of new runs."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.config.loader import Override, parse_override
from minidual.gate.memory import MEMORY_FILE, memory_of, without
from minidual.gate.stage import ToolContext, ToolResult
from minidual.gate.table import StageTable, ToolEntry
from tests.support.pipeline_toys import KNOB, Bench


def peek(context: ToolContext) -> ToolResult:
    """Print a value of the configuration."""
    return ToolResult(lines=[str(context.config.plan.queries_n)])


class CommandLine:
    """Three toys behind the real command line; the second reads `carry.trials_n`."""

    def __init__(self, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.bench = Bench(root / "runs")
        first, second, third = self.bench.table.values()
        second = dataclasses.replace(second, reads=("carry.trials_n",), inputs={})
        self.table = StageTable((first, second, third), libraries=("numpy",))
        self._capsys = capsys

    def __call__(self, *words: str) -> tuple[int, str, str]:
        run = [] if "--run" in words else ["--run", "toys"]
        tools = [ToolEntry("peek", peek, summary="Peek")]
        code = run_command_line(
            [*words, *run, "--runs-dir", str(self.bench.root)],
            self.table,
            tools,
        )
        return code, *self._capsys.readouterr()

    def states(self, run: str = "toys") -> list[str]:
        document = json.loads(self("status", "--json", "--run", run)[1])
        return [stage["state"] for stage in document["stages"]]

    def memory(self, run: str = "toys") -> dict[str, str]:
        return json.loads((self.bench.root / run / MEMORY_FILE).read_text())

    @property
    def runs(self) -> list[str]:
        return sorted(path.name for path in self.bench.root.iterdir())


@pytest.fixture
def cli(tmp_path, capsys):
    return CommandLine(tmp_path, capsys)


def test_later_commands_of_the_run_need_not_repeat_a_value(cli):
    assert cli("first", "--set", f"{KNOB}=3")[0] == 0
    code, _, err = cli("second")
    assert code == 0
    assert f"run 'toys' remembers --set {KNOB}=3" in err
    assert cli.bench.second.contexts[0].config.plan.queries_n == 3
    assert cli.states() == ["pass", "pass", "missing"]
    assert cli("first")[2].count("first: pass, fresh") == 1
    assert cli.memory() == {KNOB: "3"}


def test_another_run_does_not_know_it(cli):
    cli("first", "--set", f"{KNOB}=3")
    assert cli("first", "--run", "others")[0] == 0
    assert cli.bench.first.contexts[-1].config.plan.queries_n == 100
    assert not (cli.bench.root / "others" / MEMORY_FILE).exists()


def test_status_shows_what_is_remembered(cli):
    cli("first", "--set", f"{KNOB}=3", "--seed", "5")
    _, _, err = cli("status")
    assert f"run 'toys' remembers --set {KNOB}=3 --set seed=5" in err
    assert f"minidual config forget --run toys --runs-dir {cli.bench.root}" in err
    document = json.loads(cli("status", "--json")[1])
    assert document["remembered"] == {KNOB: "3", "seed": "5"}


def test_the_seed_is_remembered_and_the_number_of_workers_is_not(cli):
    cli("first", "--seed", "5", "--workers", "1")
    cli("second")
    assert cli.bench.second.contexts[0].seed == 5
    assert cli.memory() == {"seed": "5"}


def test_an_option_of_a_stage_is_not_remembered_for_others(cli):
    cli("first", "--queries", "3")
    cli("second")
    assert cli.bench.second.contexts[0].config.plan.queries_n == 100
    assert cli.states()[:2] == ["pass", "pass"]


def test_a_printed_command_leaves_out_what_is_remembered(cli):
    _, _, err = cli("first", "--set", f"{KNOB}=3")
    (following,) = [line for line in err.splitlines() if line.startswith("next: ")]
    assert following == f"next: minidual second --run toys --runs-dir {cli.bench.root}"


def test_a_command_that_is_refused_is_not_remembered(cli):
    code, _, err = cli("second", "--set", f"{KNOB}=3")
    assert code == 3
    assert f"--set {KNOB}=3; then this command again" in err
    assert cli.runs == []


def test_a_value_that_no_finished_stage_read_is_added(cli):
    cli("first", "--set", f"{KNOB}=3")
    assert cli("second", "--set", "carry.trials_n=5")[0] == 0
    assert cli.runs == ["toys"]
    assert cli.memory() == {KNOB: "3", "carry.trials_n": "5"}
    assert cli("third")[0] == 0
    assert cli.states() == ["pass"] * 3


def test_a_new_value_that_a_finished_stage_read_asks_for_a_new_run(cli):
    cli("first", "--set", f"{KNOB}=3", "--set", "carry.trials_n=5")
    code, _, err = cli("first", "--set", f"{KNOB}=4")
    assert code == 0
    own = f"toys-{KNOB}-4"
    assert f"working in run '{own}' instead" in err
    assert cli.runs == ["toys", own]
    assert cli.memory()[KNOB] == "3"
    assert cli.memory(own) == {KNOB: "4", "carry.trials_n": "5"}
    assert cli("second", "--run", own)[0] == 0
    assert cli.bench.second.contexts[-1].config.plan.queries_n == 4
    assert cli.bench.second.contexts[-1].config.carry.trials_n == 5
    assert cli("first", "--set", f"{KNOB}=4")[2].count("first: pass, fresh") == 1
    assert cli.runs == ["toys", own]


def test_yes_changes_a_value_in_place_and_what_read_it_is_stale(cli):
    cli("first", "--set", "carry.trials_n=5")
    cli("second")
    cli("third")
    code, _, err = cli("first", "--set", "carry.trials_n=6", "--yes")
    assert code == 0
    assert "stale with these values: second" in err
    assert cli.runs == ["toys"]
    assert cli.memory() == {"carry.trials_n": "6"}
    assert cli.states() == ["pass", "stale", "stale"]


def test_a_new_value_that_only_another_finished_stage_read_asks_for_a_new_run(cli):
    """The command itself has nothing to do; remembered, the value would outdate the second."""
    cli("first", "--set", "carry.trials_n=5")
    cli("second")
    code, _, err = cli("first", "--set", "carry.trials_n=6")
    assert code == 0
    assert "run 'toys' keeps its finished second: parameter carry.trials_n was 5, is 6" in err
    assert cli.runs == ["toys", "toys-carry.trials_n-6"]
    assert cli.memory() == {"carry.trials_n": "5"}
    assert cli.states()[:2] == ["pass", "pass"]
    assert cli.memory("toys-carry.trials_n-6") == {"carry.trials_n": "6"}


def test_the_same_value_typed_again_asks_for_no_new_run(cli):
    cli("first", "--set", "carry.trials_n=5")
    cli("second")
    assert cli("first", "--set", "carry.trials_n=5", "--force")[0] == 0
    assert cli("third", "--set", "carry.trials_n=5")[0] == 0
    assert cli.runs == ["toys"]


def test_a_value_typed_for_a_command_that_reads_only_is_not_remembered(cli):
    cli("first")
    _, out, _ = cli("status", "--set", f"{KNOB}=3", "--json")
    assert json.loads(out)["stages"][0]["state"] == "stale"
    assert cli.states()[0] == "pass"


def test_tools_use_it_and_do_not_change_it(cli):
    cli("first", "--set", f"{KNOB}=3")
    _, out, err = cli("peek")
    assert out.strip() == "3"
    assert "run 'toys' remembers" in err
    assert cli("peek", "--set", f"{KNOB}=4")[1].strip() == "4"
    assert cli.memory() == {KNOB: "3"}


def test_the_whole_pipeline_uses_it_and_remembers(cli):
    assert cli("run", "--set", f"{KNOB}=3")[0] == 0
    code, _, err = cli("run")
    assert code == 0
    assert err.count("pass, fresh") == 3
    assert cli.runs == ["toys"]


def test_a_forgotten_value_is_the_profiles_again(cli):
    cli("first", "--set", f"{KNOB}=3", "--set", "carry.trials_n=5")
    code, out, _ = cli("config", "forget", KNOB)
    assert code == 0
    assert f"run 'toys' forgot --set {KNOB}=3" in out
    assert "stale now: first" in out
    assert cli.memory() == {"carry.trials_n": "5"}
    assert cli.states()[0] == "stale"
    code, _, err = cli("first")
    assert code == 0
    assert "working in run 'toys-defaults' instead" in err
    assert cli.bench.first.contexts[-1].config.plan.queries_n == 100


def test_a_section_or_everything_can_be_forgotten(cli):
    values = ("carry.trials_n=5", "carry.pace.landing_s=0.3", f"{KNOB}=3")
    cli("first", *[word for value in values for word in ("--set", value)])
    assert cli("config", "forget", "carry")[0] == 0
    assert cli.memory() == {KNOB: "3"}
    document = json.loads(cli("config", "forget", "--json")[1])
    assert document["forgotten"] == {KNOB: "3"}
    assert document["stale"] == ["first"]
    assert cli.memory() == {}
    assert "forgot nothing" in cli("config", "forget")[1]


def test_what_is_not_remembered_cannot_be_forgotten(cli):
    cli("first", "--set", f"{KNOB}=3")
    code, _, err = cli("config", "forget", "plan.query_n")
    assert code == 2
    assert f"no remembered value 'plan.query_n'; there are {KNOB}" in err
    assert cli("config", "forget", "--run", "nowhere")[0] == 2
    assert cli.memory() == {KNOB: "3"}


def test_a_remembered_value_that_is_invalid_is_named_with_its_remedy(cli):
    cli("first")
    (cli.bench.root / "toys" / MEMORY_FILE).write_text('{"plan.queries": "3"}')
    code, _, err = cli("second")
    assert code == 2
    assert "run 'toys' remembers --set plan.queries=3" in err
    assert "remedy: minidual config forget --run toys" in err
    assert cli("config", "forget", "plan.queries")[0] == 0
    assert cli("second")[0] == 0


@pytest.mark.parametrize("text", ["{", "[]", '{"a.b": 3}'])
def test_a_damaged_memory_is_named_and_can_be_forgotten(cli, text):
    cli("first")
    path = cli.bench.root / "toys" / MEMORY_FILE
    path.write_text(text)
    code, _, err = cli("status")
    assert code != 0
    assert f"{path} is damaged" in err
    assert cli("config", "forget")[0] == 0
    assert cli.states()[0] == "pass"


def test_a_value_replaces_those_below_it():
    typed = ["benchmark.success_rate_min.act=0.1", "plan.queries_n=3", "benchmark={}"]
    overrides = [parse_override(text) for text in typed]
    assert memory_of(overrides) == {"plan.queries_n": "3", "benchmark": "{}"}
    assert memory_of([Override("workers", 3, "--workers 3")]) == {}


def test_only_whole_names_are_left_out():
    memory = {"plan.queries_n": "1", "planner": "2", "plan": "3"}
    assert without(memory, ["plan"]) == {"planner": "2"}
