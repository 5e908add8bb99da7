"""Forks of the test's process end by themselves: none goes on as a second pytest."""

from __future__ import annotations

import os

import pytest

from tests.support.children import fork_child


def _exit_code(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_a_fork_that_raises_ends_and_says_why(capfd: pytest.CaptureFixture[str]) -> None:
    def fails() -> None:
        raise TypeError("patch the module itself")

    assert _exit_code(fork_child(fails)) == 1
    assert "TypeError: patch the module itself" in capfd.readouterr().err


def test_a_fork_that_returns_ends_with_0() -> None:
    assert _exit_code(fork_child(int, "7")) == 0
