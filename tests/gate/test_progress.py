"""Progress as plain lines."""

import pytest

from minidual.gate import progress


@pytest.mark.parametrize(("done_before", "left"), [(0, 80), (1000, 80), (5000, 40)])
def test_the_time_left_follows_from_what_this_command_did(
    monkeypatch: pytest.MonkeyPatch,
    done_before: int,
    left: int,
) -> None:
    """Work of an interrupted command, counted at once, is no speed."""
    clock = [100.0]
    lines = list[str]()
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    total = done_before + 1000 if done_before < 5000 else 5600
    with progress.Progress(lines.append).task("steps", total) as task:
        if done_before:
            task.advance(done_before)
        for _ in range(20):
            clock[0] += 1.0
            task.advance(10)
    shown = next(line for line in reversed(lines) if "left" in line)
    assert shown.endswith(f"about {left} s left")
