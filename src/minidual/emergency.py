"""The emergency stop of this process and its workers.

Once pressed, supervised arms stop and the command ends. SIGUSR1 (`minidual stop`), the button of
the view and a key of the keyboard leader press it.
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
    # Blocked here, and so in the threads and processes that start later, which it would end. A
    # thread of its own takes it: no long call delays that.
    signal.pthread_sigmask(signal.SIG_BLOCK, {SIGNAL})
    threading.Thread(target=_wait, daemon=True, name="emergency-stop").start()


def _wait() -> None:
    while True:
        received = signal.sigtimedwait({SIGNAL}, _AGAIN_S)
        # After Ctrl-Z and fg CPython returns another signal.
        if received is not None and received.si_signo == SIGNAL:
            press("signal SIGUSR1")
        elif _reason:  # a worker may have started since
            _tell_children()


def _tell_children() -> None:
    import psutil  # takes 40 ms

    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            child.send_signal(SIGNAL)
