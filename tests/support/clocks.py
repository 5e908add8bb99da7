"""Clocks for tests of what must not depend on time."""

import itertools
import time

import pytest


def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an hour pass between two looks at any clock of Python, as on a machine that hardly runs."""
    hours = itertools.count(1)

    def now_s() -> float:
        return 3600.0 * next(hours)

    for name in ("perf_counter", "process_time", "thread_time", "monotonic", "time"):
        monkeypatch.setattr(time, name, now_s)
    for module in ("api", "budget", "goal_plan"):
        monkeypatch.setattr(f"minidual.motion.{module}.perf_counter", now_s)
