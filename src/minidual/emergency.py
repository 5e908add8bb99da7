"""The emergency stop of this process and its workers: once pressed, supervised arms stop and the command ends.

SIGUSR1 (`minidual stop`), the button of the view and a key of the keyboard leader press it.
"""

import functools
import signal
import threading
from contextlib import suppress

SIGNAL = signal.SIGUSR1
_AGAIN_S = 0.2
_reason = ""
_listening = False


class EmergencyStop(KeyboardInterrupt):
    """The emergency stop was pressed: nothing may move until a new command starts."""


def press(reason: str) -> None:
    """Stop the arms of every supervisor here and in the workers, in its next tick; thread-safe."""
    global _reason
    _reason = reason or "pressed"
    if _listening:
        _tell_children()


def pressed() -> str:
    """Return who pressed it, or ""."""
    return _reason


def release() -> None:
    """Let arms of this process move again: the scene is safe."""
    global _reason
    _reason = ""


def check() -> None:
    """Raise EmergencyStop if it was pressed."""
    if _reason:
        raise EmergencyStop(
            f"emergency stop ({_reason}): the arms were stopped and the command ended",
        )


@functools.cache
def listen() -> None:
    """Press at SIGUSR1 from now on; call before other threads and processes start."""
    global _listening
    _listening = True
    # inherited by threads and processes, which the signal would end; no long call delays the thread that takes it
    signal.pthread_sigmask(signal.SIG_BLOCK, {SIGNAL})
    threading.Thread(target=_wait, daemon=True, name="emergency-stop").start()


def _wait() -> None:
    while True:
        seen = signal.sigtimedwait({SIGNAL}, _AGAIN_S)
        if (
            seen is not None and seen.si_signo == SIGNAL
        ):  # CPython returns another after Ctrl-Z and fg
            press("signal SIGUSR1")
        elif _reason:  # a worker may have started since
            _tell_children()


def _tell_children() -> None:
    import psutil  # 40 ms that commands do not need

    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            child.send_signal(SIGNAL)
