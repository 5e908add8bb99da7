"""What a file says never moves the cursor, sets a title or turns the text round."""

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from minidual.cli.app import run_command_line
from minidual.cli.terminal import SafeConsole, console
from minidual.errors import DataError, ExitCode, printable
from minidual.gate.stage import StageResult
from minidual.gate.table import StageEntry, StageTable
from tests.support.pipeline_toys import Toy

HOSTILE = "a\x1b[2J\x1b]0;owned\x07\x9b31m\x7f\r\u202egnp.exe\u2066\u200bz"
UNSEEN = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]",
)


def test_the_text_keeps_what_people_read_and_shows_the_rest() -> None:
    assert UNSEEN.search(HOSTILE)
    assert printable(HOSTILE).startswith(
        "a\\u001b[2J\\u001b]0;owned\\u0007\\u009b31m\\u007f\\u000d\\u202egnp",
    )
    assert not UNSEEN.search(printable(HOSTILE))
    assert printable("caf\udce9") == "caf\\udce9"  # a file name that is no UTF-8
    plain = "über 5 °C → ±0.1 m\n\tzwei \N{GRINNING FACE} 日本"
    assert printable(plain) == plain
    document = json.dumps({"a": HOSTILE}, ensure_ascii=False)
    assert json.loads(printable(document)) == json.loads(document)


@pytest.mark.parametrize(("columns", "width"), [(None, 160), ("60", 60)])
def test_tables_off_a_terminal_are_as_wide_as_it_is_said(
    monkeypatch: pytest.MonkeyPatch,
    columns: str | None,
    width: int,
) -> None:
    """`status | less` is readable in a window of 80 columns: COLUMNS holds off a terminal."""
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    assert console(stderr=False).width == width


def test_a_console_shows_its_own_colours_and_bars_and_no_others() -> None:
    out = io.StringIO()
    console = SafeConsole(file=out, force_terminal=True, color_system="standard", width=100)
    table = Table("name", title=HOSTILE)
    table.add_row(HOSTILE)
    for shown in (HOSTILE, Text(HOSTILE, "red"), table):
        console.print(shown, markup=False)
    text = out.getvalue()
    assert "\x1b[31m" in text  # its own red
    assert not re.search(r"\x1b\[2J|\x1b\]|[\x07\x9b\u202e\u200b]", text)
    assert text.count("\\u202e") >= 3  # a table cell may fold within it
    with Progress(console=console) as bars:
        bars.add_task("x", total=1)
    assert "\x1b[?25l" in out.getvalue()  # it hides the cursor as before


@pytest.mark.parametrize(
    "words",
    [["alpha"], ["status"], ["explain", "alpha"], ["status", "--json"]],
)
def test_no_verdict_steers_the_terminal(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Loud(Toy):
        def run(self, context: Any) -> StageResult:
            context.progress.note(HOSTILE)
            result = super().run(context)
            result.notes.append(HOSTILE)
            return result

    table = StageTable((StageEntry("alpha", Loud("alpha"), (), "A toy"),))
    common = ["--profile", "smoke", "--runs-dir", str(tmp_path)]
    assert run_command_line(["alpha", *common], table) == ExitCode.PASS
    before = capsys.readouterr()
    run_command_line([*words, *common], table)
    after = capsys.readouterr()
    shown = before.out + before.err + after.out + after.err
    assert "\\u001b]0;owned" in shown
    assert not UNSEEN.search(shown)


def test_words_that_are_no_text_are_refused_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["status", "--run", "\udcff"], ["carry", "--object", "a\ud800"], ["\udcff"]):
        assert run_command_line(words, StageTable(())) == ExitCode.USAGE
        assert capsys.readouterr().err == f"minidual: {printable(words[-1])} is not UTF-8\n"


def test_no_error_steers_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Broken(Toy):
        def run(self, context: Any) -> StageResult:
            raise DataError(HOSTILE, remedy=HOSTILE)

    table = StageTable((StageEntry("alpha", Broken("alpha"), (), "A toy"),))
    for more in ([], ["--debug"], ["--json"]):
        arguments = ["alpha", "--profile", "smoke", "--runs-dir", str(tmp_path), *more]
        assert run_command_line(arguments, table) == ExitCode.USAGE
        shown = capsys.readouterr()
        assert "remedy: a\\u001b[2J" in shown.err
        assert not UNSEEN.search(shown.out + shown.err)
