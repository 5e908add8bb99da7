"""How a command ends: the exit code of each kind of error."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from minidual import emergency
from minidual.cli.ending import end
from minidual.errors import DataError, ExitCode, UsageError


@pytest.fixture
def pressed() -> Iterator[None]:
    emergency.press("button")
    yield
    emergency.release()


class Silent:
    """A session that keeps what it would print."""

    def __init__(self) -> None:
        self.common = SimpleNamespace(debug=False)
        self.documents: list[dict[str, Any]] = []

    def in_this_run(self, text: str) -> str:
        return text

    def finish(self, document: dict[str, Any], _lines: object) -> None:
        self.documents.append(document)


def failing(error: Exception) -> Any:
    def body(_session: object) -> int:
        raise error

    return body


def ended(error: Exception) -> int:
    session: Any = Silent()
    return end(session, failing(error))


def test_an_error_of_ours_ends_with_its_own_code() -> None:
    assert ended(UsageError("no such thing")) == ExitCode.USAGE
    assert ended(DataError("broken file")) == DataError("x").exit_code


def test_any_error_after_an_emergency_stop_is_an_interruption(
    pressed: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert ended(DataError("the trial ended otherwise")) == ExitCode.INTERRUPTED
    assert ended(ValueError("a library's")) == ExitCode.INTERRUPTED
    assert "emergency stop (button)" in capsys.readouterr().err
