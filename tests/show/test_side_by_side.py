"""A film shows the methods of one start side by side, in step, with what they did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.show.figures.side_by_side import FPS, PANE_SIZE, Take, captioned, film_takes, take
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from tests.support.late import late

av = late("av")


@pytest.fixture(scope="module")
def shown() -> Take:
    task = make_task(Config(task="rod_carry"))
    inputs = MethodInputs(task.config, task.config.seed)
    shown = take("hold", inputs, task.trial(0, "film", 0))
    return replace(shown, moments=shown.moments[:20])


def test_a_take_has_a_moment_for_each_frame(shown: Take) -> None:
    times_s = [moment.time_s for moment in shown.moments]
    np.testing.assert_allclose(np.diff(times_s), 1.0 / FPS, atol=2e-3)
    assert shown.at(10 / FPS) is shown.moments[10]
    assert shown.at(99.0) is shown.moments[-1]
    assert shown.end_s == pytest.approx(19 / FPS)


def test_the_bar_tells_running_success_and_failure_apart(shown: Take) -> None:
    picture = np.zeros((PANE_SIZE[1], PANE_SIZE[0], 3), np.uint8)
    won = replace(shown, result=replace(shown.result, success=True, duration_s=1.0))
    colours = {
        tuple(captioned(picture, one, time_s)[-1, 0])
        for one, time_s in ((shown, 0.1), (shown, 9.0), (won, 9.0))
    }
    assert len(colours) == 3


def test_panes_stand_side_by_side_until_the_longest_has_ended(
    shown: Take,
    tmp_path: Path,
) -> None:
    short = replace(shown, moments=shown.moments[:5])
    path = tmp_path / "film.mp4"
    frames_n = film_takes([shown, short], path)
    assert frames_n == 19 + 2 * FPS
    with av.open(path) as film:
        (stream,) = film.streams.video
        assert stream.codec_context.width == 2 * PANE_SIZE[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == frames_n
    left, right = np.split(frames[0].astype(float), 2, axis=1)
    middle = slice(40, PANE_SIZE[1] - 40)
    assert np.abs(left[middle] - right[middle]).mean() < 3.0
