"""How a command ends: its exit code, and what is printed for an error."""

import sys
import traceback
from collections.abc import Callable

from minidual import emergency
from minidual.cli.process import interrupt
from minidual.cli.session import Session
from minidual.errors import EnvironmentMissingError, ExitCode, MinidualError, printable
from minidual.variables import rendering_remedy


def end(session: Session, body: Callable[[Session], int]) -> int:
    """Run `body`; return its exit code, or print its error and return the error's."""
    try:
        return int(body(session))
    except KeyboardInterrupt as error:
        return _interrupted(session, error, str(error))
    except Exception as error:
        if interrupt.raised:  # a library turned the KeyboardInterrupt into an error of its own
            return _interrupted(session, error)
        pressed = emergency.pressed()
        if pressed:  # whatever error came of the arms that were stopped for it
            return _interrupted(session, error, f"emergency stop ({pressed})")
        if not isinstance(error, MinidualError) and _is_opengl_import(error):
            error = EnvironmentMissingError(
                f"mujoco cannot load OpenGL: {error}", remedy=rendering_remedy(str(error))
            )
        if isinstance(error, MinidualError):
            return _fail(session, error, error.message, error.remedy, error.exit_code)
        return _crashed(session, error)


def _is_opengl_import(error: Exception) -> bool:
    """Return whether an error came of the import of mujoco's OpenGL, which raises various types."""
    codes = [frame.f_code for frame, _ in traceback.walk_tb(error.__traceback__)]
    modules = [code.co_filename for code in codes if code.co_name == "<module>"]
    return any("/mujoco/egl/" in module for module in modules)


def _interrupted(session: Session, error: BaseException, reason: str = "") -> int:
    message = (
        f"{reason or 'interrupted'}; nothing half-written counts, "
        "the same command goes on from here"
    )
    return _fail(session, error, message, None, ExitCode.INTERRUPTED)


def _crashed(session: Session, error: Exception) -> int:
    message = f"internal error: {type(error).__name__}: {error}"
    try:
        message += f"; traceback in {session.store.write_crash('cli', error)}"
    except Exception:  # the defect may be in the code that finds the run folder
        _print_error("".join(traceback.format_exception(error)))
    remedy = "please report it with the traceback"
    return _fail(session, error, message, remedy, ExitCode.INTERNAL)


def _fail(
    session: Session,
    error: BaseException,
    message: str,
    remedy: str | None,
    code: ExitCode,
) -> int:
    if session.common.debug:
        _print_error("".join(traceback.format_exception(error)))
    text = f"minidual: {message}"
    if remedy:
        remedy = session.in_this_run(remedy)
        text += f"\n  remedy: {remedy}"
    record = {"kind": type(error).__name__, "message": message, "remedy": remedy}
    session.finish({"error": record, "exit_code": int(code)}, ())
    _print_error(text)
    return int(code)


def _print_error(text: str) -> None:
    print(printable(text), file=sys.stderr)
