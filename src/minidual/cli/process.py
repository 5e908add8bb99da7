"""The process of a command: its signals and its output.

`main` sets both up before anything else is imported.
"""

import io
import os
import signal
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TextIO, cast

_IMPORT_PATIENCE_S = 1.0
_IMPORT_LOOK_S = 0.02
_DOCUMENT = (
    '{"error": {"kind": "KeyboardInterrupt", "message": "interrupted", "remedy": null}, '
    '"exit_code": 130}\n'
)
_SIGNALS = (signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Output(io.TextIOWrapper):
    """Standard output or error whose writes never raise.

    After an error, which is kept in `lost`, text is dropped.
    """

    lost: OSError | None = None

    def write(self, text: str, /) -> int:
        """Write or drop `text`."""
        try:
            return super().write(text)
        except OSError as error:
            self._drop(error)
            return len(text)

    def flush(self) -> None:
        """Write the buffer, or drop it."""
        try:
            super().flush()
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        if self.lost is None:
            self.lost = error
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


def _open_output() -> None:
    """Open closed standard streams on /dev/null and make writes safe.

    A stream that stays closed would leave its number to the next file that is opened.
    """
    if sys.stdin is None:
        sys.stdin = sys.__stdin__ = _null("r")
    if sys.stdout is None:
        sys.stdout = sys.__stdout__ = _null("w")
    if sys.stderr is None:
        sys.stderr = sys.__stderr__ = _null("w")
    sys.stdout = _safe(sys.stdout)
    sys.stderr = _safe(sys.stderr)


def _null(mode: str) -> TextIO:
    return Path(os.devnull).open(mode, encoding="utf-8")  # type: ignore[return-value]


def _safe(stream: TextIO) -> Output:
    text_stream = cast(io.TextIOWrapper, stream)
    return Output(
        text_stream.buffer,
        text_stream.encoding,
        errors="backslashreplace",
        line_buffering=text_stream.line_buffering,
        write_through=text_stream.write_through,
    )


class _Interrupt:
    """Signal handler that raises KeyboardInterrupt.

    An import turns that into another error. So the handler waits for the end of an import, and ends
    the process if it takes too long.
    """

    def __init__(self) -> None:
        self.raised = False
        """Whether KeyboardInterrupt was raised; libraries turn it into errors of their own."""
        self._first_s: float | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now_s = time.monotonic()
        if self._first_s is None:
            self._first_s = now_s
        if _is_importing(frame):
            if now_s - self._first_s > _IMPORT_PATIENCE_S:
                _say_interrupted()
                os._exit(130)
            signal.setitimer(signal.ITIMER_REAL, _IMPORT_LOOK_S)
            return
        self._first_s = None
        self.raised = True
        raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


interrupt = _Interrupt()


def main() -> None:
    """Entry point of the `minidual` command."""
    _open_output()
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, interrupt)
    # Some libraries' docstrings hold invalid escapes, which warn when compiled.
    warnings.simplefilter("ignore", SyntaxWarning)
    # joblib's, when interrupted.
    warnings.filterwarnings("ignore", ".* tasks which were still being processed by the workers")
    try:
        code = _run()
        _ignore_signals()
    except KeyboardInterrupt:
        _ignore_signals()
        _say_interrupted()
        code = 130
    sys.stdout.flush()
    lost = getattr(sys.stdout, "lost", None)
    closed_by_reader = isinstance(lost, BrokenPipeError)  # `| head`
    if lost is not None and not closed_by_reader:
        print(f"minidual: cannot write the output: {lost.strerror}", file=sys.stderr)
        code = code or 4
    sys.exit(code)


def _ignore_signals() -> None:
    """Ignore signals from here on: the ending interpreter takes handlers away."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _say_interrupted() -> None:
    """Write to the streams themselves: a module that is half imported may not be used."""
    _write(2, "minidual: interrupted\n")
    if "--json" in sys.argv:
        _write(1, _DOCUMENT)


def _write(descriptor: int, text: str) -> None:
    with suppress(OSError):
        os.write(descriptor, text.encode())


def _run() -> int:
    from minidual import emergency

    emergency.listen()  # before anything starts a thread
    from minidual.cli.app import run_command_line
    from minidual.stages.registry import STAGES, TOOLS

    return run_command_line(sys.argv[1:], STAGES, TOOLS)
