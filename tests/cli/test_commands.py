"""The command line: exit codes, what goes to stdout and stderr, and the messages."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys

import pytest
import typer

import minidual
from minidual.cli.app import build_app, run_command_line
from minidual.cli.commands.table import RUN_COMMANDS, STAGE_COMMANDS, TOOL_COMMANDS
from minidual.cli.process import interrupt
from minidual.cli.signature import help_and_examples
from minidual.errors import DataError
from minidual.gate.table import StageEntry
from minidual.stages.registry import STAGES, TOOLS
from tests.support.pipeline_toys import Bench

COMMANDS = {**STAGE_COMMANDS, **RUN_COMMANDS, **TOOL_COMMANDS}


class CommandLine:
    """The toys behind the real command line."""

    def __init__(self, root, capsys) -> None:
        self.bench = Bench(root / "runs")
        self._capsys = capsys

    def __call__(self, *words: str) -> tuple[int, str, str]:
        run = [] if "--run" in words else ["--run", "toys"]
        code = run_command_line(
            [*words, *run, "--runs-dir", str(self.bench.root)],
            self.bench.table,
        )
        return code, *self._capsys.readouterr()

    def json(self, *words: str) -> tuple[int, dict]:
        code, out, _ = self(*words, "--json")
        return code, json.loads(out)


@pytest.fixture
def cli(tmp_path, capsys):
    return CommandLine(tmp_path, capsys)


def test_passing_stage_prints_table_paths_and_next_command(cli):
    code, out, err = cli("first")
    assert code == 0
    assert out.strip() == str(cli.bench.store.verdict_path("first"))
    for word in (
        "check",
        "observed",
        "limit",
        "margin",
        "result",
        "quality",
        ">= 1 n",
        "+0 (+0%)",
        "reported",
    ):
        assert word in err
    assert str(cli.bench.store.folder / "first" / "out" / "numbers.txt") in err
    assert f"next: minidual second --run toys --runs-dir {cli.bench.root}" in err


def test_fresh_stage_prints_its_table_and_says_so(cli):
    cli("first")
    code, _, err = cli("first")
    assert code == 0
    assert "first: pass, fresh" in err
    assert "quality" in err
    assert len(cli.bench.first.contexts) == 1


def test_failed_acceptance_exits_1(cli):
    cli.bench.first.observed = 0.5
    code, _, err = cli("first")
    assert code == 1
    assert "FAIL" in err
    assert "next: minidual explain first" in err


def test_usage_errors_exit_2(cli, capsys):
    assert run_command_line(["frist"], cli.bench.table) == 2
    err = capsys.readouterr().err
    assert "no command 'frist'; there are config, data, explain, export, first" in err
    assert "did you mean 'first'?" in err
    assert cli("first", "--nonsense")[0] == 2
    assert cli("first", "--profile", "nope")[0] == 2
    assert cli("first", "--set", "plan.queries_n=0")[0] == 2
    assert cli("first", "--queries", "many")[0] == 2
    assert cli("explain", "frist")[0] == 2
    assert cli("run", "--until", "frist")[0] == 2
    assert cli("first", "--run", "../up")[0] == 2
    assert not cli.bench.store.folder.exists()


@pytest.mark.parametrize(
    "words",
    [("first", "--queries", "many"), ("first", "--nonsense"), ("frist",), ("config",)],
)
def test_what_cannot_be_parsed_is_a_document_too(cli, words):
    code, document = cli.json(*words)
    assert code == document["exit_code"] == 2
    assert document["error"]["kind"] == "UsageError"
    remedy = {
        "first": "minidual first --help",
        "config": "minidual config --help",
        "frist": "did you mean 'first'?",
    }
    assert document["error"]["remedy"] == remedy[words[0]]


@pytest.mark.parametrize("command", ["status", "explain", "explain first", "doctor"])
def test_a_misspelt_run_is_not_an_empty_one(cli, capsys, command):
    words = [*command.split(), "--runs-dir", str(cli.bench.root)]
    assert run_command_line([*words, "--run", "toys"], cli.bench.table, TOOLS) == 2
    assert "no run 'toys'; there are none" in capsys.readouterr().err
    cli("first")
    assert run_command_line([*words, "--run", "tyos"], cli.bench.table, TOOLS) == 2
    err = capsys.readouterr().err
    assert "no run 'tyos'; there are toys" in err
    assert "did you mean 'toys'?" in err
    assert not (cli.bench.root / "tyos").exists()


def test_commands_in_explained_remedies_act_on_this_run(cli):
    cli.bench.first.observed = 0.5
    cli.bench.first.remedy = "minidual first --force"
    cli("first")
    mended = "minidual first --force --run toys"
    assert mended in " ".join(cli("explain")[1].split())
    assert mended in " ".join(cli("explain", "first")[1].replace("│", " ").split())


def test_option_before_the_command_is_told_its_place(capsys):
    assert run_command_line(["--profile=smoke", "carry"], STAGES) == 2
    assert (
        "--profile stands after the command: minidual COMMAND --profile" in capsys.readouterr().err
    )


def test_file_in_place_of_the_runs_folder_exits_2(tmp_path, capsys):
    (tmp_path / "runs").write_text("")
    assert (
        run_command_line(["first", "--runs-dir", str(tmp_path / "runs")], Bench(tmp_path).table)
        == 2
    )
    assert (
        f"{tmp_path / 'runs'} is a file; minidual keeps a folder there" in capsys.readouterr().err
    )


def test_closed_gate_exits_3_with_the_command_in_full(cli):
    code, out, err = cli("second", "--profile", "smoke", "--set", "seed=4")
    assert (code, out) == (3, "")
    assert "the gate of second is closed: first has not run" in err
    flags = f"--profile smoke --run toys --runs-dir {cli.bench.root} --set seed=4"
    assert f"remedy: minidual first {flags}" in err


def test_missing_library_exits_4(cli, monkeypatch):
    broken = StageEntry("first", "no_such_library_at_all.stage:run", (), "Broken")
    monkeypatch.setitem(cli.bench.table._rows, "first", broken)
    code, _, err = cli("first")
    assert code == 4
    assert "needs the library 'no_such_library_at_all'" in err


def test_nothing_evaluated_exits_5(cli):
    cli.bench.first.behaviour = lambda context: []
    assert cli("first")[0] == 5


def explode(context):
    raise ZeroDivisionError("gears")


def test_crash_exits_70_with_one_line_and_a_file(cli):
    cli.bench.first.behaviour = explode
    code, out, err = cli("first")
    assert (code, out) == (70, "")
    assert "Traceback" not in err
    assert "first crashed: ZeroDivisionError: gears; traceback in" in err
    assert "Traceback" in cli("first", "--debug")[2]


def test_crash_outside_a_stage_exits_70_too(cli, monkeypatch):
    cli.bench.store.folder.mkdir(parents=True)
    monkeypatch.setattr("minidual.gate.gate.Gate.state", explode)
    code, _, err = cli("status")
    assert code == 70
    assert "internal error: " in err
    assert list(cli.bench.store.folder.glob("crash-cli-*.txt"))


def test_interrupt_exits_130_with_one_line(cli):
    def interrupt(context):
        raise KeyboardInterrupt

    cli.bench.first.behaviour = interrupt
    code, out, err = cli("first")
    assert (code, out) == (130, "")
    assert err.strip().splitlines()[-1].startswith("minidual: interrupted")
    assert "Traceback" not in err


@pytest.mark.parametrize(
    "made",
    [ValueError("Error building a serializer"), DataError("pot.xml is truncated")],
)
def test_interrupt_that_a_stage_turns_into_an_error_of_its_own_exits_130(cli, monkeypatch, made):
    """Whatever the stage raises in place of KeyboardInterrupt, it is an interrupt."""
    monkeypatch.setattr(interrupt, "raised", False)

    def greedy(context):
        try:
            interrupt(signal.SIGINT, None)
        except KeyboardInterrupt:
            raise made from None

    cli.bench.first.behaviour = greedy
    code, out, err = cli("first")
    assert (code, out) == (130, "")
    assert (
        err.strip()
        .splitlines()[-1]
        .startswith("minidual: interrupted; nothing half-written counts")
    )
    assert not list(cli.bench.store.folder.glob("crash-*.txt"))
    state = cli.bench.gate().state("first")
    assert state.state == "incomplete"
    assert "interrupted at the keyboard" in state.why()


@pytest.mark.parametrize(
    ("remedy", "said"),
    [
        ("minidual second", "minidual second{}"),
        (
            "retrain it: minidual second --force; or wait",
            "retrain it: minidual second --force{}; or wait",
        ),
        ("(minidual first checks collisions)", "(minidual first{} checks collisions)"),
        ("minidual first --set plan.queries_n=...", "minidual first{} --set plan.queries_n=..."),
        (
            "minidual run --until second, or minidual status",
            "minidual run --until second{}, or minidual status{}",
        ),
        (
            "minidual first --force, then: minidual second{}",
            "minidual first --force{}, then: minidual second{}",
        ),
        (
            "replay it with the minidual 1.0 that made it",
            "replay it with the minidual 1.0 that made it",
        ),
        ("minidual first-aid", "minidual first-aid"),
    ],
)
def test_commands_of_a_remedy_act_on_the_run_that_failed(cli, remedy, said):
    """Without the typed options a printed command would act on run `standard`."""
    flags = f" --run xarm --runs-dir {shlex.quote(str(cli.bench.root))} --set seed=4"

    def fail(context):
        raise DataError("the policy is damaged", remedy=remedy.format(flags))

    cli.bench.first.behaviour = fail
    _, _, err = cli("first", "--run", "xarm", "--set", "seed=4")
    assert f"  remedy: {said.format(*[flags] * 2)}\n" in err
    _, document = cli.json("first", "--run", "xarm", "--set", "seed=4")
    assert document["error"]["remedy"] == said.format(*[flags] * 2)


def test_a_remedy_stays_as_it_is_in_the_run_of_its_profile(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["second"], Bench(tmp_path).table) == 3
    assert "  remedy: minidual first; then this command again\n" in capsys.readouterr().err


def test_corrupt_verdict_names_file_and_command(cli):
    cli("first")
    path = cli.bench.store.verdict_path("first")
    path.write_text('{"schema": NaN}')
    code, _, err = cli("second")
    assert code == 3
    assert f"{path} is corrupt: schema nan is not 2" in err
    assert "remedy: minidual first --run toys" in err
    code, out, _ = cli("status")
    assert code == 0
    assert "error" in out


def test_force_reruns(cli):
    cli("first")
    assert cli("first", "--force")[0] == 0
    assert len(cli.bench.first.contexts) == 2
    assert cli("third", "--force")[0] == 3


def test_waived_gate_is_loud_everywhere(cli):
    cli.bench.first.observed = 0.0
    cli("first")
    code, _, err = cli("second", "--waive-gate", "demo day")
    assert code == 0
    assert "GATE WAIVED at second: demo day" in err
    code, _, err = cli("third")
    assert code == 1
    assert "gate.waivers" in err
    assert "GATE WAIVED" in cli("explain", "third")[1]
    _, status = cli.json("status")
    assert [stage["waivers"] for stage in status["stages"]] == [[], ["demo day"], ["demo day"]]
    assert [stage["acceptance"] for stage in status["stages"]][1:] == [False, False]


@pytest.mark.parametrize("reason", ["", "  "])
def test_a_waiver_without_a_reason_opens_no_gate(cli, reason):
    """A script with an unset variable must not."""
    cli.bench.first.observed = 0.0
    cli("first")
    code, _, err = cli("second", "--waive-gate", reason)
    assert code == 2
    assert "--waive-gate needs a reason" in err
    assert cli.bench.second.contexts == []


def test_the_next_command_after_an_interruption_has_its_options(cli):
    """Without them it would set the interrupted recording aside and begin another."""

    def interrupt(context):
        raise KeyboardInterrupt

    cli.bench.first.behaviour = interrupt
    assert cli("first", "--queries", "3", "--mood", "good day")[0] == 130
    _, out, _ = cli("status")
    assert "next: minidual first --run toys" in out
    assert out.rstrip().endswith("--queries 3 --mood 'good day'")
    assert (
        "with --queries 3 --mood 'good day', interrupted" in cli.bench.gate().state("first").why()
    )
    cli.bench.first.behaviour = None
    assert cli("first", "--queries", "3", "--mood", "good day")[0] == 0
    assert "--queries" not in cli("status")[1]


def test_json_of_a_stage_is_one_document(cli):
    code, document = cli.json("first")
    assert code == 0
    assert document["verdict"]["status"] == "pass"
    assert (document["ran"], document["state"]) == (True, "pass")
    assert document["next"].startswith("next: minidual second")
    assert cli.json("first")[1]["ran"] is False


def test_json_of_an_error_is_one_document(cli):
    code, document = cli.json("second")
    assert code == document["exit_code"] == 3
    assert document["error"]["kind"] == "GateClosedError"
    assert "minidual first" in document["error"]["remedy"]


def test_run_resumes_and_summarises(cli):
    code, _, err = cli("run", "--until", "second")
    assert code == 0
    assert [len(toy.contexts) for toy in (cli.bench.first, cli.bench.second, cli.bench.third)] == [
        1,
        1,
        0,
    ]
    code, out, err = cli("run")
    assert code == 0
    assert "first: pass, fresh" in err
    assert "every stage passes and is fresh" in err
    assert len(out.splitlines()) == 3
    _, document = cli.json("run")
    assert [stage["ran"] for stage in document["stages"]] == [False] * 3


def test_run_stops_at_a_failure_with_its_code(cli):
    cli.bench.second.observed = 0.0
    code, document = cli.json("run")
    assert code == document["exit_code"] == 1
    assert [stage["stage"] for stage in document["stages"]] == ["first", "second"]


def test_status_shows_every_state_and_why(cli):
    cli.bench.store.folder.mkdir(parents=True)
    code, document = cli.json("status")
    assert code == 0
    assert [stage["state"] for stage in document["stages"]] == ["missing", "blocked", "blocked"]
    cli("run")
    code, out, _ = cli("status", "--set", "plan.queries_n=3")
    assert out.count("stale") >= 3
    assert "parameter plan.queries_n was" in out


def test_status_writes_nothing(cli):
    cli("status")
    cli("explain", "second")
    assert not cli.bench.root.exists()


def test_explain_tells_checks_margins_reasons_and_requirements(cli):
    cli.bench.first.observed = 0.5
    cli("first")
    code, out, _ = cli("explain", "first", "--all")
    assert code == 0
    for words in (
        "first is fail",
        "toys must hold",
        "hold harder",
        "-0.5 (-50%)",
        "requires no other stage",
    ):
        assert words in out
    _, out, _ = cli("explain", "second")
    for words in (
        "second is blocked",
        "requires first: fail",
        "quality is 0.5 n, limit >= 1 n",
        "minidual first",
    ):
        assert words in out
    assert cli.json("explain", "second")[1]["requires"] == {"first": "fail"}


def test_options_of_a_stage_reach_it_and_are_written_down(cli):
    assert cli("first", "--queries", "3", "--seed", "9", "--workers", "5")[0] == 0
    context = cli.bench.first.contexts[0]
    assert (context.config.plan.queries_n, context.seed, context.workers) == (3, 9, 5)
    assert dict(context.options) == {"queries": 3}
    verdict = json.loads(cli.bench.store.verdict_path("first").read_text())
    assert verdict["overrides"] == ["--seed 9", "--workers 5", "--queries 3"]
    assert cli("first", "--queries", "0")[2].startswith(
        "minidual: --queries 0: plan.queries_n: must be greater",
    )


def test_smoke_is_labelled(cli):
    _, _, err = cli("first", "--profile", "smoke")
    assert "profile 'smoke': a quick test, never acceptance" in err
    assert cli.json("first", "--profile", "smoke")[1]["verdict"]["acceptance"] is False


def test_default_run_is_the_profile_under_the_runs_variable(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("MINIDUAL_RUNS", str(tmp_path / "elsewhere"))
    bench = Bench(tmp_path)
    assert run_command_line(["first", "--profile", "smoke"], bench.table) == 0
    assert (tmp_path / "elsewhere" / "smoke" / "first" / "verdict.json").is_file()
    assert (
        run_command_line(["first", "--run", "mine", "--runs-dir", str(tmp_path / "x")], bench.table)
        == 0
    )
    assert (tmp_path / "x" / "mine" / "first" / "verdict.json").is_file()
    monkeypatch.delenv("MINIDUAL_RUNS")
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["first"], bench.table) == 0
    assert (tmp_path / "runs" / "standard" / "first" / "verdict.json").is_file()
    capsys.readouterr()


def test_config_show_prints_yaml_or_json(cli, capsys):
    assert (
        run_command_line(["config", "show", "--profile", "smoke", "--set", "seed=8"], STAGES) == 0
    )
    text = capsys.readouterr().out
    assert "# profile: smoke" in text
    assert "seed: 8" in text
    assert run_command_line(["config", "show", "--json"], STAGES) == 0
    assert json.loads(capsys.readouterr().out)["config"]["acceptance"] is True


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("robot.arm=xarm", "did you mean 'xarm7'?"),
        ("task=nope", "no task 'nope'; there are handover, "),
        ("benchmark.methods=[impedence]", "did you mean 'impedance'?"),
        ("teleop.conditions=[clean, roon]", "did you mean 'room'?"),
        (
            "scene.object.name=stick",
            "the task 'insertion' has no object 'stick'; there are peg, socket",
        ),
    ],
)
def test_config_show_refuses_names_that_no_table_has(cli, capsys, setting, said):
    assert run_command_line(["config", "show", "--set", setting], STAGES) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err


def test_version(capsys):
    assert run_command_line(["--version"], STAGES) == 0
    assert capsys.readouterr().out.strip() == f"minidual {minidual.__version__}"


def test_help_lists_every_command_in_order(capsys):
    assert run_command_line(["--help"], STAGES, TOOLS) == 0
    text = capsys.readouterr().out
    commands = ["Stages, in order", *STAGES, "The run", "run", "status", "explain", "config"]
    tools = ["Tools, without gate and verdict", *(tool.name for tool in TOOLS)]
    places = [text.index(f" {name} ") for name in [*commands, *tools]]
    assert places == sorted(places)
    words = " ".join(text.replace("│", " ").split())
    for command in COMMANDS.values():
        summary = help_and_examples(command)[0].partition("\n\n")[0]
        assert summary in words, "summaries are whole"


def test_the_help_of_a_stage_is_its_summary():
    for name, command in STAGE_COMMANDS.items():
        assert help_and_examples(command)[0] == f"{STAGES[name].summary}."


def test_every_stage_and_tool_of_the_package_has_a_command_function():
    assert tuple(STAGE_COMMANDS) == tuple(STAGES)
    assert tuple(TOOL_COMMANDS) == tuple(tool.name for tool in TOOLS)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_shows_examples_that_can_be_typed(name, capsys):
    _, examples = help_and_examples(COMMANDS[name])
    assert len(examples) >= 2
    assert run_command_line([name, "--help"], STAGES, TOOLS) == 0
    words = " ".join(capsys.readouterr().out.split())
    parser = typer.main.get_command(build_app(STAGES, TOOLS)).commands[name]
    for example in examples:
        assert example in words
        program, command, *arguments = shlex.split(example)
        assert (program, command) == ("minidual", name)
        parser.make_context(name, arguments)  # raises if it cannot be parsed


def test_an_example_that_cannot_be_typed_is_found():
    parser = typer.main.get_command(build_app(STAGES, TOOLS)).commands["plan"]
    with pytest.raises(typer.TyperException):
        parser.make_context("plan", ["--querries", "3"])


def test_completion_can_be_installed():
    """The shell is named where it cannot be detected."""
    environment = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    command = [sys.executable, "-m", "minidual.cli", "--show-completion", "bash"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert "_MINIDUAL_COMPLETE=complete_bash" in done.stdout, done.stderr
    environment |= {
        "_MINIDUAL_COMPLETE": "complete_bash",
        "COMP_WORDS": "minidual te",
        "COMP_CWORD": "1",
    }
    done = subprocess.run(command[:3], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["teleop-record"]


@pytest.mark.parametrize(
    ("command", "option"),
    [
        ("teleop-record", "--episodes"),
        ("benchmark", "--methods"),
        ("plan", "--queries"),
        ("carry", "--trials"),
        ("deploy", "--trials"),
        ("run", "--until"),
    ],
)
def test_commands_have_their_options(capsys, command, option):
    assert run_command_line([command, "--help"], STAGES) == 0
    text = capsys.readouterr().out
    for name in (
        option,
        "--profile",
        "--set",
        "--run",
        "--seed",
        "--workers",
        "--force",
        "--waive-gate",
        "--json",
    ):
        assert name in text


HEAVY = (
    "numpy",
    "torch",
    "mujoco",
    "lerobot",
    "matplotlib",
    "pinocchio",
    "ompl",
    "toppra",
    "scipy",
    "h5py",
    "cv2",
    "numba",
)


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["--version"], ["carry", "--help"], ["config", "show"]],
)
def test_light_commands_import_nothing_heavy(arguments):
    script = (
        "import sys\n"
        "from minidual.cli.app import run_command_line\n"
        "from minidual.stages.registry import STAGES\n"
        "code = run_command_line(sys.argv[1:], STAGES)\n"
        f"heavy = [name for name in {HEAVY!r} if name in sys.modules]\n"
        "print('HEAVY', heavy, 'click' in sys.modules, file=sys.stderr)\n"
        "sys.exit(code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "HEAVY [] False" in done.stderr


def test_closed_pipe_is_no_error(tmp_path):
    """`minidual config show | head -1` must not end in a traceback."""
    command = f"{sys.executable} -m minidual.cli config show | head -1"
    done = subprocess.run(
        ["bash", "-c", command],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.stdout.startswith("# profile: standard")
    assert done.stderr == ""
