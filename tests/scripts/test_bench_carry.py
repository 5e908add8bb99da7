"""The bench of a trial's steps."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from minidual.config.root import Config
from scripts.bench import carry, step
from scripts.bench.tables import BenchInputs


def test_rare_expensive_steps_count_in_the_mean_and_break_its_limit() -> None:
    """Nine steps of ten take three times bare physics, the tenth twenty times."""
    own_ns = ([60_000] * 9 + [400_000]) * 100
    row = carry._row("step", own_ns, [20_000] * 1000, carry.STEP_LIMITS)
    assert row.numbers == pytest.approx(
        {
            "mean_us": 94.0,
            "median_us": 60.0,
            "p99_us": 400.0,
            "bare_us": 20.0,
            "mean_ratio": 4.7,
            "median_ratio": 3.0,
            "p99_ratio": 20.0,
        },
    )
    assert row.exceeded == ("mean_ratio",)
    even = carry._row("step", [60_000] * 1000, [20_000] * 1000, carry.STEP_LIMITS)
    assert even.exceeded == ()


def test_every_step_of_a_trial_is_timed_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the end of one step's hook to the next one's: 100 us of work, 9 ms in every tenth."""
    clock_ns = 0

    class FakeTrial:
        """A trial of 101 steps on a clock that only its work moves on."""

        world = None
        task = SimpleNamespace(trial=lambda *_: None)

        def run(self, _trial: object, on_step: Callable[..., None]) -> tuple[object, None]:
            nonlocal clock_ns
            method = SimpleNamespace(phase="carry")
            for k in range(101):
                clock_ns += 9_000_000 if k % 10 == 0 else 100_000
                on_step(None, method)
            return SimpleNamespace(text="success"), None

    class FakePhysics:
        def __init__(self, _world: object) -> None:
            pass

        def block(self) -> list[int]:
            nonlocal clock_ns
            clock_ns += 77_000_000  # not part of any step
            return [20_000] * carry.BLOCK

    monkeypatch.setattr(carry.time, "process_time_ns", lambda: clock_ns)
    monkeypatch.setattr(step, "_look_ns", lambda: 0)
    monkeypatch.setattr(carry, "_BarePhysics", FakePhysics)
    times, text = carry._step_times(FakeTrial(), 1)  # pyright: ignore[reportArgumentType]
    assert text == "success"
    assert times.own == ([100_000] * 9 + [9_000_000]) * 10
    assert len(times.bare) == 100
    assert all(times.held)


@pytest.mark.slow
def test_a_trial_of_each_task_is_timed_beside_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    monkeypatch.setattr(carry, "TASKS", ("rod_carry", "insertion"))
    table = carry.measure(BenchInputs(Config(), 20261, 2 * carry.BLOCK, messages.append))
    rows = {row.name: row for row in table.rows}
    trials = [f"{task}, {method}" for task in carry.TASKS for method in ("impedance", "moveit")]
    assert messages[-len(trials) :] == [f"{name}: success" for name in trials]
    assert [name for name in rows if "held" not in name][2:] == trials
    numbers = [value for row in table.rows for value in row.numbers.values()]
    assert all(np.isfinite(value) and value > 0.0 for value in numbers)
    for name in trials:
        assert rows[name].limits == carry.STEP_LIMITS
        assert set(rows[name].numbers) == set(carry.COLUMNS)
        assert rows[name].numbers["mean_us"] > rows[name].numbers["bare_us"]
