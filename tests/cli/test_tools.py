"""Tools and asides: commands that are no stage write no verdict and leave nothing half-written."""

import json

import pytest

from minidual.cli.app import run_command_line
from minidual.cli.options import CommonOptions
from minidual.cli.session import Session
from minidual.errors import DataError, ExitCode
from minidual.gate.stage import ToolContext, ToolResult
from minidual.gate.table import Option, StageEntry, StageTable, ToolEntry
from tests.support.pipeline_toys import Toy


def measure(context: ToolContext) -> ToolResult:
    if context.options.get("fail"):
        (context.output / "half.txt").write_text("half")
        raise DataError("the tool broke off")
    (context.output / "number.txt").write_text(str(context.seed))
    words = context.options.get("names", "")
    if "queries" in context.options:
        words += f"queries {context.config.plan.queries_n}"
    return ToolResult([f"seed {context.seed} {words}"], ["a note"], {"seed": context.seed})


def refuse(context: ToolContext) -> ToolResult:
    return ToolResult(exit_code=ExitCode.ACCEPTANCE_FAILED)


OPTIONS = (Option("fail", "Break off.", bool), Option("names", "Words."))
TOOLS = (
    ToolEntry("measure", f"{__name__}:measure", "Measure", options=OPTIONS),
    ToolEntry("refuse", f"{__name__}:refuse", "Refuse"),
)
QUERIES = Option("queries", "How many.", int)
SETTINGS = {"queries": "plan.queries_n"}
ASIDE = ToolEntry(
    "number-tune",
    f"{__name__}:measure",
    settings=SETTINGS,
    options=(Option("tune", "Tune.", bool), Option("how-fast", "Speed.", float), QUERIES),
)
OTHER = ToolEntry("number-other", f"{__name__}:measure", options=(Option("other", "Other.", bool),))


@pytest.fixture
def run(tmp_path, capsys):
    stage = Toy("first")
    options = (QUERIES, Option("mood", "No configuration."))
    table = StageTable(
        [
            StageEntry(
                stage.name,
                stage,
                stage.requires,
                "Toy",
                settings=SETTINGS,
                options=options,
                asides=(ASIDE, OTHER),
            ),
        ],
    )

    def call(*words):
        code = run_command_line([*words, "--runs-dir", str(tmp_path), "--run", "r"], table, TOOLS)
        out = capsys.readouterr()
        return code, out.out, out.err

    call.folder = tmp_path / "r"
    call.table = table
    call.stage = stage.name
    return call


def test_a_tool_prints_and_publishes_its_folder_and_no_verdict(run):
    code, out, err = run("measure", "--names", "one", "--seed", "7")
    assert (code, out) == (0, "seed 7 one\n")
    assert "a note" in err
    assert (run.folder / "measure" / "number.txt").read_text() == "7"
    assert not list(run.folder.rglob("verdict.json"))


def test_json_is_one_document(run):
    code, out, _ = run("measure", "--json", "--seed", "7")
    assert code == 0
    assert json.loads(out) == {"tool": "measure", "exit_code": 0, "seed": 7}


def test_a_tool_that_breaks_off_leaves_the_last_whole_result(run):
    run("measure", "--seed", "7")
    code, _, err = run("measure", "--fail")
    assert code == int(DataError("x").exit_code)
    assert "the tool broke off" in err
    assert not (run.folder / "measure" / "half.txt").exists()
    assert run("measure", "--seed", "8")[0] == 0
    assert not (run.folder / "measure" / "half.txt").exists()
    assert (run.folder / "measure" / "number.txt").read_text() == "8"


def test_the_exit_code_is_the_tools(run):
    assert run("refuse")[0] == 1


def test_an_aside_runs_instead_of_the_stage(run):
    code, _, _ = run(run.stage, "--tune", "--seed", "9")
    assert code == 0
    assert (run.folder / "number-tune" / "number.txt").read_text() == "9"
    assert not list(run.folder.rglob("verdict.json"))
    assert run(run.stage)[0] == 0
    assert list(run.folder.rglob("verdict.json"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--how-fast", "2"], "--how-fast goes with --tune of first"),
        (["--other", "--how-fast", "2"], "--how-fast goes with --tune of first, not with --other"),
        (["--other", "--queries", "2"], "--queries goes with --tune of first, not with --other"),
        (["--tune", "--mood", "good"], "--mood goes with the stage first itself, not with --tune"),
        (["--tune", "--other"], "--tune and --other exclude each other"),
        (["--tune", "--force"], "--force goes with the stage first itself, not with --tune"),
        (["--tune", "--yes"], "--yes goes with the stage first itself, not with --tune"),
    ],
)
def test_an_option_of_another_aside_is_refused(run, words, said):
    code, out, err = run(run.stage, *words)
    assert (code, out) == (2, "")
    assert said in err
    assert not run.folder.exists()


def test_what_a_tool_made_before_is_set_aside(run):
    run("measure", "--seed", "7")
    code, _, err = run("measure", "--seed", "8")
    assert code == 0
    (kept,) = (run.folder / "set-aside").iterdir()
    assert str(kept) in err
    assert (kept / "number.txt").read_text() == "7"


def test_an_option_of_the_stage_holds_for_the_asides_that_list_it(run):
    code, out, _ = run(run.stage, "--tune", "--queries", "33", "--seed", "1")
    assert (code, out) == (0, "seed 1 queries 33\n")


def test_a_command_in_a_remedy_gets_the_typed_options_once(run):
    session = Session(CommonOptions(profile="smoke", run="r"), run.table)
    said = "minidual explain first --profile smoke --run r"
    assert session.in_this_run("type minidual explain first") == f"type {said}"
    assert session.in_this_run(f"type {said}") == f"type {said}"
    assert session.in_this_run("minidual explain, minidual run") == (
        "minidual explain --profile smoke --run r, minidual run --profile smoke --run r"
    )


def test_an_empty_folder_of_runs_is_refused(run, capsys):
    """A path of "" would be the current folder."""
    assert run_command_line(["measure", "--runs-dir", ""], run.table, TOOLS) == ExitCode.USAGE
    assert "--runs-dir is empty" in capsys.readouterr().err
