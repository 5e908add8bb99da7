"""Signals before and during imports, and output that cannot be written.

Each ends with one line, the right exit code and no traceback.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
MAIN = """
import os, sys
from minidual.cli import process as cli
run = cli._run
def _run():
    os.write(2, b"begun\\n")
    return {body}
cli._run = _run
cli.main()
"""


def heed_signals() -> None:
    """Take signals as a terminal's child does.

    A background job ignores SIGINT, a child of nohup SIGHUP.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def start(body: str, *words: str, **options: object) -> subprocess.Popen[str]:
    """Start `main` on `body` in place of the command line; return once signals are handled."""
    pipes = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        **options,
    }
    process: subprocess.Popen[str] = subprocess.Popen(  # type: ignore[call-overload]
        [sys.executable, "-c", MAIN.format(body=body), *words],
        text=True,
        preexec_fn=heed_signals,
        **pipes,
    )
    if process.stderr is not None:
        assert process.stderr.readline() == "begun\n"
    return process


@pytest.mark.parametrize(
    ("handler", "code"),
    [(signal.SIG_DFL, -signal.SIGINT), (signal.SIG_IGN, 0)],
)
def test_an_interrupt_before_the_handlers_stand_ends_the_process_without_a_traceback(
    handler: signal.Handlers,
    code: int,
    tmp_path: Path,
) -> None:
    """Python's own handler would raise in the middle of the first imports.

    A background job, which ignores the signal, goes on.
    """
    (tmp_path / "sitecustomize.py").write_text(
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'minidual.cli.process':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n",
    )
    ran = subprocess.run(
        [sys.executable, "-m", "minidual.cli", "--version"],
        env={**os.environ, "PYTHONPATH": path(tmp_path)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, handler),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (code, "")


@pytest.mark.parametrize("number", SIGNALS)
def test_an_import_that_swallows_errors_does_not_swallow_a_signal(
    number: int,
    tmp_path: Path,
) -> None:
    (tmp_path / "greedy.py").write_text(
        "import os, time\n"
        "try:\n"
        f"    os.kill(os.getpid(), {int(number)})\n"
        "    time.sleep(0.05)\n"
        "except BaseException as error:\n"
        "    raise ImportError('multiarray failed to import') from error\n"
        "print('imported whole', flush=True)\n",
    )
    process = start(
        "__import__('greedy') and __import__('time').sleep(60)",
        env={**os.environ, "PYTHONPATH": path(tmp_path)},
    )
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (130, "imported whole\n", "minidual: interrupted\n")


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_the_interpreter_ends_kills_nothing(number: int) -> None:
    """Python takes its handlers away before the last objects go: the signals are ignored then."""
    kill = f"lambda self, kill=os.kill, me=os.getpid(): kill(me, {int(number)})"
    late = f"type('Late', (), {{'__del__': {kill}}})()"
    process = start(f"setattr(sys, 'kept', {late}) or print('done') or 3")
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (3, "done\n", "")


def test_an_interrupt_that_a_library_turns_into_its_own_error_is_an_interrupt() -> None:
    """pydantic makes a SchemaError of it."""
    turning = (
        "import os, signal\n"
        "from minidual.cli.ending import end\n"
        "from minidual.cli.options import CommonOptions\n"
        "from minidual.cli.session import Session\n"
        "from minidual.gate.table import StageTable\n"
        "def greedy(session):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        __import__('time').sleep(5)\n"
        "    except BaseException as error:\n"
        "        raise ValueError('Error building a serializer') from error\n"
        "run = lambda: end(Session(CommonOptions(), StageTable([])), greedy)\n"
    )
    made = (
        f"exec({turning!r}, (m := __import__('types').ModuleType('turning')).__dict__) or m.run()"
    )
    process = start(made)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert err.startswith("minidual: interrupted; nothing half-written counts")


def test_an_import_without_end_is_interrupted(tmp_path: Path) -> None:
    (tmp_path / "endless.py").write_text(
        "import time\nprint('importing', flush=True)\ntime.sleep(60)\n",
    )
    process = start("__import__('endless')", env={**os.environ, "PYTHONPATH": path(tmp_path)})
    assert process.stdout is not None
    assert process.stdout.readline() == "importing\n"
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (130, "minidual: interrupted\n")
    assert time.monotonic() - began < 10.0


def test_an_interrupted_import_is_a_document_too(tmp_path: Path) -> None:
    (tmp_path / "endless.py").write_text(
        "import sys, time\nprint('importing', file=sys.stderr)\ntime.sleep(60)\n",
    )
    process = start(
        "__import__('endless')",
        "--json",
        env={**os.environ, "PYTHONPATH": path(tmp_path)},
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    assert json.loads(out)["exit_code"] == process.returncode == 130


def path(folder: Path) -> str:
    return os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    "words",
    [("--help",), ("status",), ("config", "show"), ("plan", "--to", "ready")],
)
def test_commands_are_interrupted_at_any_time(
    words: tuple[str, ...],
    number: int,
    tmp_path: Path,
) -> None:
    for delay_s in (0.0, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5):
        process = start("run()", *words, cwd=tmp_path)
        time.sleep(delay_s)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
        assert process.returncode in (0, 130, -number), err  # the last: Python was ending already
        assert "Traceback" not in err


def test_a_signal_while_a_command_imports_exits_130(tmp_path: Path) -> None:
    process = start("run()", "plan", "--to", "ready", cwd=tmp_path)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert re.fullmatch(r"minidual: interrupted[^\n]*\n", err), (
        err
    )  # where words are parsed, it says what goes on from here


def test_signals_that_the_caller_ignores_stay_ignored() -> None:
    """As under nohup."""
    body = "os.kill(os.getpid(), 1) or print('still here') or 0"
    process = subprocess.run(
        [sys.executable, "-c", MAIN.format(body=body)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    assert (process.returncode, process.stdout) == (0, "still here\n")


PRINTS = "print('x' * 100_000) or print('more', file=sys.stderr) or {code}"


@pytest.mark.parametrize(
    ("redirection", "code", "ends", "says"),
    [
        (
            ">/dev/full",
            0,
            4,
            "begun\nmore\nminidual: cannot write the output: No space left on device\n",
        ),
        (
            ">/dev/full",
            1,
            1,
            "begun\nmore\nminidual: cannot write the output: No space left on device\n",
        ),
        (">&-", 0, 0, "begun\nmore\n"),
        ("| true", 1, 1, "begun\nmore\n"),
        (">/dev/null 2>/dev/full", 0, 0, ""),
        ("<&- >&- 2>&-", 1, 1, ""),
    ],
)
def test_output_that_cannot_be_written_is_quiet_and_keeps_the_exit_code(
    redirection: str,
    code: int,
    ends: int,
    says: str,
) -> None:
    command = f'"$0" -c "$1" {redirection}; exit ${{PIPESTATUS[0]}}'
    program = MAIN.format(body=PRINTS.format(code=code)).replace(
        'os.write(2, b"begun\\n")',
        'print("begun", file=sys.stderr)',
    )
    done = subprocess.run(
        ["bash", "-c", command, sys.executable, program],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (ends, "", says)


def test_help_without_disk_and_a_deleted_folder_are_named(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    command = (
        f'mkdir {gone}; cd {gone}; rmdir {gone}; "$0" -m minidual.cli --help >/dev/full; echo $?;'
        'env -u HOME -u TERM LC_ALL=C "$0" -m minidual.cli config show; echo $?'
    )
    done = subprocess.run(
        ["bash", "-c", command, sys.executable],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "4\n4\n"
    assert done.stderr == (
        "minidual: cannot write the output: No space left on device\n"
        "minidual: the working directory was deleted\n  remedy: cd to another one\n"
    )
