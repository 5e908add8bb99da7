"""The process of a command: its signals and its output, in order before anything else is imported."""

import io
import os
import signal
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from types import FrameType

_IMPORT_PATIENCE_S = 1.0
_DOCUMENT = '{"error": {"kind": "KeyboardInterrupt", "message": "interrupted", "remedy": null}, "exit_code": 130}\n'
_SIGNALS = signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP


class Output(io.TextIOWrapper):
    """Standard output or error whose writes never raise. After an error, kept in `lost`, text is dropped."""

    lost: OSError | None = None

    def write(self, text: str, /) -> int:
        """Write or drop `text`."""
        try:
            return super().write(text)
        except OSError as error:
            self._drop(error)
            return len(text)

    def flush(self) -> None:
        """Write or drop what is buffered."""
        try:
            super().flush()
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        self.lost = self.lost or error
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


def _open_output() -> None:
    """Open closed standard streams on /dev/null, so that no file gets their numbers; make writes safe."""
    for name in ("stdin", "stdout", "stderr"):
        if (stream := getattr(sys, name)) is None:
            stream = Path(os.devnull).open("r" if name == "stdin" else "w", encoding="utf-8")  # noqa: SIM115 - for good
            setattr(sys, f"__{name}__", stream)
        if name != "stdin":
            at_once = stream.line_buffering, stream.write_through
            stream = Output(stream.buffer, stream.encoding, "backslashreplace", None, *at_once)
        setattr(sys, name, stream)


class _Interrupt:
    """Signal handler that raises KeyboardInterrupt."""

    # Imports turn that into other errors. So it waits for their end, and ends the process if they take too long.
    asked_s: float | None = None
    raised = False
    """Libraries turn it into errors of their own."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.asked_s = self.asked_s or time.monotonic()
        while frame is not None:
            if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
                if time.monotonic() - self.asked_s > _IMPORT_PATIENCE_S:
                    _say_interrupted()
                    os._exit(130)
                signal.setitimer(signal.ITIMER_REAL, 0.02)
                return
            frame = frame.f_back
        self.asked_s = None
        self.raised = True
        raise KeyboardInterrupt


interrupt = _Interrupt()


def main() -> None:
    """Entry point of the `minidual` command."""
    _open_output()
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, interrupt)
    # Some libraries' docstrings hold invalid escapes, which warn when compiled.
    warnings.simplefilter("ignore", SyntaxWarning)
    warnings.filterwarnings(
        "ignore",
        ".* tasks which were still being processed by the workers",
    )  # when interrupted
    try:
        code = _run()
        _end()
    except KeyboardInterrupt:
        _end()
        _say_interrupted()
        code = 130
    sys.stdout.flush()
    lost = getattr(sys.stdout, "lost", None)
    if lost is not None and not isinstance(
        lost,
        BrokenPipeError,
    ):  # the reader closed the pipe (`| head`)
        print(f"minidual: cannot write the output: {lost.strerror}", file=sys.stderr)
        code = code or 4
    sys.exit(code)


def _end() -> None:
    """Ignore signals: the ending interpreter takes handlers away."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _say_interrupted() -> None:
    """Write to the streams themselves: what is half imported may not be used."""
    for number, text in (
        (2, "minidual: interrupted\n"),
        (1, _DOCUMENT if "--json" in sys.argv else ""),
    ):
        with suppress(OSError):
            os.write(number, text.encode())


def _run() -> int:
    from minidual import emergency

    emergency.listen()  # before anything starts a thread
    from minidual.cli.app import run_command_line
    from minidual.stages.registry import STAGES, TOOLS

    return run_command_line(sys.argv[1:], STAGES, TOOLS)
