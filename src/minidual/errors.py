"""Errors with an exit code.

Messages name the thing, the bound and the alternatives; `remedy` says what to do.
"""

import difflib
import re
from collections.abc import Collection, Iterable, Sequence
from enum import IntEnum

_UNPRINTABLE = re.compile(
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
        # Gymnasium raises a worker's error anew, as its class called with the error itself.
        self.message = str(message)
        self.remedy = remedy

    def __str__(self) -> str:
        return self.message if self.remedy is None else f"{self.message}\n  remedy: {self.remedy}"

    def __reduce__(self) -> tuple[object, ...]:
        # Worker pools pickle errors. Pickle would call the class with `args`, which subclasses
        # extend.
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
    text = sep.join(items[:shown])
    rest = len(items) - shown
    return f"{text}, and {rest} more" if rest > 0 else text


def printable(text: str) -> str:
    r"""Return `text` with control and hidden characters written as \uXXXX.

    JSON reads that back.
    """
    return _UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def unknown_name(kind: str, name: str, existing: Iterable[str]) -> UsageError:
    """Return an error that lists the existing names and suggests the closest."""
    names = sorted(existing)
    closest = _closest(name, names)
    remedy = None if closest is None else f"did you mean '{closest}'?"
    return UsageError(f"no {kind} '{name}'; there are {', '.join(names) or 'none'}", remedy=remedy)


def _closest(name: str, names: Sequence[str]) -> str | None:
    """Return the first name that begins with `name`, else the most similar one."""
    if name:
        for candidate in names:
            if candidate.startswith(name):
                return candidate
    similar = difflib.get_close_matches(name, names, n=1)
    return similar[0] if similar else None


def check_name(kind: str, name: str, existing: Collection[str]) -> None:
    """Raise `unknown_name` unless `existing` contains `name`."""
    if name not in existing:
        raise unknown_name(kind, name, existing)
