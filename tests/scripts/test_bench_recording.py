"""The bench of recording: time counts once, for the innermost part, and every part is there."""

from __future__ import annotations

import pytest

from minidual.config.root import Config, changed
from scripts.bench.stopwatch import Stopwatch
from scripts.bench.tables import BenchInputs
from tests.support.late import late

recording = late("scripts.bench.recording")


def test_time_counts_for_the_innermost_part() -> None:
    now = [0.0]
    watch = Stopwatch(lambda: now[0])

    def inner() -> str:
        now[0] += 3.0
        return "done"

    timed = watch.timed("inner", inner)
    with watch.running("outer"):
        now[0] += 1.0
        assert timed() == "done"
        now[0] += 1.5
    now[0] += 10.0
    with watch.running("outer"):
        now[0] += 0.5
    assert dict(watch.seconds) == {"outer": 3.0, "inner": 3.0}


def test_a_part_that_fails_is_left() -> None:
    now = [0.0]
    watch = Stopwatch(lambda: now[0])

    def fails() -> None:
        now[0] += 2.0
        raise ValueError("no")

    with watch.running("outer"):
        with pytest.raises(ValueError, match="no"):
            watch.timed("inner", fails)()
        now[0] += 1.0
    assert dict(watch.seconds) == {"outer": 1.0, "inner": 2.0}


@pytest.mark.slow
@pytest.mark.torch
@pytest.mark.timeout(600)
def test_each_part_of_a_recording_takes_time() -> None:
    config = changed(Config(), {"scene.camera.width_px": 48, "scene.camera.height_px": 32})
    table = recording.measure(BenchInputs(config, seed=11, repeats_n=1))
    rows = {row.name: row.numbers for row in table.rows}
    assert set(rows) == {*recording.PARTS, recording.REST, "all"}
    assert all(numbers["ms_per_episode"] > 0.0 for numbers in rows.values())
    assert sum(numbers.get("share_pct", 0.0) for numbers in rows.values()) == pytest.approx(100.0)
