"""Errors with an exit code. Messages name thing, bound and alternatives; `remedy` says what to do."""

import difflib
import re
from collections.abc import Collection, Iterable, Sequence
from enum import IntEnum

_UNSEEN = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]",
)
"""Control, zero-width and direction characters but newline and tab, and half surrogates."""


class ExitCode(IntEnum):
    """Exit codes of `minidual`."""

    PASS = 0
    ACCEPTANCE_FAILED = 1
    USAGE = 2
    GATE_CLOSED = 3
    ENVIRONMENT = 4
    NOTHING_EVALUATED = 5
    INTERNAL = 70
    INTERRUPTED = 130


class MinidualError(Exception):
    """Expected error, shown without a traceback."""

    exit_code: ExitCode = ExitCode.USAGE

    def __init__(self, message: str, *, remedy: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy

    def __str__(self) -> str:
        return self.message if self.remedy is None else f"{self.message}\n  remedy: {self.remedy}"

    def __reduce__(self) -> tuple[object, ...]:
        # Worker pools pickle errors; pickle would call the class with `args`, which subclasses extend.
        return type(self).__new__, (type(self), *self.args), self.__dict__


class UsageError(MinidualError):
    """A given name, value or file is wrong."""


class ConfigError(UsageError):
    """Invalid configuration; the message names file, line and dotted path."""


class GateClosedError(MinidualError):
    """An upstream verdict is not passing and fresh."""

    exit_code = ExitCode.GATE_CLOSED


class EnvironmentMissingError(MinidualError):
    """A library, driver or device is missing."""

    exit_code = ExitCode.ENVIRONMENT


class NothingEvaluatedError(MinidualError):
    """A stage ended without any check or trial."""

    exit_code = ExitCode.NOTHING_EVALUATED


class DataError(MinidualError):
    """A file is corrupt, truncated or of another schema."""


def shortened(items: Sequence[str], shown: int = 6, sep: str = ", ") -> str:
    """Return the first items, and the number of the rest."""
    rest = len(items) - shown
    return sep.join(items[:shown]) + (f", and {rest} more" if rest > 0 else "")


def printable(text: str) -> str:
    r"""Return `text` with what a terminal would obey or hide written as \uXXXX, which JSON reads back."""
    return _UNSEEN.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """Return an error that lists the known names and suggests the closest."""
    names = sorted(known)
    close = [n for n in names if name and n.startswith(name)] or difflib.get_close_matches(
        name,
        names,
        n=1,
    )
    remedy = f"did you mean '{close[0]}'?" if close else None
    return UsageError(f"no {kind} '{name}'; there are {', '.join(names) or 'none'}", remedy=remedy)


def check_name(kind: str, name: str, known: Collection[str]) -> None:
    """Raise `unknown_name` unless `known` contains `name`."""
    if name not in known:
        raise unknown_name(kind, name, known)
